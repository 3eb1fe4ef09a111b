"""The asset: all that a renderer needs, and nothing else (``asset/``)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.boxes import Boxes


@dataclass(frozen=True)
class Asset:
    """A painting ready to be drawn; arrays on one grid, row 0 at the painting's top.

    Sample (row, column) lies at canvas coordinates ``(column, -row) * spacing_mm``.

    Parameters
    ----------
    heights_mm
        (rows, columns) float32; 0 outside the canvas.
    normals
        (rows, columns, 2) float32 n_x, n_y of the unit normal, canvas frame, n_z > 0.
    mask
        (rows, columns) bool: the canvas.
    diffuse, specular, lobe
        (rows, columns, 3) float32 as in ``ReflectanceMaps``, 0 outside the canvas.
    boxes
        The relief above the bump-mapped plane; may be empty.
    notes
        Plain statements about what is and is not known: ``reflectance`` (``fitted``,
        ``white image``, ``fringes``), ``absolute``, ``colour_calibrated``, ``scale_known``.
    """

    name: str
    spacing_mm: float
    heights_mm: NDArray[np.float32]
    normals: NDArray[np.float32]
    mask: NDArray[np.bool_]
    diffuse: NDArray[np.float32]
    specular: NDArray[np.float32]
    lobe: NDArray[np.float32]
    boxes: Boxes
    notes: dict[str, str | bool | float]
