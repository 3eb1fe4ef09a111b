"""Where the projector sees each corner: the decoded coordinate, fitted around the corner."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.structured_light.coordinates import ProjectorCoordinates

Array = NDArray[np.float64]

REACH = 0.7
"""Radius of the neighbourhood, in distances between corners."""

FEWEST = 24
"""Decoded pixels around a corner, for six coefficients."""

_HUBER = 2.0


def projector_corners(coordinates: ProjectorCoordinates, pixels: Array) -> tuple[Array, Array]:
    """Return (N, 2) projector coordinates of corners (N, 2) px, and their standard deviations.

    A quadratic in the camera's pixels is fitted robustly to the coordinates around each corner
    (Moreno and Taubin 2012 fit a homography, which this equals to second order); NaN where fewer
    than FEWEST pixels were decoded.
    """
    apart = np.linalg.norm(pixels[:, None] - pixels[None], axis=2)
    np.fill_diagonal(apart, np.inf)
    radius = np.clip(REACH * apart.min(axis=1), 4.0, 40.0)
    values = np.full((len(pixels), 2), np.nan)
    sigmas = np.full((len(pixels), 2), np.nan)
    for axis, (image, sigma) in enumerate(
        ((coordinates.x, coordinates.sigma_x), (coordinates.y, coordinates.sigma_y))
    ):
        if image is None or sigma is None:
            continue
        for i, (corner, reach) in enumerate(zip(pixels, radius, strict=True)):
            values[i, axis], sigmas[i, axis] = _fit(image, sigma, corner, reach)
    return values, sigmas


def _fit(
    image: NDArray[np.float32], sigma: NDArray[np.float32], corner: Array, reach: float
) -> tuple[float, float]:
    """Fit the quadratic around one corner; return its value there and the standard deviation."""
    rows, columns = image.shape
    left, right = max(int(corner[0] - reach), 0), min(int(corner[0] + reach) + 2, columns)
    top, bottom = max(int(corner[1] - reach), 0), min(int(corner[1] + reach) + 2, rows)
    if left >= right or top >= bottom:
        return np.nan, np.nan
    y, x = np.mgrid[top:bottom, left:right]
    dx, dy = (x - corner[0]) / reach, (y - corner[1]) / reach
    value = image[top:bottom, left:right].astype(np.float64)
    spread = sigma[top:bottom, left:right].astype(np.float64)
    use = np.isfinite(value) & np.isfinite(spread) & (dx * dx + dy * dy <= 1)
    if np.count_nonzero(use) < FEWEST:
        return np.nan, np.nan
    dx, dy, value, spread = dx[use], dy[use], value[use], np.maximum(spread[use], 1e-4)
    design = np.stack([np.ones_like(dx), dx, dy, dx * dx, dx * dy, dy * dy], axis=1)
    weight = 1 / spread**2
    for _ in range(6):
        scaled = design * weight[:, None]
        normal = scaled.T @ design
        try:
            solution = np.linalg.solve(normal, scaled.T @ value)
        except np.linalg.LinAlgError:
            return np.nan, np.nan
        residual = (value - design @ solution) / spread
        scale = 1.4826 * np.median(np.abs(residual)) + 1e-9
        weight = 1 / spread**2 / np.maximum(1.0, np.abs(residual) / (_HUBER * scale))
    covariance = np.linalg.inv(normal)
    return float(solution[0]), float(max(scale, 1.0) * np.sqrt(covariance[0, 0]))
