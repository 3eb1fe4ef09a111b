"""Where the camera and the lamp of each photograph stood, seen from the canvas.

The table turns the object; seen from the object, the camera and the lamp turn the other way.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.calibration import Calibration
from pipeline.formats.capture import Photo
from pipeline.geometry.camera import Camera
from pipeline.geometry.rigid import RigidTransform, rotation_about_axis
from pipeline.reflectance.places import Places


@dataclass(frozen=True)
class Station:
    """A photograph with its geometry in canvas coordinates, mm."""

    photo: Photo
    camera: Camera
    light_mm: NDArray[np.float64]
    intensity: float
    intensity_known: bool


def stations(
    photos: Iterable[Photo],
    calibration: Calibration,
    scan_from_canvas: RigidTransform,
    scan_turntable_deg: float | None,
    places: Places | None = None,
) -> tuple[list[Station], dict[str, str]]:
    """Place every photograph that can be placed; a pose that the bundle gives goes first.

    Returns
    -------
    The stations, and for each photograph left out its file with the reason, in words.
    """
    places = places or Places()
    placed: list[Station] = []
    left_out: dict[str, str] = {}
    for photo in photos:
        reason = _unknown(photo, calibration, scan_turntable_deg, places)
        if reason:
            left_out[photo.file] = reason
            continue
        turned = _turn(photo, calibration, scan_turntable_deg) @ scan_from_canvas
        pose = calibration.poses.get(photo.camera) or places.poses[photo.file]
        light = calibration.lights[photo.light or ""]
        placed.append(
            Station(
                photo,
                Camera(calibration.lenses[photo.camera], pose @ turned),
                turned.inverse().apply(light.position_mm),
                light.intensity,
                light.intensity_known,
            )
        )
    return placed, left_out


def _unknown(
    photo: Photo, calibration: Calibration, scan_turntable_deg: float | None, places: Places
) -> str | None:
    if photo.camera not in calibration.lenses:
        return f"the lens of camera {photo.camera} is not calibrated"
    if photo.camera not in calibration.poses and photo.file not in places.poses:
        return places.reasons.get(
            photo.file,
            f"the pose of camera {photo.camera} is not known (a pose sequence that the photograph "
            "names, or R and t_mm in capture.json)",
        )
    if photo.light is None:
        return "it names no lamp"
    if photo.light not in calibration.lights:
        reason = places.lamp_reasons.get(
            photo.light, "a light sequence, or position_mm in capture.json"
        )
        return f"the position of lamp {photo.light} is not known ({reason})"
    if _angle(photo, scan_turntable_deg) != 0 and calibration.turntable is None:
        return "the table was turned and its axis is not known (turntable in capture.json)"
    return None


def _angle(photo: Photo, scan_turntable_deg: float | None) -> float:
    """Return how far the table turned since the scan; an angle not given means it did not."""
    if photo.turntable_deg is None:
        return 0.0
    return photo.turntable_deg - (scan_turntable_deg or 0.0)


def _turn(
    photo: Photo, calibration: Calibration, scan_turntable_deg: float | None
) -> RigidTransform:
    angle = _angle(photo, scan_turntable_deg)
    if angle == 0 or calibration.turntable is None:
        return RigidTransform()
    table = calibration.turntable
    return rotation_about_axis(table.axis_point_mm, table.axis_direction, angle)
