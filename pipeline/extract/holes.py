"""Small holes of a height field, closed with a membrane."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, sparse
from scipy.sparse.linalg import spsolve

Mask = NDArray[np.bool_]
Image = NDArray[np.float32]

_MAD_TO_SIGMA = 1.4826
_EIGHT = np.ones((3, 3), bool)


def small_holes(known: Mask, limit: float) -> tuple[Mask, int]:
    """Find the holes that are enclosed and nowhere wider than ``limit`` samples.

    Returns
    -------
    holes, left
        (rows, columns) bool, and the number of enclosed holes that are too wide.
    """
    holes, count = ndimage.label(ndimage.binary_fill_holes(known) & ~known, _EIGHT)
    if count == 0:
        return np.zeros_like(known), 0
    distance = ndimage.distance_transform_edt(~known)
    widest = 2 * ndimage.maximum(distance, holes, np.arange(1, count + 1)) - 1
    small = np.concatenate([[False], widest <= limit])
    return small[holes], int(np.count_nonzero(~small[1:]))


def fill_holes(heights: Image, sigma: Image, holes: Mask) -> tuple[Image, Image]:
    """Stretch a membrane over the holes, and say how much less is known there.

    Parameters
    ----------
    heights, sigma
        (rows, columns) float32 mm; NaN where not known.
    holes
        (rows, columns) bool; enclosed by known samples.

    Returns
    -------
    heights, sigma
        Copies with the holes filled.

    Notes
    -----
    The membrane solves Laplace's equation, so that no filled height lies above or below the hole's
    rim. Its variance is the rim's, carried by the same equation, and grows with the distance from
    the rim as a random walk does whose step is the typical difference of two neighbours.
    """
    heights, sigma = heights.copy(), sigma.copy()
    if not holes.any():
        return heights, sigma
    known = np.isfinite(heights)
    index = np.full(heights.shape, -1)
    index[holes] = np.arange(np.count_nonzero(holes))
    row, column = np.nonzero(holes)
    size = len(row)
    diagonal = np.zeros(size)
    sums = np.zeros((size, 2))
    links: list[tuple[NDArray[np.intp], NDArray[np.intp]]] = []
    for down, right in ((0, 1), (1, 0), (0, -1), (-1, 0)):
        r, c = row + down, column + right
        unknown = holes[r, c]
        rim = known[r, c] & ~unknown
        diagonal += unknown | rim
        sums[rim, 0] += heights[r[rim], c[rim]]
        sums[rim, 1] += sigma[r[rim], c[rim]].astype(np.float64) ** 2
        links.append((np.flatnonzero(unknown), index[r[unknown], c[unknown]]))
    i = np.concatenate([np.arange(size), *(link[0] for link in links)])
    j = np.concatenate([np.arange(size), *(link[1] for link in links)])
    values = np.concatenate([diagonal, -np.ones(len(i) - size)])
    solution = spsolve(sparse.csc_array((values, (i, j)), shape=(size, size)), sums)
    distance = ndimage.distance_transform_edt(~known)[holes]
    walk = _typical_difference(heights) ** 2 * distance
    heights[holes] = solution[:, 0]
    sigma[holes] = np.sqrt(np.maximum(solution[:, 1], 0) + walk)
    return heights, sigma


def _typical_difference(heights: Image) -> float:
    differences = np.abs(np.diff(heights, axis=1))
    differences = differences[np.isfinite(differences)]
    return _MAD_TO_SIGMA * float(np.median(differences)) if differences.size else 0.0
