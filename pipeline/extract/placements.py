"""A canvas larger than the field: its placements found, registered and put together."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import ImpastoError
from pipeline.extract.blend import Tile, blend, part_of
from pipeline.extract.canvas import ray_factor
from pipeline.extract.correlate import SIGNIFICANT, CoarseMap, Match, coarse, coarse_spacing, match
from pipeline.extract.outline import skew_angle
from pipeline.extract.patch import Patch, find_patch, make_map, map_spacing
from pipeline.extract.plane import canvas_axes, facing, fit_plane
from pipeline.extract.register import Registration, register
from pipeline.extract.resample import Grid, check_size, grid_around, resample
from pipeline.formats.placement_scans import PlacementScan
from pipeline.geometry.camera import Camera
from pipeline.geometry.rigid import RigidTransform, rotation_about_axis

Array = NDArray[np.float64]
Image = NDArray[np.float32]

_CELL = 3.0  # point distances: the union's area is counted in such cells


@dataclass(frozen=True)
class Together:
    """Patches that were registered, in the order of their scans; the first is the first scan's.

    Parameters
    ----------
    patches
        Those that belong together.
    registration
        Their motions.
    left_out
        Why each of the others does not, by name.
    """

    patches: list[Patch]
    registration: Registration | None
    left_out: dict[str, str]


@dataclass(frozen=True)
class Merged:
    """The canvas put together, in its own axes.

    Parameters
    ----------
    heights, sigma
        (rows, columns) float32 mm.
    grid
        Their grid in the canvas's axes.
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
    scan_from_canvas: list[RigidTransform]
    skew_deg: float | None
    share_overlap: float


def find_together(
    scans: list[PlacementScan],
    camera: Camera,
    projector_mm: Array,
    erosion_px: int,
    progress: Callable[[int, int], None],
) -> Together:
    """Find the canvas in every placement and register what overlaps, over others, with the first.

    Raises
    ------
    ImpastoError
        If there is no canvas in the first.
    """
    patches: list[Patch] = []
    left_out: dict[str, str] = {}
    for done, scan in enumerate(scans):
        progress(done, len(scans))
        try:
            patches.append(
                find_patch(
                    scan.name,
                    scan.range_image,
                    scan.texture,
                    camera,
                    projector_mm,
                    erosion_px,
                )
            )
        except ImpastoError as problem:
            if not patches:
                raise
            left_out[scan.name] = problem.problem
    spacing = map_spacing(patches)
    maps = [make_map(patch, spacing) for patch in patches]
    start, weakest = _first_guess([coarse(one, coarse_spacing(maps)) for one in maps])
    for k, patch in enumerate(patches):
        if k not in start:
            left_out[patch.name] = "no overlap with the others was found"
    while len(start) > 1:
        used = sorted(start)
        try:
            found = register([maps[k] for k in used], [start[k] for k in used])
        except ValueError as problem:
            for k in used[1:]:
                left_out[patches[k].name] = str(problem)
            break
        wrong = _disagreeing(found, used, weakest)
        if wrong is None:
            return Together([patches[k] for k in used], found, left_out)
        left_out[patches[wrong].name] = "its relief does not agree with the others' where they meet"
        start = {k: motion for k, motion in start.items() if k != wrong}
    return Together(patches[:1], None, left_out)


def _first_guess(maps: list[CoarseMap]) -> tuple[dict[int, RigidTransform], dict[int, float]]:
    """Return rough motions by number, and the score by which each patch was joined.

    The strongest match joins first (the maximum spanning tree of Prim 1957), so that a weak overlap
    is left aside where there is a way round it.
    """
    pairs: dict[tuple[int, int], Match] = {
        (i, j): match(maps[i], maps[j]) for i, j in combinations(range(len(maps)), 2)
    }
    motions, scores = {0: RigidTransform()}, {0: np.inf}
    while True:
        reach = [
            (pair.score, i, j)
            for (i, j), pair in pairs.items()
            if pair.score >= SIGNIFICANT and (i in motions) != (j in motions)
        ]
        if not reach:
            return motions, scores
        score, i, j = max(reach)
        motion = pairs[i, j].motion
        if i in motions:
            motions[j], scores[j] = motions[i] @ motion, score
        else:
            motions[i], scores[i] = motions[j] @ motion.inverse(), score


def _disagreeing(found: Registration, used: list[int], scores: dict[int, float]) -> int | None:
    """Return the patch, not the first, that was joined most weakly of those that do not agree."""
    held = {k for o in found.overlaps for k in (o.first, o.second)}
    wrong = {k for o in found.overlaps if not o.agrees for k in (o.first, o.second)}
    wrong |= set(range(len(used))) - held
    wrong.discard(0)
    return min((used[k] for k in wrong), key=lambda k: scores[k], default=None)


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
    progress: Callable[[int, int], None],
) -> Merged:
    """Sample every patch on the canvas's grid and blend them.

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
    excess = excess_variance(registration)
    tiles = []
    for number, (patch, points) in enumerate(zip(together.patches, moved, strict=True)):
        progress(number, len(moved))
        row, column, part = part_of(grid, points)
        kernel = kernel_samples * max(patch.distance_mm, spacing_mm)
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
