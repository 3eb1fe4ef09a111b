"""From wrapped phase to the projector's coordinate: by Gray code, or by several periods."""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

Image = NDArray[np.float32]

DOUBTFUL = 0.3
"""Gray score below which a pixel may lie on the border of its cell."""

_LIMITS = (9.0, 25.0, 0.005)
"""Of squared, normalised residuals, the difference (three sigma) by which one order must win, and
the most that the best may leave; and the share of a period that nonlinearity may move a phase."""


def wrapped_coordinate(phase: Image, period_px: float) -> Image:
    """Return the coordinate modulo the period: phase = 2 pi (c + 1/2) / period."""
    return (phase * np.float32(period_px / (2 * math.pi)) - np.float32(0.5)).astype(np.float32)


def unwrap_by_cells(
    wrapped: Image,
    period_px: float,
    cell: NDArray[np.int32],
    doubt: Image,
    neighbour: NDArray[np.int32],
    cell_px: int,
    size_px: int,
) -> tuple[Image, Image]:
    """Choose the fringe order that lies nearest to where the Gray code says the pixel is.

    That is the cell's centre, or, where the least sure bit would lead to an adjacent cell, the
    border between the two: so a cell as wide as the period, whose ends look alike, is decided too.

    Returns
    -------
    The coordinate (px, NaN outside the projector), and its distance from the expected place.
    """
    coordinate = np.full(wrapped.shape, np.nan, np.float32)
    away = coordinate.copy()
    _by_cells(wrapped, period_px, cell, doubt, neighbour, cell_px, size_px, coordinate, away)
    return coordinate, away


@njit(cache=True, parallel=True)
def _by_cells(wrapped, period, cell, doubt, neighbour, cell_px, size, coordinate, away):  # type: ignore[no-untyped-def]
    rows, columns = wrapped.shape
    for row in prange(rows):
        for column in range(columns):
            start = wrapped[row, column]
            index, other = cell[row, column], neighbour[row, column]
            expected = index * cell_px + 0.5 * (cell_px - 1)
            if doubt[row, column] < DOUBTFUL and abs(other - index) == 1:
                expected = max(index, other) * cell_px - 0.5
            found = start + period * math.floor((expected - start) / period + 0.5)
            if -1.0 <= found <= size:
                coordinate[row, column] = found
                away[row, column] = abs(found - expected)


def refine(
    coordinate: Image, sigma: Image, wrapped: Image, wrapped_sigma: Image, period_px: float
) -> tuple[Image, Image]:
    """Unwrap a shorter period by a known coordinate, and average the two by their variances.

    Where the longer period is too unsure to choose an order, it is kept as it is.
    """
    period = np.float32(period_px)
    with np.errstate(invalid="ignore", divide="ignore"):
        apart = wrapped - coordinate
        apart -= period * np.floor(apart / period + np.float32(0.5))
        weight = 1 / wrapped_sigma**2
        share = weight / (weight + 1 / sigma**2)
        sure = 3 * np.hypot(sigma, wrapped_sigma) < 0.5 * period
    share = np.where(sure & np.isfinite(apart), share, 0)
    apart = np.where(share > 0, apart, 0)
    spread = np.where(share > 0, wrapped_sigma * np.sqrt(share), sigma)
    return (coordinate + share * apart).astype(np.float32), spread.astype(np.float32)


def unwrap_by_periods(
    wrapped: Image, sigma: Image, periods_px: NDArray[np.float64], size_px: int
) -> tuple[Image, Image]:
    """Choose the coordinate in the projector that agrees best with the phases of all periods.

    Candidates are the shortest period's; the cost is the sum of squared, wrapped residuals over
    their variances. A pixel whose second best is nearly as good is left out.

    Parameters
    ----------
    wrapped, sigma
        (periods, rows, columns) coordinates modulo each period, and their standard deviations.
    periods_px
        Ascending.

    Returns
    -------
    The weighted mean of all periods' coordinates, and its standard deviation.
    """
    coordinate = np.full(wrapped.shape[1:], np.nan, np.float32)
    spread = coordinate.copy()
    _by_periods(wrapped, sigma, periods_px, size_px, _LIMITS, coordinate, spread)
    return coordinate, spread


