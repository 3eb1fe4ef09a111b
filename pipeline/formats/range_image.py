"""The scan's result, one point per camera pixel, and its file ``scan/range.exr``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class RangeImage:
    """Points in the scan's frame on the scan camera's pixel grid; NaN where not measured.

    Parameters
    ----------
    points_mm
        (rows, columns, 3) float32 X, Y, Z.
    sigma_mm
        (rows, columns) float32 standard deviation of the position along the viewing ray.
    """

    points_mm: NDArray[np.float32]
    sigma_mm: NDArray[np.float32]


@dataclass(frozen=True)
class Texture:
    """What the scan camera saw under the projector's uniform light (``scan/texture.exr``).

    Parameters
    ----------
    radiance
        (rows, columns) or (rows, columns, 3) float32, linear, per second of exposure where the
        exposures are known: projector light alone, ambient removed where it can be; NaN where
        unknown (saturated in all exposures, or dark).
    source
        ``white`` (white minus black frames) or ``fringes`` (mean or amplitude of the phase steps).
    """

    radiance: NDArray[np.float32]
    source: str
