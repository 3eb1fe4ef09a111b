"""Projector coordinates become accepted points, with a standard deviation that can be trusted."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.camera import Camera
from pipeline.structured_light.coordinates import ProjectorCoordinates
from pipeline.structured_light.footprint import (
    REMAINDER,
    TYPICAL_VARIANCE_PX2,
    edge_shift,
    spread_variance,
)
from pipeline.structured_light.triangulate import Triangulation, points, triangulate

Image = NDArray[np.float32]


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
    epipolar_tolerance: float,
    correct_albedo_edges: bool,
) -> Measured:
    """Triangulate, correct albedo edges, and drop points that lie off their epipolar line.

    Parameters
    ----------
    epipolar_tolerance
        In robust standard deviations of the residual across the line.
    """
    statistics: dict[str, float] = {}
    if correct_albedo_edges:
        coordinates, variance = _without_edges(coordinates, camera, projector)
        statistics["point_spread_px"] = float(np.sqrt(variance))
    found = triangulate(coordinates, camera, projector)
    depth, sigma = found.depth_mm, found.sigma_mm
    residual = np.abs(found.across_px)
    checked = np.isfinite(residual)
    if checked.any():
        spread = 1.4826 * float(np.median(residual[checked]))
        statistics["epipolar_residual_px"] = spread
        expected = np.hypot(_across_sigma(coordinates, found), spread)
        wrong = residual > epipolar_tolerance * expected
        statistics["share_off_epipolar"] = float(np.mean(wrong[checked]))
        depth = np.where(wrong, np.nan, depth)
        # What is off across the line is as likely off along it: the noise model alone is too sure.
        excess = np.sqrt(np.maximum(residual**2 - expected**2, 0) + spread**2)
        scale = np.sqrt(1 + (excess / np.maximum(_across_sigma(coordinates, found), 1e-6)) ** 2)
        sigma = np.where(checked, sigma * np.minimum(scale, 50), sigma)
    sigma = np.where(np.isfinite(depth), sigma, np.nan).astype(np.float32)
    return Measured(points(camera, depth), sigma, statistics)


def _across_sigma(coordinates: ProjectorCoordinates, found: Triangulation) -> Image:
    """Return the standard deviation that the residual across the epipolar line should have."""
    assert coordinates.sigma_x is not None
    assert coordinates.sigma_y is not None
    return np.hypot(
        found.across[..., 0] * coordinates.sigma_x, found.across[..., 1] * coordinates.sigma_y
    )


def _without_edges(
    coordinates: ProjectorCoordinates, camera: Camera, projector: Camera
) -> tuple[ProjectorCoordinates, float]:
    """Correct both axes for albedo edges; return the variance (px^2) that was used."""
    shifts = {
        name: edge_shift(image, coordinates.radiance)
        for name, image in (("x", coordinates.x), ("y", coordinates.y))
        if image is not None
    }
    variance = None
    if len(shifts) == 2:
        raw = triangulate(coordinates, camera, projector)
        expected = raw.across[..., 0] * shifts["x"] + raw.across[..., 1] * shifts["y"]
        variance = spread_variance(raw.across_px, expected)
    if variance is None:
        variance = TYPICAL_VARIANCE_PX2
    corrected = {}
    for name, shift in shifts.items():
        image, sigma = getattr(coordinates, name), getattr(coordinates, f"sigma_{name}")
        moved = np.float32(variance) * shift
        corrected[name] = image - moved
        corrected[f"sigma_{name}"] = np.hypot(sigma, np.float32(REMAINDER) * moved)
    return replace(coordinates, **corrected), variance
