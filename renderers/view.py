"""Where the eye and the lamps are, in canvas coordinates.

Canvas coordinates: mm, x right, y up, z out of the paint, the origin at the centre of sample
(0, 0). Row 0 is the top, so a field of rows x columns samples spans x from 0 to
``(columns - 1) * spacing`` and y from ``-(rows - 1) * spacing`` to 0.

Directions towards the camera or a lamp are given as on a globe laid on the canvas: *azimuth* is
counter-clockwise from +x for someone in front of the painting (0 right, 90 top, 180 left, -90
bottom), *elevation* rises from the canvas plane (0 grazing, 90 along the normal):

    (cos azimuth cos elevation, sin azimuth cos elevation, sin elevation)
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import UsageError
from pipeline.formats.asset import Asset
from pipeline.geometry.camera import Camera, Lens
from pipeline.geometry.rigid import RigidTransform

Array = NDArray[np.float64]


@dataclass(frozen=True)
class View:
    """A camera whose pose takes canvas coordinates to the camera's frame."""

    camera: Camera

    @property
    def size_px(self) -> tuple[int, int]:
        """(width, height) of the image."""
        return self.camera.lens.size_px


@dataclass(frozen=True)
class Light:
    """A point lamp; E = intensity * colour * cos(theta) / r^2 with r in metres.

    Parameters
    ----------
    position_mm
        (3,) canvas coordinates.
    intensity
        Radiant intensity, W/sr, >= 0 (or any unit that the user keeps to).
    colour
        (3,) linear RGB factors, >= 0.
    """

    position_mm: Array
    intensity: float = float(np.pi)
    colour: Array = field(default_factory=lambda: np.ones(3))


def direction(azimuth_deg: float, elevation_deg: float) -> Array:
    """Return the unit vector (3,) of an azimuth and an elevation (see the module's text)."""
    azimuth, elevation = np.deg2rad(azimuth_deg), np.deg2rad(elevation_deg)
    return np.array(
        [
            np.cos(azimuth) * np.cos(elevation),
            np.sin(azimuth) * np.cos(elevation),
            np.sin(elevation),
        ]
    )


def orbit_view(
    canvas: Asset | tuple[float, float],
    *,
    azimuth_deg: float = -90.0,
    elevation_deg: float = 90.0,
    distance: float = 1.0,
    distance_mm: float | None = None,
    field_of_view_deg: float = 30.0,
    size_px: tuple[int, int] = (1280, 720),
    target_mm: NDArray[np.floating] | None = None,
) -> View:
    """Look at a canvas from a direction; the canvas's +y stays up in the picture.

    Parameters
    ----------
    canvas
        An asset, or (width, height) in mm of a flat canvas.
    azimuth_deg, elevation_deg
        Direction from the target to the camera; the elevation in (0, 90].
    distance
        In units of the *framed* distance, the smallest at which the whole canvas with its relief
        lies in the picture with a margin of 4 %; > 0.
    distance_mm
        The distance from the target in mm, > 0; takes the place of ``distance``.
    field_of_view_deg
        Vertical, between the outer edges of the top and bottom pixels, in (0, 170].
    size_px
        (width, height).
    target_mm
        (3,) point in the middle of the picture; the canvas's centre if left out.

    Raises
    ------
    UsageError
        A value lies outside its range.
    """
    _require(0 < elevation_deg <= 90, "elevation", elevation_deg, "more than 0, at most 90 degrees")
    _require(
        0 < field_of_view_deg <= 170,
        "field of view",
        field_of_view_deg,
        "more than 0, at most 170 degrees",
    )
    chosen = distance if distance_mm is None else distance_mm
    _require(chosen > 0 and bool(np.isfinite(chosen)), "distance", chosen, "a positive number")
    _require(min(size_px) >= 1, "picture size", size_px, "at least one pixel each way")

    corners = canvas_corners(canvas)
    target = corners.mean(axis=0) if target_mm is None else np.asarray(target_mm, dtype=np.float64)
    back = direction(azimuth_deg, elevation_deg)
    up = _up(back, azimuth_deg)
    right = np.cross(up, back)

    width, height = size_px
    tangent = np.tan(np.deg2rad(field_of_view_deg) / 2)
    if distance_mm is None:
        offset = corners - target
        across = np.abs(offset @ right) / (tangent * width / height)
        along = np.abs(offset @ up) / tangent
        distance_mm = distance * float(
            np.max(1.04 * np.maximum(across, along) + np.maximum(offset @ back, 0.0))
        )
    focal = height / (2 * tangent)
    K = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])
    rotation = np.stack([right, -up, -back])
    pose = RigidTransform(rotation, -rotation @ (target + distance_mm * back))
    return View(Camera(Lens(size_px, K), pose))


def arc_light(
    canvas: Asset | tuple[float, float],
    *,
    azimuth_deg: float = 135.0,
    elevation_deg: float = 45.0,
    distance_mm: float = 1000.0,
    intensity: float = float(np.pi),
    colour: NDArray[np.floating] | None = None,
) -> Light:
    """Hang a lamp on an arc about the canvas's centre.

    With the default intensity and distance a white matte surface (rho_d = 1/pi) that faces the
    lamp has radiance 1. Angles are those of the module's text; the elevation in (0, 90].

    Raises
    ------
    UsageError
        A value lies outside its range.
    """
    _require(0 < elevation_deg <= 90, "elevation", elevation_deg, "more than 0, at most 90 degrees")
    _require(distance_mm > 0, "distance", distance_mm, "a positive number of mm")
    _require(intensity >= 0, "intensity", intensity, "zero or more")
    centre = canvas_corners(canvas).mean(axis=0)
    position = centre + distance_mm * direction(azimuth_deg, elevation_deg)
    factors = np.ones(3) if colour is None else np.asarray(colour, dtype=np.float64)
    return Light(position, float(intensity), factors)


def canvas_corners(canvas: Asset | tuple[float, float]) -> Array:
    """Return the (8, 3) corners of the box that holds the canvas and its relief, mm."""
    if isinstance(canvas, Asset):
        rows, columns = canvas.heights_mm.shape
        width, height = (columns - 1) * canvas.spacing_mm, (rows - 1) * canvas.spacing_mm
        inside = canvas.heights_mm[canvas.mask & np.isfinite(canvas.heights_mm)]
        bottom, top = (float(inside.min()), float(inside.max())) if inside.size else (0.0, 0.0)
    else:
        (width, height), bottom, top = canvas, 0.0, 0.0
    return np.array(
        [[x, y, z] for x in (0.0, width) for y in (0.0, -height) for z in (bottom, top)]
    )


def _up(back: Array, azimuth_deg: float) -> Array:
    """Return the picture's upward direction: the canvas's +y, made perpendicular to ``back``."""
    up: Array = np.array([0.0, 1.0, 0.0]) - back[1] * back
    length = float(np.linalg.norm(up))
    if length < 1e-9:  # along the canvas's y axis: the limit of elevations above it
        sign = -np.sign(np.sin(np.deg2rad(azimuth_deg)))
        return np.array([0.0, 0.0, float(sign)])
    return np.asarray(up / length)


def _require(holds: bool, what: str, given: object, expected: str) -> None:
    if not holds:
        raise UsageError(f"the {what} is {given}", expected=expected)
