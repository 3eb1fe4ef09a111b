"""Weights by which overlapping images fade into one another."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

_WIDTH = 0.15  # of the smaller side


def fade(known: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return weights (rows, columns) that rise smoothly from an image's border to 1 inside.

    Only so does no seam show: where an image ends, its weight has gone to nothing already.

    Parameters
    ----------
    known
        (rows, columns) bool; the weight is 0 where False, and more than 0 where True.
    """
    rows, columns = np.flatnonzero(known.any(axis=1)), np.flatnonzero(known.any(axis=0))
    if not rows.size:
        return np.zeros(known.shape)
    width = max(1.0, _WIDTH * min(np.ptp(rows) + 1, np.ptp(columns) + 1))
    distance = ndimage.distance_transform_edt(np.pad(known, 1))[1:-1, 1:-1]
    share = np.minimum(distance / width, 1)
    return np.asarray(share**2 * (3 - 2 * share))
