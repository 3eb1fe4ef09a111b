"""Several patches on one grid, each fading out towards its own border."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.extract.resample import Grid
from pipeline.geometry.fade import fade

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Tile:
    """A patch on its part of the common grid.

    Parameters
    ----------
    row, column
        Where the part begins.
    heights, sigma
        (rows, columns) mm; NaN where not known.
    common
        (rows, columns) variance, mm^2, of errors that neighbouring samples share: the motion's,
        and what the overlaps differ by beyond their noise.
    """

    row: int
    column: int
    heights: NDArray[np.float32]
    sigma: NDArray[np.float32]
    common: Array


def part_of(grid: Grid, points: Array) -> tuple[int, int, Grid]:
    """Return the part of a grid that holds points (N, 2 or 3): first row and column, and grid."""
    spacing = grid.spacing_mm
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    top = max(0, int(np.floor((grid.top_mm - high[1]) / spacing)))
    left = max(0, int(np.floor((low[0] - grid.left_mm) / spacing)))
    bottom = min(grid.rows, int(np.ceil((grid.top_mm - low[1]) / spacing)) + 1)
    right = min(grid.columns, int(np.ceil((high[0] - grid.left_mm) / spacing)) + 1)
    return (
        top,
        left,
        Grid(
            grid.left_mm + left * spacing,
            grid.top_mm - top * spacing,
            bottom - top,
            right - left,
            spacing,
        ),
    )


def blend(
    tiles: list[Tile], shape: tuple[int, int]
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint8]]:
    """Average patches with weights 1 / S^2, faded.

    Returns
    -------
    heights, sigma, count
        (rows, columns): mm, mm, and how many patches know a sample. Noise averages out; the
        ``common`` errors do not.
    """
    total, height, noise, common = (np.zeros(shape) for _ in range(4))
    count = np.zeros(shape, np.uint8)
    for tile in tiles:
        rows, columns = tile.heights.shape
        part = np.s_[tile.row : tile.row + rows, tile.column : tile.column + columns]
        known = np.isfinite(tile.heights) & np.isfinite(tile.sigma)
        sigma = np.where(known, tile.sigma, 1.0).astype(np.float64)
        weight = np.where(known, fade(known) / sigma**2, 0.0)
        total[part] += weight
        height[part] += weight * np.where(known, tile.heights, 0.0)
        noise[part] += (weight * sigma) ** 2
        common[part] += weight * np.where(known, tile.common, 0.0)
        count[part] += known
    with np.errstate(invalid="ignore", divide="ignore"):
        heights = (height / total).astype(np.float32)
        deviation = np.sqrt(noise / total**2 + common / total).astype(np.float32)
    return heights, deviation, count
