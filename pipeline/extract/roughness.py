"""Relief finer than the samples: what it does to the heights, told from the relief that is seen.

A camera pixel averages relief inside it, and a sample stands for the relief around it. Neither
leaves a trace in the residuals of a local fit, but relief has no end at the sampling limit: paint
has edges, whose power falls with the square of the frequency, so that all that is finer than the
samples holds about as much as the finest octave that is seen.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_WEIGHTS = np.array([-1.0, 0, 9, 0, 9, 0, -1]) / 16
"""Cubic interpolation of a sample from its neighbours at -3, -1, 1 and 3 samples."""

_NEIGHBOURHOOD = 1.0
"""Standard deviation, in samples, of the window over which the variance is averaged."""


def unresolved_variance(
    heights_mm: NDArray[np.floating], sigma_mm: NDArray[np.floating]
) -> NDArray[np.float32]:
    """Return the variance (mm^2) that relief finer than the samples adds to each height.

    Parameters
    ----------
    heights_mm, sigma_mm
        (rows, columns); NaN where there is no height.

    Returns
    -------
    (rows, columns) >= 0: what a sample differs from the interpolation of its neighbours, the
    finest octave, less what the noise explains; 0 where too few neighbours are known.
    """
    known = np.isfinite(heights_mm) & np.isfinite(sigma_mm)
    if not known.any():
        return np.zeros(heights_mm.shape, np.float32)
    heights = np.where(known, heights_mm, 0).astype(np.float64)
    variance = np.where(known, sigma_mm, 0).astype(np.float64) ** 2
    outside = np.pad(np.where(known, 0.0, 1.0), 3, constant_values=1.0)
    surplus, count = np.zeros_like(heights), np.zeros_like(heights)
    for along_rows in (True, False):
        away = heights - _along(heights, _WEIGHTS, rows=along_rows)
        noise = variance + _along(variance, _WEIGHTS**2, rows=along_rows)
        missing = _along(outside, np.abs(_WEIGHTS), rows=along_rows)
        usable = known & (missing[3:-3, 3:-3] == 0)
        surplus += np.where(usable, away**2 - noise, 0)
        count += usable
    smooth = cv2.GaussianBlur(surplus, (0, 0), _NEIGHBOURHOOD, borderType=cv2.BORDER_REFLECT)
    weight = cv2.GaussianBlur(count, (0, 0), _NEIGHBOURHOOD, borderType=cv2.BORDER_REFLECT)
    found = np.maximum(smooth, 0) / np.maximum(weight, 1e-6)
    return np.where(known & (weight > 1e-3), found, 0).astype(np.float32)


def _along(image: Array, weights: Array, *, rows: bool) -> Array:
    kernel, nothing = weights.reshape(1, -1), np.ones((1, 1))
    across, down = (kernel, nothing) if rows else (nothing, kernel)
    filtered = cv2.sepFilter2D(image, cv2.CV_64F, across, down, borderType=cv2.BORDER_REFLECT_101)
    return np.asarray(filtered, dtype=np.float64)