@njit(cache=True, parallel=True)
def _by_periods(wrapped, sigma, periods, size, limits, coordinate, spread):  # type: ignore[no-untyped-def]
    count, rows, columns = wrapped.shape
    clear, worst, systematic = limits
    for row in prange(rows):
        for column in range(columns):
            start = wrapped[0, row, column]
            for i in range(count):
                start += 0.0 * (wrapped[i, row, column] + sigma[i, row, column])
            if not math.isfinite(start):
                continue
            start -= periods[0] * math.floor((start + 0.5) / periods[0])
            best, second, chosen = np.inf, np.inf, np.nan
            while start <= size - 0.5:
                cost = 0.0
                for i in range(1, count):
                    d = wrapped[i, row, column] - start
                    d -= periods[i] * math.floor(d / periods[i] + 0.5)
                    noise = sigma[i, row, column] ** 2 + sigma[0, row, column] ** 2
                    cost += d * d / (noise + (systematic * periods[i]) ** 2)
                if cost < best:
                    best, second, chosen = cost, best, start
                elif cost < second:
                    second = cost
                start += periods[0]
            if not (second - best > clear and best < worst):
                continue
            total = weights = 0.0
            for i in range(count):
                d = wrapped[i, row, column] - chosen
                d -= periods[i] * math.floor(d / periods[i] + 0.5)
                weight = 1.0 / sigma[i, row, column] ** 2
                total += weight * d
                weights += weight
            coordinate[row, column] = chosen + total / weights
            spread[row, column] = 1.0 / math.sqrt(weights)


def repair_jumps(coordinate: Image, period_px: float) -> tuple[Image, int]:
    """Shift lone pixels by whole periods to where nearly all of their neighbours lie.

    Neighbours are taken in opposite pairs, whose means the surface's slope does not move.

    Returns
    -------
    The repaired image, and how many pixels were shifted.
    """
    repaired = coordinate.copy()
    shifted = np.zeros(len(coordinate), np.int64)
    _repair(coordinate, period_px, repaired, shifted)
    return repaired, int(shifted.sum())


@njit(cache=True, parallel=True)
def _repair(coordinate, period, repaired, shifted):  # type: ignore[no-untyped-def]
    rows, columns = coordinate.shape
    for row in prange(rows):
        around = np.empty(12, np.float32)
        for column in range(columns):
            here = coordinate[row, column]
            torn = (row > 0 and abs(coordinate[row - 1, column] - here) > 0.5 * period) or (
                row + 1 < rows and abs(coordinate[row + 1, column] - here) > 0.5 * period
            )
            torn |= (column > 0 and abs(coordinate[row, column - 1] - here) > 0.5 * period) or (
                column + 1 < columns and abs(coordinate[row, column + 1] - here) > 0.5 * period
            )
            if not torn:
                continue
            n = 0
            for i in range(12):
                # The half of the 5 x 5 neighbourhood after its centre, in reading order.
                dr, dc = (i + 13) // 5 - 2, (i + 13) % 5 - 2
                if not (row - dr >= 0 and row + dr < rows):
                    continue
                if not (0 <= column - dc < columns and 0 <= column + dc < columns):
                    continue
                pair = 0.5 * (coordinate[row - dr, column - dc] + coordinate[row + dr, column + dc])
                if math.isfinite(pair):
                    place = n
                    while place > 0 and around[place - 1] > pair:
                        around[place] = around[place - 1]
                        place -= 1
                    around[place] = pair
                    n += 1
            if n < 5 or not math.isfinite(here):
                continue
            middle = around[n // 2]
            order = math.floor((middle - here) / period + 0.5)
            if order == 0 or abs(here + order * period - middle) > 0.25 * period:
                continue
            close = 0
            for i in range(n):
                close += abs(around[i] - middle) < 0.25 * period
            if close > 0.7 * n:
                repaired[row, column] = here + order * period
                shifted[row] += 1
