"""The simulated rig: devices that share one scene, one clock and one source of noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hardware.devices import Frame, Rig
from hardware.simulated.layout import SCAN_CAMERA, Layout
from hardware.simulated.optics import (
    Eye,
    Image,
    Projection,
    Sensor,
    lens_rays,
    open_eye,
    project,
    projected_image,
    see_by_lamp,
    see_by_projector,
    spread,
)
from hardware.simulated.subjects import Subject
from pipeline.errors import HardwareError
from pipeline.formats.patterns import Pattern
from pipeline.geometry.camera import Lens

LAMP_SETTLES_S, PROJECTOR_SETTLES_S, OPERATOR_TAKES_S = 0.5, 0.1, 20.0
TABLE_DEG_PER_S, CARRIAGE_MM_PER_S = 20.0, 150.0


@dataclass(frozen=True)
class Physics:
    """What makes pictures differ from the ideal.

    Parameters
    ----------
    projector_intensity, lamp_intensity
        E = intensity cos / (r in m)^2.
    ambient
        Radiance of a white surface in the room's light; photographs are taken in the dark.
    gamma, black
        Of the projector: light = black + (1 - black) drive^gamma.
    defocus_px, spread_px
        Standard deviations of the projector's and the cameras' point spread, in their pixels.
    samples
        Rays per pixel along each axis.
    """

    projector_intensity: float = 1.0
    lamp_intensity: float = 1.0
    ambient: float = 0.003
    gamma: float = 1.0
    black: float = 0.002
    defocus_px: float = 0.5
    spread_px: float = 0.4
    samples: int = 2
    sensor: Sensor = field(default_factory=Sensor)


class Bench:
    """The scene that the devices share: what lies there, how it is lit, and what time it is.

    Parameters
    ----------
    subjects
        Makes a subject at an angle of the table, by the name that the operator knows.
    seed
        Of the sensors' noise: frame n is the same whatever is done at the same time.
    """

    def __init__(
        self,
        layout: Layout,
        subjects: dict[str, Callable[[float], Subject]],
        physics: Physics,
        seed: int,
    ) -> None:
        self.layout, self.physics, self.subjects = layout, physics, subjects
        self.clock_s = 0.0
        self.angle_deg = 0.0
        self.stop: str | None = None
        self.lamp_on = False
        self.pattern: Pattern | None = None
        self.placed: str | None = None
        self._seed, self._frames = seed, 0
        self._eyes: dict[str, Eye] = {}
        self._rays: tuple[Lens, NDArray[np.float64]] | None = None
        # The last of each only: a capture goes through states one after another.
        self._subject: tuple[object, Subject] | None = None
        self._projection: tuple[object, Projection] | None = None
        self._radiance: tuple[object, Image] | None = None

    def rig(self) -> Rig:
        """Return the devices."""
        return Rig(
            {name: SimulatedCamera(self, name) for name in self.layout.cameras},
            SimulatedProjector(self),
            SimulatedTurntable(self),
            SimulatedArc(self),
            SimulatedLamp(self),
            SimulatedOperator(self),
        )

    def eye(self, name: str) -> Eye:
        """Return a camera's rays."""
        if name not in self._eyes:
            camera = self.layout.cameras[name]
            if self._rays is None or self._rays[0] is not camera.lens:
                self._rays = camera.lens, lens_rays(camera.lens, self.physics.samples)
            self._eyes[name] = open_eye(camera, self._rays[1])
        return self._eyes[name]

    def subject(self) -> Subject:
        """Return what lies there now."""
        if self.placed is None:
            raise HardwareError("nothing lies before the cameras", fix="place a subject first")
        key = (self.placed, self.angle_deg)
        if self._subject is None or self._subject[0] != key:
            self._subject = key, self.subjects[self.placed](self.angle_deg)
        return self._subject[1]

    def radiance(self, camera: str) -> Image:
        """Return what a camera's pixels receive now."""
        state = (camera, self.placed, self.angle_deg)
        key = (*state, self.stop if self.lamp_on else None, self.pattern)
        if self._radiance is None or self._radiance[0] != key:
            ideal = self._by_pattern(state) if camera == SCAN_CAMERA else self._by_lamp(camera)
            self._radiance = key, spread(ideal, self.physics.spread_px)
        return self._radiance[1]

    def noise(self) -> np.random.Generator:
        """Return the next frame's noise."""
        self._frames += 1
        return np.random.default_rng([self._seed, self._frames])

    def _by_lamp(self, camera: str) -> Image:
        if not self.lamp_on or self.stop is None:
            width, height = self.layout.cameras[camera].lens.size_px
            return np.zeros((height, width, 3), np.float32)
        source = self.layout.stops[self.stop]
        return see_by_lamp(self.eye(camera), self.subject(), source, self.physics.lamp_intensity)

    def _by_pattern(self, state: tuple[str, str | None, float]) -> Image:
        """See a pattern; geometry is worked out once for all patterns of a state."""
        physics, projector = self.physics, self.layout.projector
        if self.lamp_on:
            raise HardwareError("the lamp outshines the projector", fix="switch the lamp off")
        if self._projection is None or self._projection[0] != state:
            self._projection = (
                state,
                project(
                    self.eye(state[0]),
                    self.subject(),
                    projector,
                    physics.projector_intensity,
                    physics.ambient,
                ),
            )
        shown = None
        if self.pattern is not None:
            shown = projected_image(
                self.pattern,
                projector.lens.size_px,
                gamma=physics.gamma,
                defocus_px=physics.defocus_px,
                black=physics.black,
            )
        return see_by_projector(self._projection[1], shown)


