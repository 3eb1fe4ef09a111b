"""Projector coordinates become accepted points, with a standard deviation that can be trusted."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.camera import Camera
from pipeline.scan.outliers import specks, straddling
from pipeline.structured_light.coordinates import ProjectorCoordinates
from pipeline.structured_light.footprint import (
    REMAINDER,
    TYPICAL_VARIANCE_PX2,
    EdgeShift,
    edge_shift,
    log_gradient,
    spread_variance,
)
from pipeline.structured_light.triangulate import Triangulation, triangulate

Image = NDArray[np.float32]

_NEIGHBOURHOOD = 9
"""Width, px, over which the residual across the epipolar line is averaged."""

_ENOUGH_PIXELS = 300_000
"""From which the point spread is found."""


@dataclass(frozen=True)
class Measured:
    """Points (rows, columns, 3) mm in the scan's frame, their deviations, figures for people."""

    points_mm: Image
    sigma_mm: Image
    statistics: dict[str, float]


def measure(
    coordinates: ProjectorCoordinates,
    camera: Camera,
    projector: Camera,
    *,
    epipolar_tolerance: float = 6.0,
    correct_albedo_edges: bool = True,
    fewest_pixels: int = 25,
) -> Measured:
    """Triangulate, correct albedo edges, and drop points that contradict themselves.

    Parameters
    ----------
    epipolar_tolerance
        In standard deviations of the residual across the epipolar line.
    correct_albedo_edges
        See :mod:`pipeline.structured_light.footprint`.
    fewest_pixels
        Smaller pieces of surface are dropped.
    """
    statistics: dict[str, float] = {}
    if correct_albedo_edges:
        coordinates, variance = _without_edges(coordinates, camera, projector)
        statistics["point_spread_px"] = float(np.sqrt(variance))
    found = triangulate(coordinates, camera, projector)
    if np.isfinite(found.across_px).any():
        coordinates, wrong = _checked(coordinates, found, epipolar_tolerance)
        residual = found.across_px[np.isfinite(found.across_px) & ~wrong]
        statistics["epipolar_rms_px"] = float(np.sqrt(np.mean(residual.astype(np.float64) ** 2)))
        statistics["share_off_epipolar"] = float(np.mean(wrong[np.isfinite(found.across_px)]))
        found = triangulate(coordinates, camera, projector)
    depth = found.depth_mm
    pitch = 2 / (camera.lens.K[0, 0] + camera.lens.K[1, 1])
    mixed = straddling(depth, found.sigma_mm, pitch)
    depth[mixed] = np.nan
    lone = specks(depth, found.sigma_mm, pitch, fewest_pixels)
    statistics["pixels_between_surfaces"] = int(np.count_nonzero(mixed))
    statistics["pixels_in_specks"] = int(np.count_nonzero(lone))
    dropped = mixed | lone
    points, sigma = found.points_mm, found.sigma_mm
    _add_rounding(points, sigma)
    points[dropped], sigma[dropped] = np.nan, np.nan
    return Measured(points, sigma, statistics)


def _without_edges(
    coordinates: ProjectorCoordinates, camera: Camera, projector: Camera
) -> tuple[ProjectorCoordinates, float]:
    """Correct both axes for albedo edges; return the variance (px^2) that was used."""
    gradient = log_gradient(coordinates.radiance)
    shifts: dict[str, EdgeShift] = {
        name: edge_shift(image, gradient)
        for name, image in (("x", coordinates.x), ("y", coordinates.y))
        if image is not None
    }
    variance = None
    if len(shifts) == 2:
        raw = triangulate(_thinned(coordinates), camera, projector)
        expected = (
            raw.across[..., 0] * shifts["x"].expected + raw.across[..., 1] * shifts["y"].expected
        )
        variance = spread_variance(raw.across_px, expected)
    if variance is None:
        variance = TYPICAL_VARIANCE_PX2
    corrected = {}
    for name, shift in shifts.items():
        image, sigma = getattr(coordinates, name), getattr(coordinates, f"sigma_{name}")
        corrected[name] = image - np.float32(variance) * shift.expected
        remainder = np.float32(REMAINDER * variance) * shift.largest
        corrected[f"sigma_{name}"] = np.hypot(sigma, remainder)
    return replace(coordinates, **corrected), variance


def _add_rounding(points: Image, sigma: Image) -> None:
    """Add what float32 rounds away, which counts where the scan's frame lies far away."""
    far = float(np.nanmax(np.abs(points), initial=0.0))
    step = float(np.spacing(np.float32(far)))
    usual = float(np.nanmedian(sigma)) if np.isfinite(sigma).any() else 0.0
    if step > 0.01 * usual:
        np.hypot(sigma, np.float32(step / np.sqrt(12)), out=sigma)


def _thinned(coordinates: ProjectorCoordinates) -> ProjectorCoordinates:
    """Leave rows out of a large picture: one number is to be found, from as many as tell it."""
    step = max(1, round(coordinates.radiance.size / _ENOUGH_PIXELS))
    if step == 1:
        return coordinates
    kept = {}
    for name in ("x", "y"):
        image = np.full_like(getattr(coordinates, name), np.nan)
        image[::step] = getattr(coordinates, name)[::step]
        kept[name] = image
    return replace(coordinates, **kept)


def _checked(
    coordinates: ProjectorCoordinates, found: Triangulation, tolerance: float
) -> tuple[ProjectorCoordinates, NDArray[np.bool_]]:
    """Judge the coordinates by their residual across the epipolar line, which is no depth.

    What its neighbourhood leaves across the line beyond the noise (texture finer than a pixel, the
    calibration's error) is as likely to lie along it, and is added to the deviations. A pixel far
    beyond even that is removed.
    """
    x, y, sigma_x, sigma_y = (
        np.asarray(image, dtype=np.float32)
        for image in (coordinates.x, coordinates.y, coordinates.sigma_x, coordinates.sigma_y)
    )
    across = found.across_px
    predicted = (found.across[..., 0] * sigma_x) ** 2 + (found.across[..., 1] * sigma_y) ** 2
    known = np.isfinite(across)
    usual = 1.4826 * float(np.median(np.abs(across[known])))
    normal = known & (np.abs(across) < tolerance * np.sqrt(predicted + usual**2))
    surplus = np.where(normal, across**2 - predicted, 0).astype(np.float32)
    size = (_NEIGHBOURHOOD, _NEIGHBOURHOOD)
    count = cv2.blur(normal.astype(np.float32), size, borderType=cv2.BORDER_CONSTANT)
    mean = cv2.blur(surplus, size, borderType=cv2.BORDER_CONSTANT) / np.maximum(count, 1e-3)
    extra = np.maximum(mean, 0).astype(np.float32)
    wrong = known & (across**2 > tolerance**2 * (predicted + extra))
    checked = replace(
        coordinates,
        x=np.where(wrong, np.float32(np.nan), x),
        y=np.where(wrong, np.float32(np.nan), y),
        sigma_x=np.sqrt(sigma_x**2 + extra),
        sigma_y=np.sqrt(sigma_y**2 + extra),
    )
    return checked, wrong
