"""The simulated rig: cameras, projector, turntable and lamp arc around one object, with truth."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from hardware.simulated.optics import Seen, Sensor, Solid, gather, look, reflected
from pipeline.formats.patterns import Pattern, pattern_image
from pipeline.geometry.camera import Camera, Lens
from pipeline.geometry.rigid import RigidTransform, rotation_about_axis

Array = NDArray[np.float64]
Grey = NDArray[np.float32]

GREY = np.array([0.25, 0.5, 0.25])
"""A Bayer sensor's mean of R, G, G and B."""

PROJECTOR_INTENSITY, LAMP_INTENSITY = 2.0, 3.0
AMBIENT = 0.004
"""Radiance of a white surface in the room's light, patterns only."""

_PROJECTOR_SPREAD_PX, _CAMERA_SPREAD_PX = 0.5, 0.4


class Bench:
    """What stands around the object, and the object itself; the devices share it.

    Parameters
    ----------
    cameras
        By name, in the rig's frame.
    projector
        An inverse camera in the rig's frame.
    lamps
        Position of each stop, mm, the rig's frame.
    seed
        Of the sensors' noise.
    """

    def __init__(
        self, cameras: dict[str, Camera], projector: Camera, lamps: dict[str, Array], seed: int
    ) -> None:
        self.cameras, self.projector, self.lamps = cameras, projector, lamps
        self.random = np.random.default_rng(seed)
        self.sensor = Sensor()
        self.angle_deg = 0.0
        self.lamp: str | None = None
        self.shown: Grey | None = None
        self._placed: tuple[Solid, RigidTransform] | None = None
        # Of the last camera and angle only: a capture goes through them one after another.
        self._shading: dict[tuple[str, float, int], tuple[Grey, Grey, NDArray[np.float32]]] = {}

    def place(self, solid: Solid, rig_from_object: RigidTransform) -> None:
        """Put an object on the table as it stands at angle 0."""
        self._placed = solid, rig_from_object
        self._shading.clear()

    @property
    def object_pose(self) -> tuple[Solid, RigidTransform]:
        """The object and where the table has turned it."""
        if self._placed is None:
            raise RuntimeError("nothing lies on the table")
        solid, pose = self._placed
        turn = rotation_about_axis(np.zeros(3), np.array([0.0, 0.0, 1.0]), self.angle_deg)
        return solid, turn @ pose

    def photograph(self, name: str, samples: int) -> Array:
        """Return what a camera's rays see in the lamp's light, (rows, columns, 3) radiance."""
        if self.lamp is None:
            raise RuntimeError("the lamp is off")
        seen, view, back, solid = self._look(name, samples)
        light = back.apply(self.lamps[self.lamp])
        shining = reflected(seen, view, light, LAMP_INTENSITY)
        return np.asarray(shining * solid.lit(seen.points_mm, light)[..., None])

    def under_pattern(self, name: str, samples: int) -> Grey:
        """Return what a grey camera's rays see in the projector's light, (rows, columns)."""
        key = (name, self.angle_deg, samples)
        if key not in self._shading:
            self._shading = {key: self._projected(name, samples)}
        ambient, shading, place = self._shading[key]
        if self.shown is None:
            return ambient
        pattern = cv2.remap(self.shown, place, None, cv2.INTER_LINEAR)
        return np.asarray(ambient + shading * pattern, dtype=np.float32)

    def _look(self, name: str, samples: int) -> tuple[Seen, Array, RigidTransform, Solid]:
        solid, pose = self.object_pose
        seen = look(self.cameras[name], solid, pose, samples)
        back = pose.inverse()
        return seen, back.apply(self.cameras[name].centre_mm), back, solid

    def _projected(self, name: str, samples: int) -> tuple[Grey, Grey, NDArray[np.float32]]:
        """Return ambient light, light under full projection, and each ray's projector pixel."""
        seen, view, back, solid = self._look(name, samples)
        light = back.apply(self.projector.centre_mm)
        shading = reflected(seen, view, light, PROJECTOR_INTENSITY) @ GREY
        place = self.projector.project(back.inverse().apply(seen.points_mm))
        width, height = self.projector.lens.size_px
        reached = (place > -0.5).all(axis=-1) & (place < (width - 0.5, height - 0.5)).all(axis=-1)
        shading *= reached & solid.lit(seen.points_mm, light)
        ambient = np.nan_to_num(seen.diffuse @ GREY * np.isfinite(seen.points_mm[..., 0]))
        return (
            (ambient * (AMBIENT * np.pi)).astype(np.float32),
            shading.astype(np.float32),
            np.nan_to_num(place, nan=-1e6).astype(np.float32),
        )


class SimulatedProjector:
    """Shows patterns with its lens's defocus."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench

    def show(self, pattern: Pattern | None) -> None:
        """Show a pattern, or nothing."""
        if pattern is None:
            self._bench.shown = None
            return
        self._bench.shown = _defocused(pattern, self._bench.projector.lens.size_px)


@lru_cache(maxsize=64)
def _defocused(pattern: Pattern, size_px: tuple[int, int]) -> Grey:
    image = pattern_image(pattern, size_px).astype(np.float32)
    border = cv2.BORDER_REPLICATE
    blurred = cv2.GaussianBlur(image, (0, 0), _PROJECTOR_SPREAD_PX, borderType=border)
    return np.asarray(blurred, dtype=np.float32)


class SimulatedTurntable:
    """Turns the object."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench

    def turn_to(self, angle_deg: float) -> None:
        """Turn to an angle."""
        self._bench.angle_deg = angle_deg


class SimulatedLampArc:
    """Lights the object from its stops."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench

    def light_from(self, stop: str | None) -> None:
        """Move to a stop and switch on; None switches off."""
        if stop is not None and stop not in self._bench.lamps:
            raise ValueError(f"no lamp stop {stop!r}; there are {sorted(self._bench.lamps)}")
        self._bench.lamp = stop


class SimulatedCamera:
    """Records what its rays see; grey 8 bits for patterns, or RGB 16 bits for photographs."""

    def __init__(
        self, bench: Bench, name: str, *, colour: bool, stored_bits: int, samples: int = 2
    ) -> None:
        self._bench, self._name = bench, name
        self._colour, self._bits, self._samples = colour, stored_bits, samples

    def expose(self, exposure_s: float) -> NDArray[np.uint8] | NDArray[np.uint16]:
        """Take one frame."""
        see = self._bench.photograph if self._colour else self._bench.under_pattern
        radiance = see(self._name, self._samples)
        light = gather(radiance, self._samples, _CAMERA_SPREAD_PX)
        return self._bench.sensor.record(light, exposure_s, self._bench.random, self._bits)


def standing_at(position_mm: Array, towards_mm: Array, lens: Lens) -> Camera:
    """Stand a camera somewhere, looking at a point, the rig's +y up in the picture."""
    forward = towards_mm - position_mm
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, np.array([0.0, 1.0, 0.0]))
    if np.linalg.norm(right) < 1e-6:
        right = np.array([1.0, 0.0, 0.0])
    right = right / np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    return Camera(lens, RigidTransform(rotation, -rotation @ position_mm))
