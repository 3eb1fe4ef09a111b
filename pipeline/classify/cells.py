"""Relief above d0: its connected components, and the cells that hold it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from pipeline.formats.boxes import Boxes

_EIGHT = np.ones((3, 3), bool)


def valid_pixels(
    heights_mm: NDArray[np.floating], d0_mm: float, fewest_px: int
) -> tuple[NDArray[np.bool_], int]:
    """Mark the samples above d0, without components of fewer than ``fewest_px`` samples.

    Returns
    -------
    valid, dropped
        (rows, columns) bool, and the number of components dropped.
    """
    above = heights_mm > d0_mm
    components, count = ndimage.label(above, _EIGHT)
    large = np.bincount(components.ravel(), minlength=count + 1) >= fewest_px
    large[0] = False
    return large[components], int(np.count_nonzero(~large[1:]))


def boxes_of(
    heights_mm: NDArray[np.floating], valid: NDArray[np.bool_], d0_mm: float, cell: int
) -> Boxes:
    """Cut the field into cells of ``cell`` x ``cell`` patches; keep those with a valid sample.

    A cell owns the samples on all its sides, its neighbours too, so that every patch with a valid
    corner lies in a box and no gap opens between box and plane. Cells at the far sides may be
    smaller.

    Parameters
    ----------
    heights_mm
        (rows, columns), NaN outside the canvas.
    valid
        (rows, columns) bool.
    d0_mm
        Bottom of the boxes.
    cell
        Patches on a side.
    """
    rows, columns = heights_mm.shape
    known = np.where(np.isfinite(heights_mm), heights_mm, -np.inf).astype(np.float32)
    top = float(known.max()) if np.isfinite(known.max()) else d0_mm
    tops, lefts = np.arange(0, rows - 1, cell), np.arange(0, columns - 1, cell)
    found = []
    for top_row in tops:
        last_row = min(top_row + cell, rows - 1)
        strip = np.s_[top_row : last_row + 1]
        occupied = np.asarray(valid[strip].any(axis=0))
        for left in lefts[_any_within(occupied, lefts, cell)] if occupied.any() else ():
            last = min(left + cell, columns - 1)
            patch = known[strip, left : last + 1]
            row, column = np.unravel_index(int(np.argmax(patch)), patch.shape)
            size = (last - left, last_row - top_row)
            at = (left + column, top_row + row)
            found.append((left, top_row, *size, *at, patch[row, column]))
    table = np.array(found, dtype=np.float64).reshape(-1, 7)
    return Boxes(
        d0_mm=d0_mm,
        top_mm=top,
        cell=cell,
        position=table[:, 0:2].astype(np.int32),
        size=table[:, 2:4].astype(np.int32),
        highest_mm=table[:, 6].astype(np.float32),
        highest_at=table[:, 4:6].astype(np.int32),
    )


def covered(boxes: Boxes, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Mark the samples inside or on a box, (rows, columns)."""
    inside = np.zeros(shape, bool)
    for (column, row), (width, height) in zip(boxes.position, boxes.size, strict=True):
        inside[row : row + height + 1, column : column + width + 1] = True
    return inside


def _any_within(
    occupied: NDArray[np.bool_], lefts: NDArray[np.intp], cell: int
) -> NDArray[np.bool_]:
    """Return for each cell of a strip whether one of its columns is occupied."""
    before = np.concatenate([[0], np.cumsum(occupied)])
    return before[np.minimum(lefts + cell + 1, len(occupied))] > before[lefts]
