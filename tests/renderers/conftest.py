"""Small synthetic assets."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from pipeline.formats.asset import Asset
from pipeline.formats.boxes import Boxes


def boxes_above(heights: NDArray[np.float64], d0: float, cell: int) -> Boxes:
    """Cut the field into cells; keep those whose patches reach above d0."""
    rows, columns = heights.shape
    position, size, highest, highest_at = [], [], [], []
    for row in range(0, rows - 1, cell):
        for column in range(0, columns - 1, cell):
            last_row, last_column = min(row + cell, rows - 1), min(column + cell, columns - 1)
            patch = heights[row : last_row + 1, column : last_column + 1]
            if np.nanmax(patch) > d0:
                y, x = np.unravel_index(np.nanargmax(patch), patch.shape)
                position.append((column, row))
                size.append((last_column - column, last_row - row))
                highest.append(patch[y, x])
                highest_at.append((column + x, row + y))
    return Boxes(
        d0_mm=d0,
        top_mm=float(np.nanmax(heights)),
        cell=cell,
        position=np.array(position, np.int32).reshape(-1, 2),
        size=np.array(size, np.int32).reshape(-1, 2),
        highest_mm=np.array(highest, np.float32),
        highest_at=np.array(highest_at, np.int32).reshape(-1, 2),
    )


def height_normals(heights: NDArray[np.float64], spacing: float) -> NDArray[np.float32]:
    """n_x, n_y of central differences; rows go down while y goes up."""
    slope_row, slope_column = (
        np.gradient(heights, spacing) if min(heights.shape) > 1 else np.zeros((2, *heights.shape))
    )
    n = np.stack([-slope_column, slope_row, np.ones_like(heights)], axis=-1)
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    return n[..., :2].astype(np.float32)


@pytest.fixture(scope="session")
def make_asset() -> Callable[..., Asset]:
    """Give a factory: heights in mm -> asset, half white, half ochre, a little glossy."""

    def make(
        heights: NDArray[np.floating],
        *,
        spacing: float = 0.5,
        d0: float = 0.0,
        cell: int = 16,
        mask: NDArray[np.bool_] | None = None,
        specular: float = 0.05,
    ) -> Asset:
        field = np.asarray(heights, dtype=np.float64)
        rows, columns = field.shape
        canvas = np.ones(field.shape, bool) if mask is None else mask
        x = np.arange(columns) / max(columns - 1, 1)
        albedo = np.where(x[None, :, None] < 0.5, [0.8, 0.8, 0.8], [0.7, 0.5, 0.2])
        shape = (rows, columns, 3)
        lobe = np.broadcast_to([-1.0, 1.0, 20.0], shape)
        return Asset(
            name="synthetic",
            spacing_mm=spacing,
            heights_mm=np.where(canvas, field, 0).astype(np.float32),
            normals=height_normals(field, spacing),
            mask=canvas,
            diffuse=np.where(canvas[..., None], np.broadcast_to(albedo / np.pi, shape), 0).astype(
                np.float32
            ),
            specular=np.where(canvas[..., None], specular, 0).astype(np.float32) * np.ones(3, "f4"),
            lobe=lobe.astype(np.float32),
            boxes=boxes_above(np.where(canvas, field, -np.inf), d0, cell),
            notes={},
        )

    return make