class SimulatedCamera:
    """Records what its rays see: the scan camera in grey, the photo camera in colour."""

    def __init__(self, bench: Bench, name: str) -> None:
        self._bench, self._name = bench, name

    def capture(self, exposure_s: float) -> Frame:
        """Take one frame."""
        bench = self._bench
        if not 1e-6 <= exposure_s <= 60:
            raise HardwareError(
                f"the camera cannot expose for {exposure_s:g} s", expected="1e-6 s to 60 s"
            )
        bench.clock_s += exposure_s
        radiance = bench.radiance(self._name)
        return Frame(bench.physics.sensor.record(radiance, exposure_s, bench.noise()), exposure_s)


class SimulatedProjector:
    """Shows patterns with its gamma and its lens's defocus."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench

    def show(self, pattern: Pattern | None) -> None:
        """Show a pattern, or nothing."""
        self._bench.clock_s += PROJECTOR_SETTLES_S
        self._bench.pattern = pattern


class SimulatedTurntable:
    """Turns the painting."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench

    def move_to(self, angle_deg: float) -> None:
        """Turn to an angle."""
        self._bench.clock_s += abs(angle_deg - self._bench.angle_deg) / TABLE_DEG_PER_S
        self._bench.angle_deg = angle_deg


class SimulatedArc:
    """Carries the lamp from stop to stop."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench

    def move_to(self, stop: str) -> None:
        """Move to a stop."""
        bench, stops = self._bench, self._bench.layout.stops
        if stop not in stops:
            raise HardwareError(
                f"the arc has no stop {stop!r}", expected=f"one of {', '.join(sorted(stops))}"
            )
        way: NDArray[np.float64] = stops[stop] - stops[bench.stop or min(stops)]
        bench.clock_s += float(np.linalg.norm(way)) / CARRIAGE_MM_PER_S
        bench.stop = stop


class SimulatedLamp:
    """Lights the subject from the carriage."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench

    def switch(self, on: bool) -> None:
        """Switch on or off."""
        if on != self._bench.lamp_on:
            self._bench.clock_s += LAMP_SETTLES_S
        self._bench.lamp_on = on


class SimulatedOperator:
    """Puts things in place without a word."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench

    def place(self, what: str) -> None:
        """Put something in place."""
        bench = self._bench
        if what not in bench.subjects:
            raise HardwareError(
                f"there is no {what!r}", expected=f"one of {', '.join(sorted(bench.subjects))}"
            )
        if what != bench.placed:
            bench.clock_s += OPERATOR_TAKES_S
        bench.placed = what
