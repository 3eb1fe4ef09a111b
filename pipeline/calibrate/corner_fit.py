"""Chessboard corners to a hundredth of a pixel: the blurred corner itself is fitted to the image.

Where two edges of a chessboard cross, the image is b + (w + g . d) (1 + E_1 E_2) / 2 with
E_i = erf(n_i . d / (sqrt(2) s)): d from the corner, n_i the edges' normals, s the blur, b and w the
levels of black and white, g the slope of the light. For edges at right angles under a Gaussian blur
this is exact; for others it errs only near the corner, by as much on either side, so that the
corner stays where it is. A gradient method (OpenCV's cornerSubPix) is several times worse where the
lens is sharp, for it differentiates between samples that do not tell the derivative.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SMALLEST_RADIUS, LARGEST_RADIUS = 3.0, 14.0
"""Of the window, px: below, it does not hold enough of the edges; above, they may bend."""

_ROUNDS = 40
_SETTLED_PX = 1e-5
_SHARPEST, _BLURREST = 0.15, 4.0
_FARTHEST = 0.5  # of the radius, from the start
_WORST_FIT = 0.25  # RMS residual over the contrast
_ANGLES = 72
_HUBER = 3.0


@dataclass(frozen=True)
class FittedCorners:
    """Corners (N, 2) px, their standard deviations (N,) px, and blur (N,) px; NaN where none."""

    pixels: Array
    sigma_px: Array
    blur_px: Array


def fit_corners(image: NDArray[np.floating], starts: Array, radius_px: float) -> FittedCorners:
    """Fit all corners of one image at once.

    Parameters
    ----------
    image
        (rows, columns), linear or not: a corner is symmetric about its centre in any tone.
    starts
        (N, 2) corners to about a pixel.
    radius_px
        Of the round window; it must not reach the next corner.

    Notes
    -----
    Levenberg's and Marquardt's method on all nine parameters with analytic derivatives; Huber's
    weights against dirt. The deviation follows from the residuals.
    """
    starts = np.asarray(starts, dtype=np.float64)
    nothing = np.full(len(starts), np.nan)
    failed = FittedCorners(np.full((len(starts), 2), np.nan), nothing, nothing.copy())
    radius = min(radius_px, LARGEST_RADIUS)
    if not len(starts) or radius < SMALLEST_RADIUS:
        return failed
    reach = int(np.ceil(radius))
    rows, columns = image.shape
    middle = np.rint(starts).astype(np.int64)
    inside = (middle >= reach).all(axis=1)
    inside &= (middle[:, 0] < columns - reach) & (middle[:, 1] < rows - reach)
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    window = np.hypot(x, y) <= radius
    offsets = np.stack([x[window], y[window]], axis=1)
    chosen = np.flatnonzero(inside)
    if not chosen.size:
        return failed
    places = middle[chosen, None] + offsets
    values = image[places[..., 1], places[..., 0]].astype(np.float64)
    relative = places - starts[chosen, None]
    vector, usable = _start(image, starts[chosen], values, radius)
    usable &= np.isfinite(values).all(axis=1)
    chosen, vector = chosen[usable], vector[usable]
    values, relative = values[usable], relative[usable]
    if not chosen.size:
        return failed
    vector, sigma, quality = _solve(vector, values, relative)
    good = np.isfinite(sigma) & (quality < _WORST_FIT)
    good &= np.hypot(vector[:, 0], vector[:, 1]) < _FARTHEST * radius
    good &= (vector[:, 4] > _SHARPEST) & (vector[:, 4] < _BLURREST)
    kept = chosen[good]
    failed.pixels[kept] = starts[kept] + vector[good, :2]
    failed.sigma_px[kept] = sigma[good]
    failed.blur_px[kept] = vector[good, 4]
    return failed


def _start(
    image: NDArray[np.floating], corners: Array, values: Array, radius: float
) -> tuple[Array, NDArray[np.bool_]]:
    """Return (c_x, c_y, angle 1, angle 2, blur, b, w, g_x, g_y) and where edges were found."""
    turn = np.arange(_ANGLES) * 2 * np.pi / _ANGLES
    circle = 0.6 * radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    at = (corners[:, None] + circle).astype(np.float32)
    ring = cv2.remap(image.astype(np.float32), at[..., 0], at[..., 1], cv2.INTER_LINEAR).astype(
        np.float64
    )
    half = ring[:, : _ANGLES // 2] + ring[:, _ANGLES // 2 :]
    level = half - (half.max(axis=1) + half.min(axis=1))[:, None] / 2
    after = np.concatenate([level[:, 1:], level[:, :1]], axis=1)
    crossing = (level > 0) != (after > 0)
    usable = crossing.sum(axis=1) == 2
    vector = np.zeros((len(corners), 9))
    low, high = np.quantile(values, (0.1, 0.9), axis=1)
    # Opposite sides of a corner are alike; those of a single edge sum to a constant.
    usable &= (half.max(axis=1) - half.min(axis=1) > high - low) & (high > low)
    vector[:, 4], vector[:, 5], vector[:, 6] = 0.7, low, high - low
    for i in np.flatnonzero(usable):
        first, second = np.flatnonzero(crossing[i])
        for slot, at_index in ((2, first), (3, second)):
            part = level[i, at_index] / (level[i, at_index] - after[i, at_index])
            vector[i, slot] = (at_index + part) * 2 * np.pi / _ANGLES
        # E_1 E_2 is negative between the two angles; there it must be dark.
        if level[i, (first + second + 1) // 2] > 0:
            vector[i, 2] += np.pi
    return vector, usable


def _solve(vector: Array, values: Array, relative: Array) -> tuple[Array, Array, Array]:
    """Return the parameters, the corners' deviations (px) and the residuals over the contrast."""
    damping = np.full(len(vector), 1e-3)
    model, jacobian = _model(vector, relative)
    weight = np.ones_like(values)
    cost = ((values - model) ** 2).sum(axis=1)
    for _ in range(_ROUNDS):
        residual = values - model
        spread = 1.4826 * np.median(np.abs(residual), axis=1) + 1e-12
        weight = np.minimum(1, _HUBER * spread[:, None] / (np.abs(residual) + 1e-300))
        cost = (weight * residual**2).sum(axis=1)
        weighted = jacobian * weight[..., None]
        normal = weighted.transpose(0, 2, 1) @ jacobian
        right = (weighted.transpose(0, 2, 1) @ residual[..., None])[..., 0]
        diagonal = np.einsum("nii->ni", normal).copy()
        for i in range(normal.shape[1]):
            normal[:, i, i] += damping * diagonal[:, i] + 1e-300
        step = np.linalg.solve(normal, right[..., None])[..., 0]
        step[:, 4] = np.clip(step[:, 4], -0.5 * vector[:, 4], 0.5 * vector[:, 4])
        trial = vector + step
        trial_model, trial_jacobian = _model(trial, relative)
        better = (weight * (values - trial_model) ** 2).sum(axis=1) <= cost
        vector = np.where(better[:, None], trial, vector)
        model = np.where(better[:, None], trial_model, model)
        jacobian = np.where(better[:, None, None], trial_jacobian, jacobian)
        damping = np.where(better, damping * 0.2, damping * 8)
        if (np.abs(step[:, :2]).max(axis=1) < _SETTLED_PX).all():
            break
    freedom = np.maximum(weight.sum(axis=1) - 9, 1)
    variance = (weight * (values - model) ** 2).sum(axis=1) / freedom
    normal = (jacobian * weight[..., None]).transpose(0, 2, 1) @ jacobian
    scale = np.sqrt(np.einsum("nii->ni", normal))
    scale = np.maximum(scale, 1e-9 * scale.max(axis=1, keepdims=True) + 1e-150)
    covariance = np.linalg.pinv(normal / (scale[:, :, None] * scale[:, None, :]), hermitian=True)
    place = (covariance[:, 0, 0] / scale[:, 0] ** 2 + covariance[:, 1, 1] / scale[:, 1] ** 2) / 2
    return vector, np.sqrt(place * variance), np.sqrt(variance) / (np.abs(vector[:, 6]) + 1e-300)


