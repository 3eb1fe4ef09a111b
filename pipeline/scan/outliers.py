"""Points that belong to no surface: between two surfaces, or far from everything around them."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

STEEPEST = 4.0
"""Slope against the image plane (76 degrees) beyond which a pixel straddles a step."""

LINKED = 8.0
"""Slope beyond which two neighbours do not belong to the same piece of surface."""

SURE = 6.0
"""Standard deviations by which a difference must exceed its noise."""


def straddling(
    depth_mm: NDArray[np.float64], sigma_mm: NDArray[np.float32], pitch: float
) -> NDArray[np.bool_]:
    """Find pixels that mix the light of two surfaces.

    First those far from both opposite neighbours, in between; where no such pixel parts the
    surfaces, the pixels on both sides of the step, of which one at least is mixed.

    Parameters
    ----------
    depth_mm, sigma_mm
        (rows, columns), NaN where unknown.
    pitch
        Distance between neighbouring rays at depth 1.
    """
    between: NDArray[np.bool_] = _straddling(depth_mm, sigma_mm, pitch, STEEPEST, SURE, True)
    rest = np.where(between, np.nan, depth_mm)
    beside: NDArray[np.bool_] = _straddling(rest, sigma_mm, pitch, STEEPEST, SURE, False)
    return between | beside


def specks(
    depth_mm: NDArray[np.float64], sigma_mm: NDArray[np.float32], pitch: float, fewest: int
) -> NDArray[np.bool_]:
    """Find pixels of pieces of surface that have fewer than ``fewest`` pixels."""
    found: NDArray[np.bool_] = _specks(depth_mm, sigma_mm, pitch, LINKED, SURE, fewest)
    return found


@njit(cache=True)
def _straddling(depth, sigma, pitch, steepest, sure, both):  # type: ignore[no-untyped-def]
    rows, columns = depth.shape
    found = np.zeros((rows, columns), np.bool_)
    for row in range(1, rows - 1):
        for column in range(1, columns - 1):
            z = depth[row, column]
            if not math.isfinite(z):
                continue
            for dr, dc in ((0, 1), (1, 0), (1, 1), (1, -1)):
                if not both and dr * dc != 0:
                    continue
                ahead = depth[row + dr, column + dc] - z
                behind = z - depth[row - dr, column - dc]
                limit = max(steepest * pitch * z * math.hypot(dr, dc), sure * sigma[row, column])
                far_ahead, far_behind = abs(ahead) > limit, abs(behind) > limit
                if (
                    (far_ahead and far_behind and ahead * behind > 0)
                    if both
                    else (far_ahead or far_behind)
                ):
                    found[row, column] = True
                    break
    return found


@njit(cache=True)
def _specks(depth, sigma, pitch, linked, sure, fewest):  # type: ignore[no-untyped-def]
    """Union-find over the links to the left and upper neighbours (Galler and Fischer 1964)."""
    rows, columns = depth.shape
    parent = np.arange(rows * columns)
    for row in range(rows):
        for column in range(columns):
            z = depth[row, column]
            if not math.isfinite(z):
                continue
            for dr, dc in ((0, 1), (1, 0)):
                if row < dr or column < dc:
                    continue
                other = depth[row - dr, column - dc]
                noise = sigma[row, column] + sigma[row - dr, column - dc]
                if not abs(z - other) <= max(linked * pitch * z, sure * noise):
                    continue
                a, b = row * columns + column, (row - dr) * columns + column - dc
                while parent[a] != a:
                    parent[a] = parent[parent[a]]
                    a = parent[a]
                while parent[b] != b:
                    parent[b] = parent[parent[b]]
                    b = parent[b]
                parent[max(a, b)] = min(a, b)
    count = np.zeros(rows * columns, np.int64)
    for i in range(rows * columns):
        parent[i] = parent[parent[i]]  # roots come first, so one step reaches them
        count[parent[i]] += 1
    found = np.zeros((rows, columns), np.bool_)
    for row in range(rows):
        for column in range(columns):
            known = math.isfinite(depth[row, column])
            found[row, column] = known and count[parent[row * columns + column]] < fewest
    return found
