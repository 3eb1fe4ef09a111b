"""Pictures for people: arrays become 8-bit images, false colour, shading, scale bars.

Images are (rows, columns, 3) uint8 RGB unless said otherwise; missing values are ``PAPER``.
"""

from __future__ import annotations

import base64
import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.uint8]

PAPER = (236, 234, 230)
WIDEST_PX = 1100


@dataclass(frozen=True)
class FalseColour:
    """A picture in false colour and the legend that reads it.

    Parameters
    ----------
    picture
        (rows, columns, 3) uint8 RGB.
    legend
        (1, 256, 3) uint8 RGB, from ``low`` to ``high``.
    low, high
        The values at the legend's ends, in ``unit``.
    clipped
        Share of the finite values outside [low, high].
    """

    picture: Picture
    legend: Picture
    low: float
    high: float
    unit: str
    clipped: float


def false_colour(
    values: NDArray[np.floating],
    unit: str,
    *,
    symmetric: bool = False,
    percentiles: tuple[float, float] = (0.5, 99.5),
) -> FalseColour:
    """Colour an image by value: viridis, or a blue-white-red scale around 0 if ``symmetric``.

    The scale runs between two percentiles, so that a few outliers do not flatten the picture;
    what lies beyond is drawn in the end colours and counted.
    """
    finite = np.isfinite(values)
    known = np.asarray(values[finite], dtype=np.float64)
    if known.size == 0:
        low, high = 0.0, 1.0
    elif symmetric:
        high = float(np.percentile(np.abs(known), percentiles[1])) or 1.0
        low = -high
    else:
        low, high = (float(value) for value in np.percentile(known, percentiles))
        if high <= low:
            high = low + (abs(low) or 1.0) * 1e-6
    level = np.where(finite, (np.where(finite, values, low) - low) / (high - low), 0.0)
    table = _diverging() if symmetric else _viridis()
    picture: Picture = table[np.clip(np.rint(level * 255), 0, 255).astype(np.uint8)]
    picture[~finite] = PAPER
    clipped = float(np.mean((known < low) | (known > high))) if known.size else 0.0
    return FalseColour(picture, table[None], low, high, unit, clipped)


def _viridis() -> Picture:
    ramp = np.arange(256, dtype=np.uint8)[None]
    return np.asarray(cv2.applyColorMap(ramp, cv2.COLORMAP_VIRIDIS)[0, :, ::-1].copy(), np.uint8)


def _diverging() -> Picture:
    """Blue to near-white to red, of about equal lightness on both sides."""
    t = np.linspace(-1, 1, 256)[:, None]
    middle, cold, warm = np.array([245, 245, 242]), np.array([38, 84, 160]), np.array([176, 40, 46])
    strength = np.abs(t) ** 0.8
    table: Picture = np.rint(middle + strength * (np.where(t < 0, cold, warm) - middle)).astype(
        np.uint8
    )
    return table


def shaded_relief(
    heights_mm: NDArray[np.floating],
    spacing_mm: float,
    *,
    azimuth_deg: float = 135.0,
    elevation_deg: float = 30.0,
) -> Picture:
    """Draw the height field as matte plaster under one distant lamp (Lambert's law).

    ``azimuth_deg`` is counter-clockwise from the right edge, so 135 lights from the upper left.
    """
    slope_down, slope_right = np.gradient(heights_mm.astype(np.float64), spacing_mm)
    azimuth, elevation = math.radians(azimuth_deg), math.radians(elevation_deg)
    light = (
        math.cos(elevation) * math.cos(azimuth),
        math.cos(elevation) * math.sin(azimuth),
        math.sin(elevation),
    )
    # Rows go down while y goes up, hence the sign of the second term.
    facing = -slope_right * light[0] + slope_down * light[1] + light[2]
    shade = np.clip(facing / np.sqrt(1 + slope_right**2 + slope_down**2), 0, 1)
    grey = 255 * np.clip(shade, 0, 1) ** (1 / 2.2)
    picture = np.repeat(np.where(np.isfinite(grey), grey, 0)[..., None], 3, axis=2)
    picture[~np.isfinite(grey)] = PAPER
    rounded: Picture = np.rint(picture).astype(np.uint8)
    return rounded


def display(linear: NDArray[np.floating], *, percentile: float = 99.5) -> Picture:
    """Show linear light: the given percentile becomes white, then a gamma of 2.2; NaN is paper."""
    image = linear if linear.ndim == 3 else np.repeat(linear[..., None], 3, axis=2)
    finite = np.asarray(np.isfinite(image).all(axis=2))
    white = float(np.percentile(image[finite], percentile)) if finite.any() else 1.0
    level = np.where(finite[..., None], image, 0) / (white or 1.0)
    picture: Picture = np.rint(255 * np.clip(level, 0, 1) ** (1 / 2.2)).astype(np.uint8)
    picture[~finite] = PAPER
    return picture


def fit_width(picture: Picture, widest_px: int = WIDEST_PX) -> Picture:
    """Scale down, by area averaging, to at most ``widest_px`` columns; never up."""
    rows, columns = picture.shape[:2]
    if columns <= widest_px:
        return picture
    size = (widest_px, max(1, round(rows * widest_px / columns)))
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def data_uri(picture: Picture, *, lossless: bool = False) -> str:
    """Encode a picture into a ``data:`` address: JPEG for photographs, PNG for charts."""
    extension, options = (".png", []) if lossless else (".jpg", [cv2.IMWRITE_JPEG_QUALITY, 88])
    done, encoded = cv2.imencode(extension, np.ascontiguousarray(picture[..., ::-1]), options)
    if not done:
        raise ValueError(f"a picture of shape {picture.shape} could not be encoded")
    kind = "png" if lossless else "jpeg"
    return f"data:image/{kind};base64,{base64.b64encode(encoded.tobytes()).decode('ascii')}"


def round_length(longest: float) -> float:
    """Return the largest of 1, 2, 5 times a power of ten that is at most ``longest`` > 0."""
    power = 10.0 ** math.floor(math.log10(longest))
    return max(step * power for step in (1, 2, 5) if step * power <= longest * (1 + 1e-12))
