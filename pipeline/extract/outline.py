"""The canvas's own edges: how far it hangs askew in the camera's picture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

Array = NDArray[np.float64]

RECTANGULARITY = 0.85
"""A region that fills less of its smallest rectangle than this has no edges to go by."""

_BINS = 48
_CORNER = 0.1  # share of a side left out at each end


def skew_angle(points: NDArray[np.floating], area: float) -> float | None:
    """Return the angle by which the region's sides are turned from the axes.

    Parameters
    ----------
    points
        (N, 2) x, y of the region's points, or of its border alone.
    area
        The region's area, in the unit of ``points`` squared.

    Returns
    -------
    float or None
        Radians in [-pi/4, pi/4), counter-clockwise; None if the region is not rectangular.

    Notes
    -----
    The smallest rectangle (one side lies on the convex hull: Freeman and Shapira 1975) gives the
    start; then each side's direction is a robust line through the outermost points along it, so
    that one stray point does not turn the canvas.
    """
    if len(points) < 4:
        return None
    try:
        hull = points[ConvexHull(points).vertices].astype(np.float64)
    except QhullError:  # the points lie on a line
        return None
    angle, smallest = _smallest_rectangle(hull)
    if not smallest > 0 or area < RECTANGULARITY * smallest:
        return None
    angle += _refine(np.asarray(points, dtype=np.float64), angle)
    return float((angle + np.pi / 4) % (np.pi / 2) - np.pi / 4)


def _smallest_rectangle(hull: Array) -> tuple[float, float]:
    """Return the angle and area of the smallest rectangle around a convex polygon."""
    edges = np.roll(hull, -1, axis=0) - hull
    angles = np.unique(np.round(np.arctan2(edges[:, 1], edges[:, 0]) % (np.pi / 2), 12))
    cos, sin = np.cos(angles), np.sin(angles)
    along = hull[:, :1] * cos + hull[:, 1:] * sin
    across = hull[:, 1:] * cos - hull[:, :1] * sin
    areas = np.ptp(along, axis=0) * np.ptp(across, axis=0)
    best = int(np.argmin(areas))
    return float(angles[best]), float(areas[best])


def _refine(points: Array, angle: float) -> float:
    """Return the small turn that makes the four sides parallel to the axes."""
    cos, sin = np.cos(angle), np.sin(angle)
    turned = points @ np.array([[cos, -sin], [sin, cos]])
    turns, weights = [], []
    for axis in (0, 1):
        along, across = turned[:, axis], turned[:, 1 - axis]
        low, high = along.min(), along.max()
        margin = _CORNER * (high - low)
        inner = (along > low + margin) & (along < high - margin)
        if not inner.any():
            continue
        width = (high - low - 2 * margin) / _BINS
        bins = np.minimum(((along[inner] - low - margin) / width).astype(np.intp), _BINS - 1)
        for sign in (1.0, -1.0):
            outermost = np.full(_BINS, -np.inf)
            np.maximum.at(outermost, bins, sign * across[inner])
            filled = np.flatnonzero(np.isfinite(outermost))
            if len(filled) < _BINS // 2:
                continue
            slope, scatter = _median_slope(filled * width, sign * outermost[filled])
            turns.append(np.arctan(slope) if axis == 0 else -np.arctan(slope))
            weights.append((high - low) ** 2 / (scatter + width) ** 2)
    return float(np.average(turns, weights=weights)) if turns else 0.0


def _median_slope(x: Array, y: Array) -> tuple[float, float]:
    """Return a robust slope (Theil 1950, Sen 1968) and the median absolute residual."""
    i, j = np.triu_indices(len(x), 1)
    slope = float(np.median((y[j] - y[i]) / (x[j] - x[i])))
    rest = y - slope * x
    return slope, float(np.median(np.abs(rest - np.median(rest))))
