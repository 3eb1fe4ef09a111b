"""Registered placements on one grid: the canvas's axes, its heights and how well they are known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.extract.blend import Tile, blend, part_of
from pipeline.extract.canvas import ray_factor
from pipeline.extract.kernel import widest_kernel
from pipeline.extract.outline import skew_angle
from pipeline.extract.placements import Together
from pipeline.extract.plane import canvas_axes, facing, fit_plane
from pipeline.extract.register import Registration
from pipeline.extract.resample import Grid, check_size, grid_around, resample
from pipeline.geometry.camera import Camera
from pipeline.geometry.rigid import RigidTransform, rotation_about_axis

Array = NDArray[np.float64]
Image = NDArray[np.float32]

_CELL = 3.0  # point distances: the union's area is counted in such cells


@dataclass(frozen=True)
class Merged:
    """The canvas put together, in its own axes.

    Parameters
    ----------
    heights, sigma
        (rows, columns) float32 mm.
    grid
        Their grid in the canvas's axes.
    kernel_mm
        What they were resampled with.
    scan_from_canvas
        By patch, the canvas's axes to the scan's frame as the canvas lay then.
    skew_deg
        As that of :class:`pipeline.extract.canvas.Canvas`.
    share_overlap
        Share of the samples that more than one patch knows.
    """

    heights: Image
    sigma: Image
    grid: Grid
    kernel_mm: float
    scan_from_canvas: list[RigidTransform]
    skew_deg: float | None
    share_overlap: float


def canvas_frame(
    together: Together, camera: Camera, *, straighten: bool
) -> tuple[RigidTransform, float | None]:
    """Return the canvas's axes in those of the first patch, and its skew in degrees."""
    first, registration = together.patches[0], together.registration
    assert registration is not None
    points = np.concatenate(
        [m.apply(p.points) for m, p in zip(registration.motions, together.patches, strict=True)]
    )
    eye = first.eye_mm
    plane = facing(fit_plane(points, np.ones(len(points))), eye)
    seen = Camera(camera.lens, camera.pose @ first.scan_from_patch)
    frame = canvas_axes(plane, seen)
    flat = frame.inverse().apply(points)[:, :2]
    cell = _CELL * first.distance_mm
    area = len(np.unique(np.floor(flat / cell).astype(np.int64), axis=0)) * cell**2
    angle = skew_angle(flat, area)
    if straighten and angle is not None:
        turn = rotation_about_axis(np.zeros(3), np.array([0.0, 0.0, 1.0]), np.rad2deg(angle))
        frame = frame @ turn
    return frame, None if angle is None else float(np.rad2deg(angle))


def merge(
    together: Together,
    camera: Camera,
    spacing_mm: float,
    kernel_samples: float,
    *,
    straighten: bool,
    widen: bool,
    progress: Callable[[int, int], None],
) -> Merged:
    """Sample every patch on the canvas's grid and blend them.

    All patches are sampled with one kernel, lest the relief be sharper in one than in the next: the
    narrowest that the relief in any of them asks for.

    Raises
    ------
    ImpastoError
        If the canvas would have more samples than it may.
    """
    registration = together.registration
    assert registration is not None
    frame, skew = canvas_frame(together, camera, straighten=straighten)
    back = frame.inverse()
    moved = [
        (back @ m).apply(p.points)
        for m, p in zip(registration.motions, together.patches, strict=True)
    ]
    grid = grid_around(np.concatenate([_corners(points) for points in moved]), spacing_mm)
    check_size(grid)
    parts = [part_of(grid, points) for points in moved]
    coarsest = max(spacing_mm, *(patch.distance_mm for patch in together.patches))
    kernel = kernel_samples * coarsest
    if widen:
        kernel = min(
            widest_kernel(points, patch.sigma_mm, part, kernel)
            for patch, points, (_, _, part) in zip(together.patches, moved, parts, strict=True)
        )
    excess = excess_variance(registration)
    tiles = []
    for number, (patch, points) in enumerate(zip(together.patches, moved, strict=True)):
        progress(number, len(moved))
        row, column, part = parts[number]
        heights, sigma = resample(points, patch.sigma_mm, part, kernel)
        place = _places(part, heights)
        motion = registration.motions[number]
        eye = (back @ motion).apply(patch.eye_mm)
        sigma = (sigma * ray_factor(heights, spacing_mm, place, eye)).astype(np.float32)
        common = excess + _motion_variance(
            heights, place, frame, registration.covariances[number], registration.centre_mm
        )
        tiles.append(Tile(row, column, heights, sigma, common))
    heights, sigma, count = blend(tiles, (grid.rows, grid.columns))
    return Merged(
        heights,
        sigma,
        grid,
        kernel,
        [
            p.scan_from_patch @ m.inverse() @ frame
            for m, p in zip(registration.motions, together.patches, strict=True)
        ],
        skew,
        float((count > 1).sum() / max(1, int((count > 0).sum()))),
    )


def excess_variance(registration: Registration) -> float:
    """Return the variance (mm^2) of one patch beyond its own, as the overlaps show it.

    Half of what the heights of two differ by more than their standard deviations foretell.
    """
    area = np.array([o.area_mm2 for o in registration.overlaps])
    over = np.array([o.rms_mm**2 - o.expected_mm**2 for o in registration.overlaps])
    return float(max(0.0, 0.5 * np.average(over, weights=area)))


def registration_rms_mm(registration: Registration) -> float:
    """Return the robust RMS of the height differences over all overlaps."""
    area = [o.area_mm2 for o in registration.overlaps]
    return float(np.sqrt(np.average([o.rms_mm**2 for o in registration.overlaps], weights=area)))


def _corners(points: Array) -> Array:
    return np.array([points[:, :2].min(axis=0), points[:, :2].max(axis=0)])


def _places(grid: Grid, heights: Image) -> Array:
    x, y = np.meshgrid(
        grid.left_mm + np.arange(grid.columns) * grid.spacing_mm,
        grid.top_mm - np.arange(grid.rows) * grid.spacing_mm,
    )
    return np.stack([x, y, heights.astype(np.float64)], axis=-1)


def _motion_variance(
    heights: Image, place: Array, frame: RigidTransform, covariance: Array, centre: Array
) -> Array:
    """Carry the uncertainty of a patch's motion to the heights (rows, columns), mm^2.

    A shift t raises the surface at a place by t_z - g . (t_x, t_y), g its gradient.
    """
    if not covariance.any() or min(heights.shape) < 2:
        return np.zeros(heights.shape)
    down, right = np.nan_to_num(np.gradient(heights.astype(np.float64), _spacing(place)))
    normal = frame.rotate(np.stack([-right, down, np.ones_like(right)], axis=-1))
    arm = frame.apply(np.nan_to_num(place)) - centre
    lever = np.concatenate([np.cross(arm, normal), normal], axis=-1)
    return np.asarray(np.einsum("...i,ij,...j->...", lever, covariance, lever, optimize=True))


def _spacing(place: Array) -> float:
    return float(place[0, 1, 0] - place[0, 0, 0])
