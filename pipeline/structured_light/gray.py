"""Gray code: bits decided against their inverse or a threshold, and bits become cells."""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

Image = NDArray[np.float32]


def bit_score(plain: Image | None, inverted: Image | None, dark: Image, bright: Image) -> Image:
    """Return how surely a bit is set: 1 fully lit, -1 fully dark, near 0 at an edge; 0 if unknown.

    Parameters
    ----------
    plain, inverted
        Light under the bit's pattern and its inverse; at least one of them. With both, the inverse
        is the threshold, which interreflection and dark paint move as much as the pattern itself.
    dark, bright
        Light without and with the projector's.
    """
    span = np.maximum(bright - dark, np.finfo(np.float32).tiny)
    if plain is not None and inverted is not None:
        score = (plain - inverted) / span
    elif plain is not None:
        score = (2 * plain - dark - bright) / span
    else:
        assert inverted is not None
        score = (dark + bright - 2 * inverted) / span
    clipped: Image = np.nan_to_num(np.clip(score, -1, 1), nan=0.0).astype(np.float32)
    return clipped


def cells(scores: Image) -> tuple[NDArray[np.int32], Image, NDArray[np.int32]]:
    """Decode the reflected Gray code (Gray 1953).

    Parameters
    ----------
    scores
        (bits, rows, columns), the coarsest bit first.

    Returns
    -------
    cell
        (rows, columns) index of the cell.
    doubt
        Smallest absolute score of the pixel's bits.
    neighbour
        The cell that the pixel would be in were its least sure bit the other way.
    """
    cell = np.zeros(scores.shape[1:], np.int32)
    neighbour, doubt = np.zeros_like(cell), np.zeros(cell.shape, np.float32)
    _cells(scores, cell, neighbour, doubt)
    return cell, doubt, neighbour


@njit(cache=True, parallel=True)
def _cells(scores, cell, neighbour, doubt):  # type: ignore[no-untyped-def]
    bits, rows, columns = scores.shape
    for row in prange(rows):
        for column in range(columns):
            least, which = np.inf, 0
            for bit in range(bits):
                if abs(scores[bit, row, column]) < least:
                    least, which = abs(scores[bit, row, column]), bit
            index = other = 0
            binary = turned = 0
            for bit in range(bits):
                lit = 1 if scores[bit, row, column] > 0 else 0
                binary ^= lit
                turned ^= 1 - lit if bit == which else lit
                index, other = 2 * index + binary, 2 * other + turned
            cell[row, column], neighbour[row, column] = index, other
            doubt[row, column] = least
