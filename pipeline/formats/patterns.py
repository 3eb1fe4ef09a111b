"""The patterns a projector shows, as the bundle page defines them."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

Axis = Literal["x", "y"]


class _Pattern(BaseModel):
    model_config = ConfigDict(frozen=True, extra="allow", allow_inf_nan=False)


class White(_Pattern):
    """Uniform full intensity."""

    type: Literal["white"] = "white"


class Black(_Pattern):
    """Uniform zero."""

    type: Literal["black"] = "black"


class Gray(_Pattern):
    """Bit ``bit`` (0 the coarsest) of the reflected Gray code of floor(c / cell_px)."""

    type: Literal["gray"] = "gray"
    axis: Axis
    bit: int = Field(ge=0, le=31)
    bits: int = Field(ge=1, le=32)
    cell_px: int = Field(default=1, ge=1)
    inverted: bool = False


class Phase(_Pattern):
    """1/2 + 1/2 cos(2 pi (c + 1/2) / period_px + phase_offset + sign 2 pi step / steps)."""

    type: Literal["phase"] = "phase"
    axis: Axis
    period_px: float = Field(gt=0)
    step: int = Field(ge=0)
    steps: int = Field(ge=1)
    phase_offset: float = 0.0
    sign: Literal[1, -1] = 1


class Product(_Pattern):
    """The product of two patterns."""

    type: Literal["product"] = "product"
    of: tuple[Pattern, Pattern]


Pattern = Annotated[White | Black | Gray | Phase | Product, Field(discriminator="type")]
Product.model_rebuild()


def intensity(
    pattern: Pattern, x: NDArray[np.floating], y: NDArray[np.floating]
) -> NDArray[np.float64]:
    """Return the pattern's ideal intensity, 0 to 1, at projector coordinates (px, any shape).

    Binary patterns are sharp: the pixel that a coordinate falls in decides.
    """
    raise NotImplementedError


def pattern_image(pattern: Pattern, size_px: tuple[int, int]) -> NDArray[np.float64]:
    """Draw the pattern pixel by pixel, (height, width), 0 to 1."""
    raise NotImplementedError
