"""How noisy a stored value is: shot noise, read noise, rounding (Janesick 2007)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.capture import CameraEntry

SATURATED = 0.98
"""Share of full scale from which a value may be clipped and is dropped."""

TYPICAL_WELL_E, TYPICAL_READ_E = 8000.0, 5.0
"""An industrial camera's sensor, where the bundle says nothing."""

_BINS = 12
_FEWEST_PER_BIN = 50


@dataclass(frozen=True)
class NoiseModel:
    """Variance of a value v in 0..1: ``shot v + floor``; ``given`` if the bundle states it."""

    shot: float
    floor: float
    given: bool


def noise_model(camera: CameraEntry, stored_bits: int) -> NoiseModel:
    """Take the camera's noise model, or a typical one until the data are seen."""
    well = camera.full_well_e or TYPICAL_WELL_E
    read = TYPICAL_READ_E if camera.read_noise_e is None else camera.read_noise_e
    levels = 2.0 ** min(camera.bits or stored_bits, stored_bits) - 1
    floor = (read / well) ** 2 + 1 / (12 * levels**2)
    return NoiseModel(1 / well, floor, camera.full_well_e is not None)


def median_of_chi2(freedom: int) -> float:
    """Return the median of a reduced chi-square (Wilson and Hilferty 1931)."""
    return (1 - 2 / (9 * freedom)) ** 3


def fit_noise(
    levels: NDArray[np.floating], variances: NDArray[np.floating], freedom: int
) -> NoiseModel | None:
    """Fit the noise model to residual variances, by their medians over bins of the level.

    Parameters
    ----------
    levels, variances
        (N,) mean value, 0..1, and residual variance of pixels.
    freedom
        Degrees of freedom of each variance.

    Returns
    -------
    None where there are too few pixels to tell.
    """
    seen = np.isfinite(levels) & np.isfinite(variances) & (levels > 0)
    levels, variances = levels[seen].astype(np.float64), variances[seen].astype(np.float64)
    if len(levels) < _BINS * _FEWEST_PER_BIN:
        return None
    order = np.argsort(levels, kind="stable")
    middle, spread = np.array(
        [
            (np.median(levels[part]), np.median(variances[part]) / median_of_chi2(freedom))
            for part in np.array_split(order, _BINS)
        ]
    ).T
    if not spread.max() > 0:
        return None
    # Relative errors of the bins are alike; one unknown is dropped where it would be negative.
    weight = 1 / np.maximum(spread, 0.01 * spread.max())
    design = np.stack([middle, np.ones_like(middle)], axis=1) * weight[:, None]
    shot, floor = np.linalg.lstsq(design, spread * weight, rcond=None)[0]
    if shot < 0:
        shot, floor = 0.0, float(np.average(spread, weights=weight**2))
    elif floor < 0:
        shot, floor = (
            float((middle * spread * weight**2).sum() / (middle**2 * weight**2).sum()),
            0.0,
        )
    return NoiseModel(float(shot), max(float(floor), 1e-12), given=False)


def excess(chi2: NDArray[np.floating], freedom: int) -> float:
    """Return by how much residuals exceed their model: the square root of their typical ratio."""
    seen = chi2[np.isfinite(chi2)]
    if seen.size == 0:
        return 1.0
    return math.sqrt(float(np.median(seen)) / median_of_chi2(freedom))
