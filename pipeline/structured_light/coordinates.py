"""What decoding a sequence gives, whatever patterns it used."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class ProjectorCoordinates:
    """The projector coordinate that lit each camera pixel; arrays are (rows, columns) float32.

    Coordinates are projector pixels, (0, 0) the centre of the top-left one: what the bundle page
    writes as I(c) at integer column c is column c here.

    Parameters
    ----------
    x, y
        Column and row; None for an axis that was not coded; NaN where not decoded.
    sigma_x, sigma_y
        Their standard deviations, px; None with the axis.
    radiance
        Projector light alone (white minus black, or twice the fringes' amplitude ...), per second
        of exposure where known, merged over exposures; NaN where unknown.
    radiance_source
        ``white`` or ``fringes``.
    statistics
        Counts and figures for the manifest (pixels repaired, steps dropped ...).
    """

    x: NDArray[np.float32] | None
    y: NDArray[np.float32] | None
    sigma_x: NDArray[np.float32] | None
    sigma_y: NDArray[np.float32] | None
    radiance: NDArray[np.float32]
    radiance_source: str
    statistics: dict[str, float]
