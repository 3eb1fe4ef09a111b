"""Each texel, with its own height, looked up in a photograph: one reflectance sample per texel."""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from pipeline.geometry.raycast import RayCaster
from pipeline.reflectance.stations import Station

SMALLEST_COSINE = 0.05
"""Texels seen or lit at more than 87 degrees are dropped: their cosine is mostly noise."""


def sample_photo(
    image: NDArray[np.float32],
    station: Station,
    points_mm: NDArray[np.float64],
    normals: NDArray[np.float32],
) -> NDArray[np.float32]:
    """Return the reflectance that a photograph gives each texel, without regard to occlusion.

    Parameters
    ----------
    image
        (h, w, 3) radiance; NaN where invalid.
    points_mm
        (rows, columns, 3) texel positions, canvas coordinates; NaN outside the canvas.
    normals
        (rows, columns, 3) unit normals.

    Returns
    -------
    (rows, columns, 3) float32: f = L r^2 / (I cos(theta)), r in m; NaN where the texel falls
    outside the image or on an invalid pixel, or is seen or lit too flatly.
    """
    pixels = station.camera.project(points_mm)
    in_front = station.camera.depth(points_mm) > 0
    pixels = np.where(in_front[..., None], pixels, np.nan)
    return np.asarray(
        _sample(
            image,
            pixels,
            points_mm,
            normals,
            station.camera.centre_mm,
            station.light_mm,
            station.intensity,
        )
    )


@njit(cache=True, parallel=True)
def _sample(image, pixels, points, normals, centre, light, intensity):  # type: ignore[no-untyped-def]
    rows, columns = points.shape[:2]
    height, width = image.shape[:2]
    result = np.full((rows, columns, 3), np.nan, np.float32)
    for row in prange(rows):
        for column in range(columns):
            x, y = pixels[row, column, 0], pixels[row, column, 1]
            # Written so that NaN fails too.
            if not (0 <= x <= width - 1 and 0 <= y <= height - 1):
                continue
            to_light = 0.0
            to_eye = 0.0
            light_squared = 0.0
            eye_squared = 0.0
            for axis in range(3):
                normal = normals[row, column, axis]
                light_way = light[axis] - points[row, column, axis]
                eye_way = centre[axis] - points[row, column, axis]
                to_light += normal * light_way
                to_eye += normal * eye_way
                light_squared += light_way * light_way
                eye_squared += eye_way * eye_way
            cosine = to_light / np.sqrt(light_squared)
            if not (cosine > SMALLEST_COSINE and to_eye > SMALLEST_COSINE * np.sqrt(eye_squared)):
                continue
            left, top = min(int(x), max(width - 2, 0)), min(int(y), max(height - 2, 0))
            right, bottom = min(left + 1, width - 1), min(top + 1, height - 1)
            fx, fy = x - left, y - top
            irradiance = intensity * cosine / (light_squared * 1e-6)
            for channel in range(3):
                upper = (1 - fx) * image[top, left, channel] + fx * image[top, right, channel]
                lower = (1 - fx) * image[bottom, left, channel] + fx * image[bottom, right, channel]
                result[row, column, channel] = ((1 - fy) * upper + fy * lower) / irradiance
    return result


def steepest_slope(heights_mm: NDArray[np.floating], spacing_mm: float) -> float:
    """Return a bound on the slope (rise over run) between any two points of the surface.

    A bilinear patch's gradient is bounded by its steepest edges along the two axes. Across a hole
    nothing bounds the rise, so a field with holes has no bound: infinity.
    """
    if not np.isfinite(heights_mm).all():
        return float("inf")
    along_x = np.abs(np.diff(heights_mm, axis=1)).max(initial=0.0)
    along_y = np.abs(np.diff(heights_mm, axis=0)).max(initial=0.0)
    return float(np.hypot(along_x, along_y)) / spacing_mm


def may_be_blocked(
    points_mm: NDArray[np.float64], target_mm: NDArray[np.float64], slope: float
) -> bool:
    """Say whether any ray from the texels to the target could meet the surface again.

    A ray that climbs more steeply than the surface's steepest slope leaves it for good.
    """
    if not np.isfinite(slope):
        return True
    run = np.hypot(points_mm[..., 0] - target_mm[0], points_mm[..., 1] - target_mm[1])
    rise = target_mm[2] - points_mm[..., 2]
    return bool(np.any(rise <= slope * run))


def drop_occluded(
    samples: NDArray[np.float32],
    points_mm: NDArray[np.float64],
    target_mm: NDArray[np.float64],
    caster: RayCaster,
    margin_mm: float,
) -> int:
    """Set the samples whose ray to ``target_mm`` is blocked to NaN; return how many there were."""
    known = np.isfinite(samples[..., 0])
    origins = points_mm[known]
    blocked = np.zeros(known.shape, dtype=bool)
    blocked[known] = caster.occluded(origins, np.broadcast_to(target_mm, origins.shape), margin_mm)
    samples[blocked] = np.nan
    return int(np.count_nonzero(blocked))
