"""Points of the scanned canvas that a camera sees by the projector's light, without markers.

The code of a sequence gives a camera pixel a projector coordinate; the calibrated projector's ray
there meets the scanned surface, turned as the table had turned it, in a 3-D point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion, distance_transform_edt

from pipeline.formats.height_field import HeightField
from pipeline.geometry.camera import Camera
from pipeline.geometry.height_grid import normals
from pipeline.geometry.raycast import RayCaster
from pipeline.geometry.rigid import RigidTransform
from pipeline.structured_light.coordinates import ProjectorCoordinates
from pipeline.structured_light.footprint import (
    REMAINDER,
    TYPICAL_VARIANCE_PX2,
    local_slope,
    log_gradient,
)

Array = NDArray[np.float64]

MOST_POINTS = 8000
"""More add nothing to six parameters."""

MARGIN = 0.03
"""Share of the canvas's smaller side that is left out along its border, where frames shade."""

FLATTEST = 0.15
"""Sine of the least angle between ray and surface; flatter, a height error moves the point far."""

LARGEST_STRETCH = 20.0
"""Camera pixels per projector pixel, or the reverse, beyond which a coordinate says nothing."""


@dataclass(frozen=True)
class Surface:
    """The canvas made ready for rays: ``inside`` is True well inside it."""

    field: HeightField
    caster: RayCaster
    inside: NDArray[np.bool_]
    normals: NDArray[np.float32]

    @classmethod
    def of(cls, field: HeightField) -> Surface:
        """Prepare a height field."""
        known = np.isfinite(field.surface_mm)
        margin = max(2.0, MARGIN * min(known.shape))
        away = distance_transform_edt(np.pad(known, 1))[1:-1, 1:-1]
        return cls(
            field,
            RayCaster(field.surface_mm, field.spacing_mm),
            (away > margin) & ~field.filled,
            normals(field.surface_mm, field.spacing_mm),
        )


@dataclass(frozen=True)
class SurfacePoints:
    """What one sequence tells of the canvas; N points, spread over the image.

    Parameters
    ----------
    points_mm
        (N, 3) on the surface, canvas coordinates.
    normals
        (N, 3) the surface's unit normals there.
    rays
        (N, 3) directions from the projector, canvas coordinates.
    pixels
        (N, 2) the camera pixels that see them.
    sigma_px
        (N,) their standard deviation, camera px.
    edges
        (N, 2) gradient of the log albedo over the image, 1/px.
    """

    points_mm: Array
    normals: Array
    rays: Array
    pixels: Array
    sigma_px: Array
    edges: Array

    def __len__(self) -> int:
        return len(self.pixels)


def surface_points(
    coordinates: ProjectorCoordinates,
    projector: Camera,
    surface: Surface,
    scan_from_canvas: RigidTransform,
) -> SurfacePoints:
    """Meet the rays of all decoded pixels with the canvas.

    Parameters
    ----------
    coordinates
        Both axes coded.
    projector
        In the scan's frame.
    scan_from_canvas
        Where the canvas was while the sequence was taken.
    """
    if coordinates.x is None or coordinates.y is None:
        raise ValueError("both axes are needed")
    usable = np.isfinite(coordinates.x) & np.isfinite(coordinates.y)
    # Next to a pixel that shows nothing lies an edge in depth or a shadow.
    usable = binary_erosion(usable, np.ones((3, 3), np.bool_), border_value=0)
    edge_x, edge_y = log_gradient(coordinates.radiance)
    spread = _deviation(coordinates)
    spread = np.hypot(spread, REMAINDER * TYPICAL_VARIANCE_PX2 * np.hypot(edge_x, edge_y))
    rows, columns = np.nonzero(usable & np.isfinite(spread))
    seen = np.stack([coordinates.x[rows, columns], coordinates.y[rows, columns]], axis=1)
    canvas_from_scan = scan_from_canvas.inverse()
    origin, rays = projector.rays(seen)
    origin, rays = canvas_from_scan.apply(origin), canvas_from_scan.rotate(rays)
    points = origin + surface.caster.first_hit(origin, rays)[:, None] * rays
    row, column, good = _nearest_sample(points, surface)
    normal = surface.normals[row, column].astype(np.float64)
    sine = np.abs(np.einsum("ij,ij->i", normal, rays)) / np.linalg.norm(rays, axis=1)
    kept = np.flatnonzero(good & surface.inside[row, column] & (sine > FLATTEST))
    kept = kept[_well_spread(rows[kept], columns[kept], spread[rows[kept], columns[kept]])]
    rows, columns = rows[kept], columns[kept]
    return SurfacePoints(
        points[kept],
        normal[kept],
        rays[kept],
        np.stack([columns, rows], axis=1).astype(np.float64),
        spread[rows, columns].astype(np.float64),
        np.stack([edge_x[rows, columns], edge_y[rows, columns]], axis=1).astype(np.float64),
    )


def _deviation(coordinates: ProjectorCoordinates) -> NDArray[np.float32]:
    """Return the decoded coordinates' standard deviation in camera px; NaN where too stretched."""
    assert coordinates.x is not None
    assert coordinates.y is not None
    assert coordinates.sigma_x is not None
    assert coordinates.sigma_y is not None
    slopes = np.stack([*local_slope(coordinates.x), *local_slope(coordinates.y)])
    determinant = np.abs(slopes[0] * slopes[3] - slopes[1] * slopes[2])
    size = np.sqrt((slopes**2).sum(axis=0))
    with np.errstate(divide="ignore", invalid="ignore"):
        # |inverse| = |matrix| / determinant in the plane, in Frobenius' norm.
        stretch = size / determinant
        deviation = np.hypot(coordinates.sigma_x, coordinates.sigma_y) / 2 * stretch
        plain = (size < LARGEST_STRETCH) & (stretch < LARGEST_STRETCH)
    return np.where(plain, deviation, np.nan).astype(np.float32)


def _nearest_sample(
    points: Array, surface: Surface
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.bool_]]:
    """Return row and column of the field's samples next to points, and which points have one."""
    hit = np.asarray(np.isfinite(points).all(axis=1))
    place = np.where(hit[:, None], points[:, :2], 0) / surface.field.spacing_mm
    limits = np.array(surface.inside.shape) - 1
    row = np.clip(np.rint(-place[:, 1]), 0, limits[0]).astype(np.intp)
    column = np.clip(np.rint(place[:, 0]), 0, limits[1]).astype(np.intp)
    return row, column, hit


def _well_spread(
    rows: NDArray[np.intp], columns: NDArray[np.intp], sigma: NDArray[np.float32]
) -> NDArray[np.intp]:
    """Pick the surest pixel of each cell of a grid, so that about MOST_POINTS remain."""
    cell = max(1, int(np.ceil(np.sqrt(len(rows) / MOST_POINTS))))
    order = np.argsort(sigma, kind="stable")
    key = (rows // cell).astype(np.int64) << 32 | (columns // cell).astype(np.int64)
    _, first = np.unique(key[order], return_index=True)
    return np.sort(order[first])
