"""How wide the resampling kernel may be: as wide as the noise asks for and the relief allows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pipeline.extract.resample import Grid, resample

WIDER = (1.4, 2.0)
"""Kernels that are tried, in kernels; the noise falls with the width."""

_PROOF = 2.0
"""A kernel is taken if even one so many times as wide leaves no relief out: the bias of a local
quadratic grows with the fourth power of the width, and is then far below the noise."""

_STRIDE = 3
_FEWEST = 200


def widest_kernel(
    points: NDArray[np.floating], sigma: NDArray[np.floating], grid: Grid, kernel_mm: float
) -> float:
    """Return the kernel to resample with, mm: ``kernel_mm`` or up to twice as wide.

    Parameters
    ----------
    points, sigma, grid, kernel_mm
        As for :func:`pipeline.extract.resample.resample`.

    Notes
    -----
    Between the heights of a narrow and a wide kernel lie the noise that the wide one averages away,
    whose variance is known, and the relief that it flattens (Lepski 1990). A tenth of the samples
    is enough to tell which.
    """
    sparse = replace(
        grid,
        rows=-(-grid.rows // _STRIDE),
        columns=-(-grid.columns // _STRIDE),
        spacing_mm=_STRIDE * grid.spacing_mm,
    )
    narrow, narrow_sigma = resample(points, sigma, sparse, kernel_mm)
    taken = kernel_mm
    for factor in WIDER:
        wide, wide_sigma = resample(points, sigma, sparse, _PROOF * factor * kernel_mm)
        known = np.isfinite(narrow) & np.isfinite(wide)
        if np.count_nonzero(known) < _FEWEST:
            break
        away = (wide[known].astype(np.float64) - narrow[known]) ** 2
        noise = narrow_sigma[known].astype(np.float64) ** 2 - wide_sigma[known] ** 2
        # Holes and doubtful rims tell of themselves, not of the relief.
        usual = noise < 4 * np.median(noise)
        if np.mean(away[usual]) > np.mean(noise[usual]):
            break
        taken = factor * kernel_mm
    return taken
