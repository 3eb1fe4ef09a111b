"""Albedo edges inside a pixel's footprint: where the measured coordinate really belongs.

A pixel gathers light over the camera's point spread. Where the albedo changes inside it, its
coordinate is that of the albedo's centre of gravity, not of the pixel's centre. For a Gaussian
spread of variance s^2 that centre lies at s^2 grad(ln W) from the pixel's (Stein's identity; W is
the image in uniform light), so the coordinate is corrected by -s^2 J . grad(ln W), J its
derivative over the image. The variance is found from the data where both axes are coded: what the
shift does across the epipolar line cannot be depth.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]

TYPICAL_VARIANCE_PX2 = 0.2
"""A pixel's own square (1/12) and a spread of about a third of a pixel."""

LARGEST_VARIANCE_PX2 = 1.5
REMAINDER = 0.6
"""Share of the correction that stays uncertain: the edge's place inside the pixel is not known."""

_REACH = 4


def edge_shift(coordinate: Image, light: Image) -> Image:
    """Return the shift of the coordinate per unit of spread variance, J . grad(ln W), px / px^2.

    0 where the light is not known.
    """
    slope_x, slope_y = local_slope(coordinate)
    log = np.log(np.maximum(light, np.nanmax(light, initial=1e-12) * 1e-4))
    known = np.isfinite(log)
    gradient_y, gradient_x = np.gradient(np.where(known, log, 0))
    # Across a steep edge the finite difference of ln W exaggerates, so it is bounded.
    shift = slope_x * np.clip(gradient_x, -1, 1) + slope_y * np.clip(gradient_y, -1, 1)
    return np.where(known & np.isfinite(shift), shift, 0).astype(np.float32)


def local_slope(image: Image) -> tuple[Image, Image]:
    """Fit a plane around every pixel; return its slopes along x and y, blind to missing pixels."""
    known = np.isfinite(image).astype(np.float32)
    values = np.where(known > 0, image, 0).astype(np.float32)
    # Around the mean, so that float32 keeps the digits.
    middle = np.float32(values.sum(dtype=np.float64) / max(known.sum(), 1))
    values = (values - middle) * known
    ramp = np.arange(-_REACH, _REACH + 1, dtype=np.float32)
    ones = np.ones_like(ramp)

    def moment(of: Image, along_x: Image, along_y: Image) -> Image:
        return np.asarray(cv2.sepFilter2D(of, cv2.CV_32F, along_x, along_y), dtype=np.float32)

    count, total = moment(known, ones, ones), moment(values, ones, ones)
    slopes = []
    squares = ramp * ramp
    for first, second in (((ramp, ones), (squares, ones)), ((ones, ramp), (ones, squares))):
        place, square = moment(known, *first), moment(known, *second)
        product = moment(values, *first)
        spread = count * square - place * place
        with np.errstate(divide="ignore", invalid="ignore"):
            slopes.append(np.where(spread > count, (count * product - place * total) / spread, 0))
    return slopes[0].astype(np.float32), slopes[1].astype(np.float32)


def spread_variance(across: Image, expected: Image) -> float | None:
    """Find the spread's variance from the epipolar residual.

    Parameters
    ----------
    across
        (rows, columns) residual across the epipolar line, projector px.
    expected
        The part of :func:`edge_shift` across the line: ``across = variance * expected``.

    Returns
    -------
    The slope of a robust regression through 0, bounded to [0, LARGEST_VARIANCE_PX2]; None where too
    few pixels lie on albedo edges.
    """
    edges = np.isfinite(across) & (np.abs(expected) > 0.05)
    if np.count_nonzero(edges) < 500:
        return None
    residual, shift = across[edges].astype(np.float64), expected[edges].astype(np.float64)
    weight = np.ones_like(residual)
    slope = 0.0
    for _ in range(20):
        slope = float((weight * shift * residual).sum() / (weight * shift * shift).sum())
        rest = np.abs(residual - slope * shift)
        weight = 1 / np.maximum(1, rest / (1.345 * 1.4826 * np.median(rest) + 1e-12))
    return float(np.clip(slope, 0, LARGEST_VARIANCE_PX2))
