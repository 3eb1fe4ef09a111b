"""Diffuse albedo from the picture under the projector's uniform light."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from pipeline.formats.height_field import HeightField
from pipeline.geometry.camera import Camera
from pipeline.geometry.fade import fade
from pipeline.geometry.height_grid import normals, sample_bilinear

LEAST_COSINE = 0.15
"""Cosine of incidence below which paint is treated as if it stood at this one: there the light that
is measured is mostly what its surroundings send, and dividing by less would make it glow."""

_LARGEST_NOISE = 0.1  # radians of the normal


def relative_albedo(
    field: HeightField,
    radiance: NDArray[np.floating],
    camera: Camera,
    projector_centre_mm: NDArray[np.floating],
) -> NDArray[np.float32]:
    """Free a picture of the projector's fall-off: albedo up to one factor.

    Parameters
    ----------
    field
        The canvas.
    radiance
        (rows, columns) or (rows, columns, 3) linear, in the scan camera's picture; NaN if unknown.
    camera
        The scan camera, in the scan's frame.
    projector_centre_mm
        (3,) the projector's optical centre, in the scan's frame.

    Returns
    -------
    (rows, columns, 3) float32 on the canvas; NaN where it is not known.

    Notes
    -----
    A Lambertian texel of albedo A lit by a point of intensity I at the distance r has the radiance
    L = (A / pi) I cos(theta) / r^2 (Lambert 1760), so that A is proportional to L r^2 / cos(theta).
    The cosine takes the normal of the smoothed relief: noise of the heights must not turn up as
    noise of the colour.
    """
    points = field.canvas_points()
    pixels = camera.project(field.scan_from_canvas.apply(points))
    image = np.asarray(radiance, dtype=np.float32)
    image = image if image.ndim == 3 else image[..., None]
    seen = sample_bilinear(image, pixels[..., 0], pixels[..., 1])
    lamp = field.scan_from_canvas.inverse().apply(projector_centre_mm)
    to_lamp = lamp - points
    distance = np.linalg.norm(to_lamp, axis=-1)
    direction = to_lamp / distance[..., None]
    cosine = np.einsum("...i,...i", smooth_normals(field), direction)
    factor = (distance / 1000) ** 2 / np.maximum(cosine, LEAST_COSINE)
    albedo = np.maximum(seen * factor[..., None], 0)
    return np.broadcast_to(albedo, (*factor.shape, 3)).astype(np.float32)


def blended_albedo(
    field: HeightField,
    pictures: Sequence[NDArray[np.floating]],
    camera: Camera,
    projector_centre_mm: NDArray[np.floating],
) -> NDArray[np.float32]:
    """Free pictures of several placements of the projector's fall-off, and blend them.

    Parameters
    ----------
    field
        The canvas, with its placements.
    pictures
        The radiance of each, in the order of ``field.placements``.
    camera, projector_centre_mm
        As for :func:`relative_albedo`.

    Returns
    -------
    (rows, columns, 3) float32 on the canvas; NaN where it is not known.

    Notes
    -----
    Each picture fades out towards its border. Their exposures need not be alike: one factor each
    makes the logarithms agree best where they overlap, the first one's being 1.
    """
    albedos = [
        relative_albedo(
            replace(field, scan_from_canvas=placement.scan_from_canvas),
            picture,
            camera,
            projector_centre_mm,
        )
        for placement, picture in zip(field.placements, pictures, strict=True)
    ]
    gains = _gains(albedos)
    total = np.zeros(field.heights_mm.shape)
    albedo = np.zeros((*total.shape, 3))
    for image, gain in zip(albedos, gains, strict=True):
        known = np.asarray(np.isfinite(image).all(axis=-1))
        weight = fade(known)
        total += weight
        albedo += weight[..., None] * np.where(known[..., None], gain * image, 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return (albedo / total[..., None]).astype(np.float32)


def _gains(albedos: list[NDArray[np.float32]]) -> NDArray[np.float64]:
    """Return the factors that make overlapping pictures agree; 1 for the first."""
    count = len(albedos)
    system, right = np.zeros((count, count)), np.zeros(count)
    system[0, 0] = 1.0
    for i, j in combinations(range(count), 2):
        both = (albedos[i] > 0) & (albedos[j] > 0)
        if not both.any():
            continue
        weight = float(np.count_nonzero(both))
        ratio = float(np.median(np.log(albedos[i][both]) - np.log(albedos[j][both])))
        system[[i, j], [i, j]] += weight
        system[[i, j], [j, i]] -= weight
        right[i] -= weight * ratio
        right[j] += weight * ratio
    # A picture without overlap keeps its own exposure: the pseudo-inverse leaves it at 1.
    logarithm = np.linalg.pinv(system, hermitian=True) @ right
    return np.asarray(np.exp(logarithm - logarithm[0]))


def smooth_normals(field: HeightField) -> NDArray[np.float32]:
    """Return normals (rows, columns, 3) of the relief, smoothed as its noise demands.

    Notes
    -----
    A Gaussian of s samples leaves a slope the standard deviation sigma / (sqrt(8 pi) s^2 spacing)
    (Canny 1986); s is chosen to make that a tenth of a radian, and at least one sample.
    """
    known = np.isfinite(field.heights_mm)
    sigma = float(np.median(field.sigma_mm[known])) / field.spacing_mm
    width = max(1.0, float(np.sqrt(sigma / (np.sqrt(8 * np.pi) * _LARGEST_NOISE))))
    heights = np.where(known, field.surface_mm, 0).astype(np.float64)
    weight = ndimage.gaussian_filter(known.astype(np.float64), width)
    smooth = ndimage.gaussian_filter(heights, width) / np.maximum(weight, 1e-12)
    return normals(np.where(known, smooth, np.nan), field.spacing_mm)


def scale_for(
    albedo: NDArray[np.floating], canvas: NDArray[np.bool_], percentile: float, target: float
) -> float:
    """Return the factor that brings a percentile of the canvas's albedo to ``target``.

    Each texel counts with its brightest channel; 1 where the canvas is black or unknown.
    """
    brightest = albedo[canvas].max(axis=-1)
    brightest = brightest[np.isfinite(brightest)]
    level = float(np.percentile(brightest, percentile)) if brightest.size else 0.0
    return target / level if level > 0 else 1.0


def fill_from_nearest(
    image: NDArray[np.float32], canvas: NDArray[np.bool_]
) -> tuple[NDArray[np.float32], int]:
    """Give texels of the canvas that are not known their nearest known texel's value.

    Returns
    -------
    image, filled
        (rows, columns, channels), 0 outside the canvas, and how many texels were filled.
    """
    known = np.isfinite(image).all(axis=-1) & canvas
    unknown = canvas & ~known
    if unknown.any() and known.any():
        row, column = ndimage.distance_transform_edt(
            ~known, return_distances=False, return_indices=True
        )
        image = image[row, column]
    kept = canvas[..., None] & np.isfinite(image)
    return np.where(kept, image, 0).astype(np.float32), int(np.count_nonzero(unknown))
