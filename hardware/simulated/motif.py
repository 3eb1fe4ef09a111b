"""The picture that the simulated painter has in mind: an evening over a lake, after Arles.

Everything is a function of the place on the canvas, in mm from its centre, x right and y up, for a
canvas of 160 x 120 mm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

CANVAS_MM = (160.0, 120.0)
SUN = (34.0, 25.0)
SKY, SUN_DISC, FAR, LAKE, HILL, FIELD, CYPRESS, HOUSE, ROOF = range(9)


@dataclass(frozen=True)
class Motif:
    """What the painter sees at each of some places (...,).

    Parameters
    ----------
    region
        One of the constants of this module.
    colour
        (..., 3) albedo, linear RGB.
    flow
        Direction of the brush, radians, counter-clockwise from x.
    """

    region: NDArray[np.int64]
    colour: Array
    flow: Array


def look_at(x: Array, y: Array) -> Motif:
    """Look at places on the canvas."""
    region = _regions(x, y)
    shape = (*np.shape(x), 3)
    colour, flow = np.zeros(shape), np.zeros(np.shape(x))
    painters = {
        SKY: _sky,
        SUN_DISC: _sun,
        FAR: _far,
        LAKE: _lake,
        HILL: _hill,
        FIELD: _field,
        CYPRESS: _cypress,
        HOUSE: _house,
        ROOF: _roof,
    }
    for name, paint in painters.items():
        here = region == name
        if here.any():
            colour[here], flow[here] = paint(x[here], y[here])
    return Motif(region, colour, flow)


def _regions(x: Array, y: Array) -> NDArray[np.int64]:
    region = np.full(np.shape(x), SKY)
    region[np.hypot(x - SUN[0], y - SUN[1]) < 9.5] = SUN_DISC
    region[y < _far_crest(x)] = FAR
    region[y < -8 + 0.02 * x] = LAKE
    region[y < _hill_crest(x)] = HILL
    region[y < _field_crest(x)] = FIELD
    region[(np.abs(x - 22) < 6) & (y > -22) & (y < -13)] = HOUSE
    region[(np.abs(x - 22) < 7.5 - 0.95 * (y + 13)) & (y >= -13) & (y < -6)] = ROOF
    height = np.clip((y + 52) / 92, 0, 1)
    width = 9.5 * np.sin(np.pi * np.clip(height, 0, 1) ** 0.6) ** 0.8 + 0.5
    sway = -54 + 2.2 * np.sin(y / 9.0)
    region[(np.abs(x - sway) < width) & (y > -52) & (y < 40)] = CYPRESS
    return region


def _far_crest(x: Array) -> Array:
    return np.asarray(3.5 + 6 * np.sin(x / 24 + 0.6) + 2.5 * np.sin(x / 9.0 + 2) - 0.03 * x)


def _hill_crest(x: Array) -> Array:
    return np.asarray(-19 + 4.5 * np.sin(x / 19 - 1.1) + 1.3 * np.sin(x / 6.0) + 0.05 * x)


def _field_crest(x: Array) -> Array:
    return np.asarray(-29 + 2.5 * np.sin(x / 27 + 0.8) - 0.06 * x)


def _mix(low: str, high: str, share: Array) -> Array:
    share = np.clip(share, 0, 1)[..., None]
    return np.asarray((1 - share) * pigment(low) + share * pigment(high))


def pigment(hexadecimal: str) -> Array:
    """Return the linear albedo of an sRGB colour, ``"e0a030"``."""
    encoded = np.array([int(hexadecimal[i : i + 2], 16) for i in (0, 2, 4)]) / 255
    return np.asarray(np.where(encoded < 0.04, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4))


def _sky(x: Array, y: Array) -> tuple[Array, Array]:
    dx, dy = x - SUN[0], y - SUN[1]
    away = np.hypot(dx, dy)
    colour = _mix("e6b98a", "3f6fb4", (y - 2) / 46 + 0.10 * np.sin(x / 13 + y / 7))
    colour += (_mix("6fa3d8", "2c4d94", (y + 10) / 70) - colour) * (
        0.5 * (np.sin(y / 3.1 + 2.2 * np.sin(x / 22)) > 0.25)
    )[..., None]
    glow = np.exp(-away / 13)[..., None] * 0.95
    rings = (0.5 + 0.5 * np.cos(away / 1.75))[..., None] * np.exp(-(((away - 17) / 11) ** 2))[
        ..., None
    ]
    colour = (1 - glow) * colour + glow * pigment("f4cf62")
    colour = (1 - 0.45 * rings) * colour + 0.45 * rings * pigment("fbe8ae")
    around = np.arctan2(dx, -dy)
    near = np.exp(-((away / 30) ** 2))
    # A second whirl at the left, as wind over the lake.
    wx, wy = x + 22, y - 38
    whirl = np.exp(-((np.hypot(wx, wy) / 19) ** 2))
    drift = 0.30 * np.sin(x / 17) + 0.22 * np.sin(y / 9)
    direction = np.stack(
        [
            (1 - near - whirl) * np.cos(drift) + near * np.cos(around) + whirl * wy / 12,
            (1 - near - whirl) * np.sin(drift) + near * np.sin(around) - whirl * wx / 12,
        ]
    )
    return colour, np.arctan2(direction[1], direction[0])


def _sun(x: Array, y: Array) -> tuple[Array, Array]:
    dx, dy = x - SUN[0], y - SUN[1]
    colour = _mix("fff4cc", "f3b431", np.hypot(dx, dy) / 10)
    return colour, np.arctan2(dx, -dy)


def _far(x: Array, y: Array) -> tuple[Array, Array]:
    depth = (_far_crest(x) - y) / 14
    slope = np.arctan(0.25 * np.cos(x / 24 + 0.6) + 0.28 * np.cos(x / 9.0 + 2))
    return _mix("8a86b8", "47608f", depth + 0.2 * np.sin(x / 5)), slope * (1 - 0.5 * depth)


def _lake(x: Array, y: Array) -> tuple[Array, Array]:
    colour = _mix("2f5f86", "5b93ad", 0.5 + 0.5 * np.sin(y * 1.9 + 0.25 * np.sin(x / 3)))
    mirror = np.exp(-(((x - SUN[0]) / (5 + 0.25 * np.abs(y + 8))) ** 2))
    mirror = (mirror * (0.45 + 0.55 * (np.sin(y * 3.3 + x / 4) > -0.2)))[..., None]
    return (1 - mirror) * colour + mirror * pigment("f0c25c"), 0.05 * np.sin(x / 11)


def _hill(x: Array, y: Array) -> tuple[Array, Array]:
    depth = (_hill_crest(x) - y) / 10
    slope = np.arctan(0.24 * np.cos(x / 19 - 1.1) + 0.2 * np.cos(x / 6.0) + 0.05)
    return _mix("8f9f3c", "3d6b3a", depth + 0.35 * np.sin(x / 4.5)), slope + 0.35


def _field(x: Array, y: Array) -> tuple[Array, Array]:
    colour = _mix("b98a2a", "ecc75a", 0.5 + 0.5 * np.sin(x / 2.6 + y / 5) * np.cos(y / 3.3))
    furrow = (np.sin((x + 0.6 * y) / 6.5) > 0.8)[..., None] * 0.55
    colour = (1 - furrow) * colour + furrow * pigment("7d7a2b")
    return colour, np.pi / 2 - 0.012 * x + 0.25 * np.sin(x / 8 + y / 6)


def _cypress(x: Array, y: Array) -> tuple[Array, Array]:
    light = 0.5 + 0.5 * np.sin(x / 1.6 + 1.3 * np.sin(y / 6))
    return _mix("12301f", "4b7a35", light * 0.9), np.pi / 2 + 0.45 * np.sin(y / 5 + x / 4)


def _house(x: Array, y: Array) -> tuple[Array, Array]:
    colour = _mix("e9d9bd", "b9a58e", (x - 16) / 14)
    window = (np.abs(np.abs(x - 22) - 3) < 0.9) & (np.abs(y + 17) < 1.4)
    colour[window] = pigment("34465e")
    return colour, np.full(np.shape(x), np.pi / 2)


def _roof(x: Array, _: Array) -> tuple[Array, Array]:
    return _mix("c5472c", "8c2f26", (x - 17) / 12), np.full(np.shape(x), 0.9)
