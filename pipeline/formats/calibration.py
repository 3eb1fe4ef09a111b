"""What calibration knows of the rig, and its file ``calibrate/calibration.json``."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import ImpastoError
from pipeline.geometry.camera import Camera, Lens
from pipeline.geometry.rigid import RigidTransform


@dataclass(frozen=True)
class Turntable:
    """The table's axis in the scan's frame; +angle turns counter-clockwise seen from its tip."""

    axis_point_mm: NDArray[np.float64]
    axis_direction: NDArray[np.float64]


@dataclass(frozen=True)
class Light:
    """A lamp: irradiance E = intensity cos(theta) / (distance in m)^2."""

    position_mm: NDArray[np.float64]
    intensity: float = 1.0
    intensity_known: bool = True


@dataclass(frozen=True)
class Residuals:
    """How well a device's observations fit: RMS in px, and parameter standard deviations.

    ``standard_deviation`` maps a parameter's name (``fx``, ``k1``, ``t_x`` ...) to its standard
    deviation in that parameter's unit; empty where the bundle gave the calibration.
    """

    rms_px: float | None = None
    observations: int = 0
    standard_deviation: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Calibration:
    """All that the stages need to know of the rig.

    Every pose takes the *scan's frame* to the device: the rig frame where the bundle defines it
    (``frame == "rig"``), else the scan camera's own frame (``frame == "camera"``).

    Parameters
    ----------
    lenses
        Intrinsics by camera name.
    poses
        Scan frame to camera, for the cameras whose pose is known.
    projector
        An inverse camera.
    origin
        By device name (``projector`` for the projector): ``given`` by the bundle, or
        ``calibrated`` from its board sequences.
    scale_known
        False if lengths are in board units, not mm.
    """

    frame: Literal["rig", "camera"]
    scan_camera: str
    lenses: dict[str, Lens]
    poses: dict[str, RigidTransform]
    projector: Camera | None
    turntable: Turntable | None = None
    lights: dict[str, Light] = field(default_factory=dict)
    residuals: dict[str, Residuals] = field(default_factory=dict)
    origin: dict[str, str] = field(default_factory=dict)
    scale_known: bool = True

    def camera(self, name: str) -> Camera:
        """Return the named camera with its pose, or say what is not known of it."""
        if name not in self.lenses:
            raise ImpastoError(
                f"camera {name!r} is not calibrated",
                where="calibration.json: cameras",
                expected=f"one of {sorted(self.lenses)}",
            )
        if name not in self.poses:
            raise ImpastoError(
                f"the pose of camera {name!r} is not known",
                where=f"calibration.json: cameras.{name}",
                fix="give its R and t_mm in capture.json",
            )
        return Camera(self.lenses[name], self.poses[name])
