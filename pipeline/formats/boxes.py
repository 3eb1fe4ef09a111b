"""The boxes that hold the relief above the bump-mapped plane, ``classify/boxes.npz``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Boxes:
    """Cells of the height field with relief above ``d0_mm`` (spec of the hybrid renderer).

    Positions and sizes are in samples of the height field: a box covers the patches from sample
    ``position`` to sample ``position + size`` (both ends included), as (column, row).

    Parameters
    ----------
    d0_mm, top_mm
        Bottom and top shared by all boxes: the threshold, and the field's maximum.
    cell
        Side of a cell, samples.
    position, size
        (N, 2) int32 column, row.
    highest_mm
        (N,) float32 height of the box's highest sample.
    highest_at
        (N, 2) int32 column, row of that sample.
    """

    d0_mm: float
    top_mm: float
    cell: int
    position: NDArray[np.int32]
    size: NDArray[np.int32]
    highest_mm: NDArray[np.float32]
    highest_at: NDArray[np.int32]

    def __len__(self) -> int:
        """Count the boxes."""
        return len(self.position)
