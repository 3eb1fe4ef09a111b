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


def pattern_label(pattern: Pattern) -> str:
    """Name a pattern for people: ``gray x bit 2 of 7``, ``phase y period 24 step 1 of 4``."""
    if isinstance(pattern, Product):
        return " times ".join(pattern_label(p) for p in pattern.of)
    if isinstance(pattern, Gray):
        inverted = " inverted" if pattern.inverted else ""
        return f"gray {pattern.axis} bit {pattern.bit} of {pattern.bits}{inverted}"
    if isinstance(pattern, Phase):
        period = f"{pattern.period_px:g}"
        return f"phase {pattern.axis} period {period} step {pattern.step} of {pattern.steps}"
    return pattern.type


def intensity(
    pattern: Pattern, x: NDArray[np.floating], y: NDArray[np.floating]
) -> NDArray[np.float64]:
    """Return the pattern's ideal intensity, 0 to 1, at projector coordinates.

    Gray patterns are sharp: the pixel that a coordinate falls in decides. Outside the projector's
    image the formulas go on; left of and above it a Gray code stays at its first cell.

    Parameters
    ----------
    pattern
        What is shown.
    x, y
        Column and row, px, pixel centres at whole numbers; any shapes that broadcast.

    Returns
    -------
    NDArray
        Intensity in the shape that ``x`` and ``y`` broadcast to; NaN where the coordinate is.

    Source: reflected Gray code, Gray (1953), n xor (n >> 1); phase shifting as in the bundle page.
    """
    x, y = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
    if isinstance(pattern, Product):
        first, second = pattern.of
        return intensity(first, x, y) * intensity(second, x, y)
    if isinstance(pattern, White | Black):
        level = 1.0 if isinstance(pattern, White) else 0.0
        return np.where(np.isnan(x) | np.isnan(y), np.nan, level)
    along = x if pattern.axis == "x" else y
    if isinstance(pattern, Gray):
        return _gray_intensity(pattern, along)
    shift = pattern.phase_offset + pattern.sign * 2 * np.pi * pattern.step / pattern.steps
    return np.asarray(0.5 + 0.5 * np.cos(2 * np.pi * (along + 0.5) / pattern.period_px + shift))


def _gray_intensity(pattern: Gray, along: NDArray[np.floating]) -> NDArray[np.float64]:
    unknown = np.isnan(along)
    pixel = np.floor(np.where(unknown, 0.0, along) + 0.5)
    number = np.clip(pixel // pattern.cell_px, 0, 2.0**52).astype(np.int64)
    code = number ^ (number >> 1)
    lit = ((code >> (pattern.bits - 1 - pattern.bit)) & 1) != int(pattern.inverted)
    return np.where(unknown, np.nan, lit.astype(np.float64))


def pattern_image(pattern: Pattern, size_px: tuple[int, int]) -> NDArray[np.float64]:
    """Draw the pattern pixel by pixel, (height, width), 0 to 1.

    Parameters
    ----------
    pattern
        What to show.
    size_px
        (width, height) of the projector.
    """
    width, height = size_px
    columns, rows = np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64)
    return intensity(pattern, columns[None, :], rows[:, None])
