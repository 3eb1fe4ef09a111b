"""Finding the canvas: its plane, its region and its axes, each from the others."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import ImpastoError
from pipeline.extract.grow import Region, grow
from pipeline.extract.outline import skew_angle
from pipeline.extract.plane import canvas_axes, facing, fit_plane
from pipeline.geometry.camera import Camera
from pipeline.geometry.rigid import RigidTransform, rotation_about_axis

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_ROUNDS = 4
_SETTLED_DEG = 0.25
_COARSE_PIXELS = 300_000
_MARGIN = 0.1  # of the region's extent
_CENTRE_WIDTH = 0.2  # of the picture's smaller side
_CENTRAL = 0.3  # share of the measured pixels taken for canvas before anything is known
_FEWEST = 100
_LEAST_FACING = 0.1  # cosine between the normal and the line of sight


@dataclass(frozen=True)
class Canvas:
    """The canvas in a range image.

    Parameters
    ----------
    scene_from_canvas
        Axes of the canvas: z out of the paint, y up, origin on the plane in the middle.
    points
        (N, 3) its points in those axes, mm.
    region
        The pixels they come from, in the picture that was given.
    skew_deg
        How far the canvas hung turned counter-clockwise; None if it has no straight edges.
    """

    scene_from_canvas: RigidTransform
    points: Array
    region: Region
    skew_deg: float | None


def find_canvas(
    points_mm: NDArray[np.floating],
    sigma_mm: NDArray[np.floating],
    camera: Camera,
    erosion_px: int,
    *,
    straighten: bool = True,
) -> Canvas:
    """Find the canvas in the middle of a range image.

    Parameters
    ----------
    points_mm
        (rows, columns, 3) in the scene's frame; NaN where not measured.
    sigma_mm
        (rows, columns) standard deviation of each point.
    camera
        The scan camera: the paint faces it, and its picture says where up is.
    erosion_px
        Rim left out.
    straighten
        Turn a rectangular canvas so that its sides lie along the axes.

    Raises
    ------
    ImpastoError
        If there is no surface in the middle of the picture, or it is seen edge-on.

    Notes
    -----
    The plane of the most central points starts a region; the region's own plane replaces it until
    the normal settles (spec 1.2 does this once). A large picture is thinned for the start; then
    only the part around the region is looked at.
    """
    step = 1 + int(np.sqrt(sigma_mm.size / _COARSE_PIXELS))
    coarse = np.s_[::step, ::step]
    valid = np.isfinite(points_mm[coarse]).all(axis=2)
    near, weight = _central(valid)
    _, region = _settle(points_mm[coarse], sigma_mm[coarse], near, weight, camera, 0)
    if step > 1:
        near = region.mask.repeat(step, axis=0).repeat(step, axis=1)
        near = near[: sigma_mm.shape[0], : sigma_mm.shape[1]]
    else:
        near = region.mask
    part = _around(near)
    near = near[part] & np.isfinite(points_mm[part]).all(axis=2)
    frame, region = _settle(
        points_mm[part], sigma_mm[part], near, near.astype(np.float64), camera, erosion_px
    )
    whole = np.zeros(sigma_mm.shape, bool)
    whole[part] = region.mask
    region = replace(region, mask=whole)
    canvas = frame.inverse().apply(points_mm[whole])
    pixel_area = region.sampling.across_mm * region.sampling.down_mm
    angle = skew_angle(canvas[:, :2], len(canvas) * pixel_area)
    if straighten and angle is not None:
        turn = rotation_about_axis(np.zeros(3), np.array([0.0, 0.0, 1.0]), np.rad2deg(angle))
        frame, canvas = frame @ turn, turn.inverse().apply(canvas)
    return Canvas(frame, canvas, region, None if angle is None else float(np.rad2deg(angle)))


def _settle(
    points: NDArray[np.floating],
    sigma: NDArray[np.floating],
    near: Mask,
    weight: Array,
    camera: Camera,
    erosion_px: int,
) -> tuple[RigidTransform, Region]:
    """Alternate plane and region until the plane stays; return the region and its own axes."""
    plane = facing(fit_plane(points[near], weight[near]), camera.centre_mm)
    for _ in range(_ROUNDS):
        canvas = canvas_axes(plane, camera).inverse().apply(points)
        region = grow(canvas, sigma, near, weight, erosion_px)
        near, previous = region.mask, plane
        plane = facing(fit_plane(points[near], np.ones(near.sum())), camera.centre_mm)
        if plane.normal @ previous.normal > np.cos(np.deg2rad(_SETTLED_DEG)):
            break
    sight = plane.centre_mm - camera.centre_mm
    if abs(plane.normal @ sight) < _LEAST_FACING * np.linalg.norm(sight):
        raise ImpastoError(
            "the points scatter along the lines of sight, not over a surface",
            where="scan/range.exr",
            expected="a surface that faces the scan camera",
            fix="look at the range map (impasto report), the calibration and the exposures",
        )
    return canvas_axes(plane, camera), region


def _around(mask: Mask) -> tuple[slice, slice]:
    """Return the part of the picture around a region, with a margin."""
    part = []
    for axis, size in enumerate(mask.shape):
        used = np.flatnonzero(mask.any(axis=1 - axis))
        margin = 8 + int(_MARGIN * (used[-1] - used[0]))
        part.append(slice(max(0, used[0] - margin), min(size, used[-1] + 1 + margin)))
    return part[0], part[1]


def _centre_weight(shape: tuple[int, int]) -> Array:
    """Return a Gaussian around the picture's centre, (rows, columns)."""
    width = _CENTRE_WIDTH * min(shape)
    rows, columns = (np.arange(n) - (n - 1) / 2 for n in shape)
    return np.asarray(np.exp(-(rows[:, None] ** 2 + columns[None] ** 2) / (2 * width**2)))


def ray_factor(
    heights_mm: NDArray[np.floating], spacing_mm: float, points: Array, eye_mm: Array
) -> Array:
    """Return how much a height moves when its point moves by one along the viewing ray.

    Parameters
    ----------
    heights_mm, points
        (rows, columns) and (rows, columns, 3): the height field, y up while rows go down.
    eye_mm
        (3,) the camera's centre, in the axes of the points.

    Notes
    -----
    A point moved by s d rises by s d_z, and lands where the surface is s g . (d_x, d_y) higher
    (g its gradient): the height at a place changes by d_z - g . (d_x, d_y).
    """
    slope = np.zeros((2, *heights_mm.shape))  # down, right
    if min(heights_mm.shape) > 1:
        slope = np.nan_to_num(np.array(np.gradient(heights_mm.astype(np.float64), spacing_mm)))
    ray = points - eye_mm
    ray = ray / np.linalg.norm(ray, axis=-1, keepdims=True)
    return np.asarray(np.abs(ray[..., 2] - slope[1] * ray[..., 0] + slope[0] * ray[..., 1]))


def _central(valid: Mask) -> tuple[Mask, Array]:
    """Return the measured pixels nearest the picture's centre, and their weights."""
    weight = _centre_weight((valid.shape[0], valid.shape[1]))
    count = int(np.count_nonzero(valid))
    if count < _FEWEST:
        raise ImpastoError(
            f"only {count} points were measured",
            where="scan/range.exr",
            expected="the object in the middle of the scan camera's picture",
            fix="look at the captured frames and their exposures",
        )
    least = np.quantile(weight[valid], 1 - max(_CENTRAL, _FEWEST / count))
    return valid & (weight >= least), weight
