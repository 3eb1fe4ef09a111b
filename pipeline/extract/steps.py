"""Steps between neighbouring pixels of a range image: where the surface goes on, and where not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_MAD_TO_SIGMA = 1.4826
_SECOND_DIFFERENCE = np.sqrt(6.0)  # standard deviation of a - 2b + c for unit noise
_BRIDGE_PX = 2.0
_LEAST_SHIFT = 0.35  # share of the usual distance below which two points count as one upon another


@dataclass(frozen=True)
class Sampling:
    """How a region is sampled.

    Parameters
    ----------
    across_mm, down_mm
        Median distance in the plane between neighbours in a row, and in a column.
    noise_mm
        Standard deviation of a height, between neighbours.
    """

    across_mm: float
    down_mm: float
    noise_mm: float

    @property
    def distance_mm(self) -> float:
        """The side of the square that one sample stands for."""
        return float(np.sqrt(self.across_mm * self.down_mm))


def measure_sampling(canvas: Array, sigma_mm: NDArray[np.floating], region: Mask) -> Sampling:
    """Measure distances and noise of points (rows, columns, 3) whose z is the height.

    The noise is the stated one or what the second differences show, whichever is larger: a
    standard deviation that is too small must not tear the surface. Where the relief is rough its
    roughness counts as noise, which is what a step has to stand out from.
    """
    distances, roughness = [], []
    for axis in (1, 0):
        both = _pairs(region, axis)
        step = np.diff(canvas[..., :2], axis=axis)[both]
        distances.append(float(np.median(np.hypot(step[:, 0], step[:, 1]))) if len(step) else 0.0)
        z = np.where(region, canvas[..., 2], np.nan)
        second = np.abs(np.diff(z, n=2, axis=axis))
        second = second[np.isfinite(second)]
        if second.size:
            roughness.append(_MAD_TO_SIGMA * float(np.median(second)) / _SECOND_DIFFERENCE)
    stated = sigma_mm[region & np.isfinite(sigma_mm)]
    noise = max(float(np.median(stated)) if stated.size else 0.0, min(roughness, default=0.0))
    return Sampling(distances[0] or distances[1], distances[1] or distances[0], noise)


def bridge(canvas: Array, valid: Mask) -> tuple[Array, Mask]:
    """Fill gaps of a few pixels with the nearest point's height, so that they do not part it."""
    if valid.all() or not valid.any():
        return canvas, valid
    distance, (row, column) = ndimage.distance_transform_edt(~valid, return_indices=True)
    closed = ndimage.binary_closing(np.pad(valid, 3), iterations=2)[3:-3, 3:-3]
    known = valid | (closed & (distance <= _BRIDGE_PX))
    return np.where(known[..., None], canvas[row, column], np.nan), known


def smoothing_for(sampling: Sampling, slope: float) -> float:
    """Return the Gaussian (px) that brings the noise of a slope to an eighth of ``slope``.

    The derivative of a Gaussian-smoothed image has the standard deviation
    noise / (sqrt(8 pi) sigma^2) per pixel (Canny 1986).
    """
    noise = sampling.noise_mm / sampling.distance_mm
    if noise * np.sqrt(2) <= slope / 8:
        return 0.0
    return float(np.sqrt(8 * noise / (np.sqrt(8 * np.pi) * slope)))


def smooth(values: Array, known: Mask, sigma_px: float) -> Array:
    """Gaussian smoothing of what is known; NaN elsewhere."""
    if sigma_px == 0:
        return np.where(known, values, np.nan)
    total = ndimage.gaussian_filter(np.where(known, values, 0.0), sigma_px, mode="nearest")
    weight = ndimage.gaussian_filter(known.astype(np.float64), sigma_px, mode="nearest")
    return np.where(known, total / np.maximum(weight, 1e-12), np.nan)


def slopes(canvas: Array, known: Mask, sampling: Sampling, sigma_px: float) -> tuple[Array, Array]:
    """Return the slopes between neighbours in a row (rows, columns - 1) and in a column.

    A slope is the step in height over the usual distance in the plane, so that the unseen wall
    behind an edge counts as steep, or over the distance there is, if that is smaller: a wall that
    is seen. NaN where one of the two is not known.
    """
    heights = smooth(canvas[..., 2], known, sigma_px)
    found = []
    for axis, usual in ((1, sampling.across_mm), (0, sampling.down_mm)):
        step = np.diff(canvas[..., :2], axis=axis)
        shift = np.hypot(step[..., 0], step[..., 1])
        found.append(
            np.abs(np.diff(heights, axis=axis)) / np.clip(shift, _LEAST_SHIFT * usual, usual)
        )
    return found[0], found[1]


def link_ends(links: tuple[Mask, Mask], shape: tuple[int, int]) -> Mask:
    """Return the pixels at either end of a marked link, across or down."""
    across, down = links
    marked = np.zeros(shape, bool)
    marked[:, :-1] |= across
    marked[:, 1:] |= across
    marked[:-1] |= down
    marked[1:] |= down
    return marked


def _pairs(mask: Mask, axis: int) -> Mask:
    """Return which neighbours are both in the mask."""
    first = np.take(mask, range(mask.shape[axis] - 1), axis)
    return first & np.take(mask, range(1, mask.shape[axis]), axis)