def _model(vector: Array, relative: Array) -> tuple[Array, Array]:
    """Return the image (N, P) and its derivatives (N, P, 9) at (N, P, 2) px from the starts."""
    from scipy.special import erf

    centre, blur = vector[:, None, :2], vector[:, 4, None]
    d = relative - centre
    levels, slopes = [], []
    for angle in (vector[:, 2, None], vector[:, 3, None]):
        cos, sin = np.cos(angle), np.sin(angle)
        across = (d[..., 1] * cos - d[..., 0] * sin) / (np.sqrt(2) * blur)
        along = d[..., 0] * cos + d[..., 1] * sin
        peak = 2 / np.sqrt(np.pi) * np.exp(-(across**2)) / (np.sqrt(2) * blur)
        levels.append(erf(across))
        # By c_x, c_y, angle and blur.
        slopes.append((peak * sin, -peak * cos, -peak * along, -peak * across * np.sqrt(2)))
    first, second = levels
    shape = (1 + first * second) / 2
    light = vector[:, 6, None] + (relative * vector[:, None, 7:9]).sum(axis=2)
    (x1, y1, turn1, wide1), (x2, y2, turn2, wide2) = slopes
    half = light / 2
    by_x, by_y = x1 * second + first * x2, y1 * second + first * y2
    # Blurred light that slopes: G * ((g . d) f) = (g . d) (G * f) + s^2 g . grad(G * f).
    slope_x = shape * relative[..., 0] - blur**2 * by_x / 2
    slope_y = shape * relative[..., 1] - blur**2 * by_y / 2
    columns = [
        half * by_x,
        half * by_y,
        half * turn1 * second,
        half * first * turn2,
        half * (wide1 * second + first * wide2),
        np.ones_like(shape),
        shape,
        slope_x,
        slope_y,
    ]
    image = vector[:, 5, None] + vector[:, 6, None] * shape
    image += vector[:, 7, None] * slope_x + vector[:, 8, None] * slope_y
    return image, np.stack(columns, axis=2)
