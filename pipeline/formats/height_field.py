"""The canvas as a height field, ``extract/height.exr`` and ``extract/frame.json``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.rigid import RigidTransform


@dataclass(frozen=True)
class HeightField:
    """Heights above the canvas plane on a regular grid.

    Row 0 is the top of the painting. Sample (row, column) lies at canvas coordinates
    ``x = column * spacing_mm, y = -row * spacing_mm, z = heights_mm[row, column]``: x right,
    y up, z out of the paint, the origin at the centre of sample (0, 0).

    Parameters
    ----------
    heights_mm, sigma_mm
        (rows, columns) float32; NaN outside the canvas and in large holes.
    filled
        (rows, columns) bool: small holes whose height was interpolated.
    spacing_mm
        Distance between neighbouring samples, > 0.
    scan_from_canvas
        Takes canvas coordinates to the scan's frame.
    """

    heights_mm: NDArray[np.float32]
    sigma_mm: NDArray[np.float32]
    filled: NDArray[np.bool_]
    spacing_mm: float
    scan_from_canvas: RigidTransform

    @property
    def canvas_size_mm(self) -> tuple[float, float]:
        """Width and height between the outermost samples' centres."""
        rows, columns = self.heights_mm.shape
        return (columns - 1) * self.spacing_mm, (rows - 1) * self.spacing_mm

    def canvas_points(self) -> NDArray[np.float64]:
        """Return the samples as canvas coordinates, (rows, columns, 3), mm."""
        rows, columns = self.heights_mm.shape
        x, y = np.meshgrid(np.arange(columns) * self.spacing_mm, -np.arange(rows) * self.spacing_mm)
        return np.stack([x, y, self.heights_mm.astype(np.float64)], axis=-1)
