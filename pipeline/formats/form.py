"""The low-order form of a canvas, as a polynomial in its plane."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

HIGHEST_DEGREE = 4


@dataclass(frozen=True)
class Form:
    """How a canvas bulges and twists.

    Parameters
    ----------
    degree
        Total degree, 0 to 4.
    coefficients_mm
        Of u^i v^j in the order of :func:`exponents`, u = (x - x0) / scale and v = (y - y0) / scale
        for canvas coordinates x, y.
    centre_mm
        (x0, y0).
    scale_mm
        > 0; half the canvas's longer side.
    range_mm
        From its lowest to its highest point on the canvas.
    """

    degree: int
    coefficients_mm: tuple[float, ...]
    centre_mm: tuple[float, float]
    scale_mm: float
    range_mm: float

    def heights(
        self, rows: int, columns: int, spacing_mm: float, known: NDArray[np.bool_]
    ) -> NDArray[np.float32]:
        """Return its heights (rows, columns) above the plane, mm; NaN where not ``known``."""
        u = (np.arange(columns) * spacing_mm - self.centre_mm[0]) / self.scale_mm
        v = (-np.arange(rows) * spacing_mm - self.centre_mm[1]) / self.scale_mm
        total = np.zeros((rows, columns))
        for (i, j), c in zip(exponents(self.degree), self.coefficients_mm, strict=True):
            total += c * (v**j)[:, None] * (u**i)[None]
        return np.where(known, total, np.nan).astype(np.float32)


def exponents(degree: int) -> list[tuple[int, int]]:
    """Return (i, j) of u^i v^j up to a total degree: 1, u, v, u^2, u v, v^2, ..."""
    return [(n - j, j) for n in range(degree + 1) for j in range(n + 1)]


class FormModel(BaseModel):
    """The key ``form`` of ``extract/frame.json``."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    degree: Annotated[int, Field(ge=0, le=HIGHEST_DEGREE)]
    coefficients_mm: tuple[float, ...]
    centre_mm: tuple[float, float]
    scale_mm: Annotated[float, Field(gt=0)]
    range_mm: Annotated[float, Field(ge=0)]

    @model_validator(mode="after")
    def _as_many_as_the_degree_has(self) -> FormModel:
        if len(self.coefficients_mm) != len(exponents(self.degree)):
            raise ValueError(f"{len(self.coefficients_mm)} coefficients for degree {self.degree}")
        return self

    def form(self) -> Form:
        """Return what it describes."""
        return Form(**self.model_dump())
