"""The part of a canvas seen in one placement: its points, and its maps for registration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from pipeline.extract.canvas import find_canvas
from pipeline.extract.resample import KERNEL_SAMPLES, grid_around, resample
from pipeline.formats.range_image import RangeImage, Texture
from pipeline.geometry.camera import Camera
from pipeline.geometry.rigid import RigidTransform

Array = NDArray[np.float64]

_MOST_SAMPLES = 250_000
_DARKEST = 0.02  # of the median albedo: what is darker is noise in the logarithm
_DETAIL = 12.0  # samples; wider variations of the albedo are the light's as well as the paint's
_MAD_TO_SIGMA = 1.4826


@dataclass(frozen=True)
class Patch:
    """One placement's canvas in axes of its own.

    Parameters
    ----------
    name
        The scan sequence's.
    scan_from_patch
        Takes the patch's axes (z out of the paint, y as near to the picture's up as can be) to the
        scan's frame.
    points, sigma_mm
        (N, 3) points in those axes and (N,) their standard deviations along the viewing rays, mm.
    log_albedo
        (N,) logarithm of the albedo, up to a constant; NaN where not known.
    distance_mm
        Between neighbouring points.
    eye_mm
        (3,) the camera's centre in the patch's axes.
    """

    name: str
    scan_from_patch: RigidTransform
    points: Array
    sigma_mm: Array
    log_albedo: Array
    distance_mm: float
    eye_mm: Array


@dataclass(frozen=True)
class PatchMap:
    """A patch on a regular grid; (rows, columns) arrays, NaN where not known.

    Parameters
    ----------
    left_mm, top_mm, spacing_mm
        Sample (row, column) lies at (left + column spacing, top - row spacing).
    heights, sigma
        Height and its standard deviation, mm.
    detail
        Logarithm of the albedo without its wide variations.
    """

    left_mm: float
    top_mm: float
    spacing_mm: float
    heights: Array
    sigma: Array
    detail: Array


def find_patch(
    name: str,
    range_image: RangeImage,
    texture: Texture,
    camera: Camera,
    projector_mm: Array,
    erosion_px: int,
) -> Patch:
    """Find the canvas in one placement; its edges may lie outside the picture.

    Parameters
    ----------
    projector_mm
        (3,) the projector's centre in the scan's frame, from where the texture was lit.

    Raises
    ------
    ImpastoError
        If there is no surface in the middle of the picture.
    """
    found = find_canvas(
        range_image.points_mm, range_image.sigma_mm, camera, erosion_px, straighten=False
    )
    mask = found.region.mask
    inverse = found.scene_from_canvas.inverse()
    radiance = np.asarray(texture.radiance, dtype=np.float64)
    seen = (radiance if radiance.ndim == 2 else radiance.mean(axis=2))[mask]
    # Lambert's law on the plane: the relief's own shading stays, and is alike in all placements.
    way = inverse.apply(projector_mm) - found.points
    distance = np.linalg.norm(way, axis=1)
    albedo = np.maximum(seen, 0) * distance**3 / np.maximum(way[:, 2], 1e-3 * distance)
    known = albedo[np.isfinite(albedo)]
    floor = _DARKEST * float(np.median(known)) if known.size else 1.0
    return Patch(
        name,
        found.scene_from_canvas,
        found.points,
        np.asarray(range_image.sigma_mm[mask], dtype=np.float64),
        np.log(albedo + max(floor, 1e-30)),
        found.region.sampling.distance_mm,
        inverse.apply(camera.centre_mm),
    )


def map_spacing(patches: list[Patch]) -> float:
    """Return a spacing at which no patch's map is larger than need be."""
    finest = max(patch.distance_mm for patch in patches)
    areas = [float(np.prod(np.ptp(patch.points[:, :2], axis=0))) for patch in patches]
    return max(finest, float(np.sqrt(max(areas) / _MOST_SAMPLES)))


def make_map(patch: Patch, spacing_mm: float) -> PatchMap:
    """Sample a patch's heights and albedo on a grid."""
    grid = grid_around(patch.points[:, :2], spacing_mm)
    kernel = KERNEL_SAMPLES * max(patch.distance_mm, spacing_mm)
    heights, sigma = resample(patch.points, patch.sigma_mm, grid, kernel)
    lit = np.isfinite(patch.log_albedo)
    coloured = np.column_stack([patch.points[lit, :2], patch.log_albedo[lit]])
    detail = np.full(heights.shape, np.nan)
    if len(coloured):
        albedo, _ = resample(coloured, np.ones(len(coloured)), grid, kernel)
        detail = high_pass(albedo.astype(np.float64), _DETAIL)
    return PatchMap(
        grid.left_mm,
        grid.top_mm,
        spacing_mm,
        heights.astype(np.float64),
        sigma.astype(np.float64),
        detail,
    )


def blur(image: Array, width: float) -> Array:
    """Smooth by a Gaussian of ``width`` samples what is known; NaN stays NaN."""
    if width == 0:
        return image
    known = np.isfinite(image)
    total = ndimage.gaussian_filter(np.where(known, image, 0.0), width, mode="constant")
    weight = ndimage.gaussian_filter(known.astype(np.float64), width, mode="constant")
    return np.where(known, total / np.maximum(weight, 1e-12), np.nan)


def high_pass(image: Array, width: float) -> Array:
    """Return what a Gaussian of ``width`` samples smooths away, outliers clipped."""
    detail = image - blur(image, width)
    known = np.isfinite(detail)
    if not known.any():
        return detail
    deviation = _MAD_TO_SIGMA * float(np.median(np.abs(detail[known])))
    # Paint is sparse: the deviation of the middle half may be that of bare ground.
    limit = max(6 * deviation, 3 * float(detail[known].std()))
    return np.asarray(np.clip(detail, -limit, limit))
