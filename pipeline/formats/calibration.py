"""What calibration knows of the rig, and its file ``calibrate/calibration.json``."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from pipeline.errors import ImpastoError
from pipeline.formats.artifact import Artifact
from pipeline.formats.capture import Matrix, Size, Vector
from pipeline.formats.strict_json import parse_model, read_text
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


_FILE = "calibrate/calibration.json"


class _Entry(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class _Device(_Entry):
    size_px: Size
    K: Matrix
    distortion: tuple[float, float, float, float, float]
    R: Matrix | None = None
    t_mm: Vector | None = None
    origin: str | None = None
    rms_px: float | None = None
    observations: int = 0
    standard_deviation: dict[str, float] = {}
    from_camera: dict[str, Any] | None = None


class _Table(_Entry):
    axis_point_mm: Vector
    axis_direction: Vector


class _Lamp(_Entry):
    position_mm: Vector
    intensity: float
    intensity_known: bool


class _Document(_Entry):
    format: Literal["impasto-calibration"]
    version: Literal[1]
    frame: Literal["rig", "camera"]
    convention: str
    scale_known: bool
    scan_camera: str
    cameras: dict[str, _Device]
    projector: _Device | None
    turntable: _Table | None
    lights: dict[str, _Lamp]


_PROJECTOR = "projector"


def _save(workspace: Path, calibration: Calibration) -> None:
    cameras = {
        name: _device(calibration, name, lens, calibration.poses.get(name))
        for name, lens in calibration.lenses.items()
    }
    projector = None
    if calibration.projector is not None:
        lens, pose = calibration.projector.lens, calibration.projector.pose
        projector = _device(calibration, _PROJECTOR, lens, pose)
        base = calibration.poses.get(calibration.scan_camera)
        if base is not None:
            relative = pose @ base.inverse()
            projector["from_camera"] = {
                "camera": calibration.scan_camera,
                "R": relative.rotation.tolist(),
                "t_mm": relative.translation_mm.tolist(),
            }
    table = calibration.turntable
    document = {
        "format": "impasto-calibration",
        "version": 1,
        "frame": calibration.frame,
        "convention": "R and t_mm take the scan's frame to the device: x_device = R x + t_mm",
        "scale_known": calibration.scale_known,
        "scan_camera": calibration.scan_camera,
        "cameras": cameras,
        "projector": projector,
        "turntable": None
        if table is None
        else {
            "axis_point_mm": table.axis_point_mm.tolist(),
            "axis_direction": table.axis_direction.tolist(),
        },
        "lights": {
            name: {
                "position_mm": light.position_mm.tolist(),
                "intensity": light.intensity,
                "intensity_known": light.intensity_known,
            }
            for name, light in calibration.lights.items()
        },
    }
    text = json.dumps(document, indent=1, allow_nan=False)
    (workspace / _FILE).write_text(text + "\n", encoding="utf-8")


def _device(
    calibration: Calibration, name: str, lens: Lens, pose: RigidTransform | None
) -> dict[str, Any]:
    residuals = calibration.residuals.get(name, Residuals())
    return {
        "size_px": list(lens.size_px),
        "K": lens.K.tolist(),
        "distortion": lens.distortion.tolist(),
        "R": None if pose is None else pose.rotation.tolist(),
        "t_mm": None if pose is None else pose.translation_mm.tolist(),
        "origin": calibration.origin.get(name),
        "rms_px": residuals.rms_px,
        "observations": residuals.observations,
        "standard_deviation": residuals.standard_deviation,
    }


def _load(workspace: Path) -> Calibration:
    path = workspace / _FILE
    document = parse_model(_Document, read_text(path, where=_FILE), where=_FILE)
    devices = dict(document.cameras)
    if document.projector is not None:
        devices[_PROJECTOR] = document.projector
    poses = {name: pose for name, entry in devices.items() if (pose := _pose(name, entry))}
    projector = None
    if document.projector is not None:
        if _PROJECTOR not in poses:
            raise ImpastoError("it has no R and t_mm", where=f"{_FILE}: projector")
        projector = Camera(_lens(document.projector), poses.pop(_PROJECTOR))
    table = document.turntable
    return Calibration(
        frame=document.frame,
        scan_camera=document.scan_camera,
        lenses={name: _lens(entry) for name, entry in document.cameras.items()},
        poses=poses,
        projector=projector,
        turntable=None
        if table is None
        else Turntable(np.array(table.axis_point_mm), np.array(table.axis_direction)),
        lights={
            name: Light(np.array(lamp.position_mm), lamp.intensity, lamp.intensity_known)
            for name, lamp in document.lights.items()
        },
        residuals={
            name: Residuals(entry.rms_px, entry.observations, dict(entry.standard_deviation))
            for name, entry in devices.items()
            if entry.rms_px is not None
        },
        origin={name: entry.origin for name, entry in devices.items() if entry.origin},
        scale_known=document.scale_known,
    )


def _lens(entry: _Device) -> Lens:
    return Lens(entry.size_px, np.array(entry.K), np.array(entry.distortion))


def _pose(name: str, entry: _Device) -> RigidTransform | None:
    if entry.R is None or entry.t_mm is None:
        return None
    rotation = np.array(entry.R)
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-6 or np.linalg.det(rotation) < 0:
        raise ImpastoError("R is not a rotation", where=f"{_FILE}: {name}.R")
    return RigidTransform(rotation, np.array(entry.t_mm))


CALIBRATION = Artifact((_FILE,), _load, _save)
