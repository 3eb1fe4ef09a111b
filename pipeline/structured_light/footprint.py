"""Albedo edges inside a pixel's footprint: where the measured coordinate really belongs.

A pixel gathers light over the camera's point spread. Where the albedo changes inside it, its
coordinate is that of the albedo's centre of gravity, not of the pixel's centre. For a Gaussian
spread of variance s^2 that centre lies at s^2 grad(ln W) from the pixel's (Stein's identity; W is
the image in uniform light), so the coordinate is corrected by -s^2 J . grad(ln W), J its
derivative over the image. The variance is found from the data where both axes are coded: what the
shift does across the epipolar line cannot be depth.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]

TYPICAL_VARIANCE_PX2 = 0.2
"""A pixel's own square (1/12) and a spread of about a third of a pixel."""

LARGEST_VARIANCE_PX2 = 1.5
REMAINDER = 0.3
"""Share of the shift that stays uncertain in any direction: the edge's form is not known."""

STEEPEST = 1.5
"""Bound of grad(ln W), 1/px: beyond, samples a pixel apart do not tell the derivative."""

_REACH = 4


@dataclass(frozen=True)
class EdgeShift:
    """Shift of a coordinate per unit of spread variance: expected, and how large it may be.

    Both (rows, columns) float32, projector px per px^2; 0 where the light is not known.
    """

    expected: Image
    largest: Image


def log_gradient(light: Image) -> tuple[Image, Image]:
    """Return the derivatives of ln(light) along x and y, 1/px, from its cubic spline.

    A spline's derivative is near the true one up to 0.7 of the sampling limit; a central
    difference loses half there (Unser 1999).
    """
    from scipy.ndimage import correlate1d, spline_filter1d

    top = float(np.nanmax(light, initial=0.0))
    log = np.log(np.fmax(light, max(top * 1e-4, 1e-30)))
    known = np.isfinite(light)
    # Unknown pixels are saturated ones as a rule: as bright as the brightest.
    log = np.where(known, log, np.log(max(top, 1e-30))).astype(np.float32)
    # The mirrored border has no derivative of its own.
    slope, smooth = np.array([-0.5, 0, 0.5]), np.array([1, 4, 1]) / 6
    spline = log
    for axis in (0, 1):
        spline = spline_filter1d(spline, 3, axis=axis, output=np.float32, mode="mirror")
    gradients = []
    for along, across in ((1, 0), (0, 1)):
        derived = correlate1d(
            correlate1d(spline, slope, axis=along, mode="mirror"),
            smooth,
            axis=across,
            mode="mirror",
        )
        gradients.append(np.where(known, np.clip(derived, -STEEPEST, STEEPEST), 0))
    return gradients[0].astype(np.float32), gradients[1].astype(np.float32)


def edge_shift(coordinate: Image, gradient: tuple[Image, Image]) -> EdgeShift:
    """Return J . grad(ln W), the shift of the coordinate per unit of the spread's variance."""
    slope_x, slope_y = local_slope(coordinate)
    gradient_x, gradient_y = gradient
    expected = slope_x * gradient_x + slope_y * gradient_y
    largest = np.hypot(slope_x, slope_y) * np.hypot(gradient_x, gradient_y)
    return EdgeShift(
        np.nan_to_num(expected).astype(np.float32), np.nan_to_num(largest).astype(np.float32)
    )


def local_slope(image: Image) -> tuple[Image, Image]:
    """Fit a plane around every pixel; return its slopes along x and y, blind to missing pixels."""
    known = np.isfinite(image).astype(np.float32)
    values = np.where(known > 0, image, 0).astype(np.float32)
    # Around the mean, so that float32 keeps the digits.
    middle = np.float32(values.sum(dtype=np.float64) / max(known.sum(dtype=np.float64), 1))
    values = (values - middle) * known
    ramp = np.arange(-_REACH, _REACH + 1, dtype=np.float32)
    ones = np.ones_like(ramp)

    def moment(of: Image, along_x: Image, along_y: Image) -> Image:
        return np.asarray(
            cv2.sepFilter2D(of, cv2.CV_32F, along_x, along_y, borderType=cv2.BORDER_CONSTANT),
            dtype=np.float32,
        )

    squares = ramp * ramp
    n, z = moment(known, ones, ones), moment(values, ones, ones)
    x, y = moment(known, ramp, ones), moment(known, ones, ramp)
    with np.errstate(divide="ignore", invalid="ignore"):
        xx = moment(known, squares, ones) - x * x / n
        yy = moment(known, ones, squares) - y * y / n
        xy = moment(known, ramp, ramp) - x * y / n
        xz = moment(values, ramp, ones) - x * z / n
        yz = moment(values, ones, ramp) - y * z / n
        determinant = xx * yy - xy * xy
        # Fewer pixels than a row's worth, or pixels in one line, tell no slope.
        enough = (n >= len(ramp)) & (determinant > 0.1 * xx * yy)
        along_x = np.where(enough, (yy * xz - xy * yz) / determinant, 0)
        along_y = np.where(enough, (xx * yz - xy * xz) / determinant, 0)
    return along_x.astype(np.float32), along_y.astype(np.float32)


def spread_variance(across: Image, expected: Image) -> float | None:
    """Find the spread's variance from the epipolar residual.

    Parameters
    ----------
    across
        (rows, columns) residual across the epipolar line, projector px.
    expected
        The part of the expected shift across the line: ``across = variance * expected``.

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
