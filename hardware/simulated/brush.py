"""Strokes of a brush: thick paint with ridges of bristles, laid one over the other on a grid."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Map = NDArray[np.float32]


class Layers(NamedTuple):
    """What strokes change, in place; arrays over one grid, row 0 at the top.

    Parameters
    ----------
    relief
        (rows, columns) thickness of the paint, mm.
    colour
        (rows, columns, 3) albedo, linear RGB.
    gloss
        (rows, columns) 0 matte to 1 glossy.
    """

    relief: Map
    colour: Map
    gloss: Map


class Strokes(NamedTuple):
    """Strokes in the order in which they are laid; arrays over N strokes.

    Parameters
    ----------
    path
        (N, points, 2) column, row of the centre line, samples, in equal steps.
    half_width
        (N,) samples.
    thickness
        (N,) of the fresh paint, mm.
    colour
        (N, 3) albedo.
    gloss
        (N,).
    bristles
        (N, 6) wave numbers over the half width (0..2) and phases (3..5) of the ridges.
    """

    path: NDArray[np.float64]
    half_width: NDArray[np.float64]
    thickness: NDArray[np.float64]
    colour: NDArray[np.float64]
    gloss: NDArray[np.float64]
    bristles: NDArray[np.float64]


def lay(layers: Layers, strokes: Strokes) -> None:
    """Lay the strokes, in order, in place.

    A stroke covers what it crosses: fresh paint lies on half of the relief below it, since a loaded
    brush levels wet paint; its edges bear the ridge that the brush pushes aside, its end the one
    that it leaves when lifted.
    """
    _lay_all(*layers, *strokes)


@njit(cache=True)
def _lay_all(relief, colour, gloss, path, half, thickness, tint, shine, bristles):  # type: ignore[no-untyped-def]
    for i in range(len(half)):
        _lay_one(
            relief, colour, gloss, path[i], half[i], thickness[i], tint[i], shine[i], bristles[i]
        )


@njit(cache=True, error_model="numpy")
def _smooth(low, high, value):  # type: ignore[no-untyped-def]
    t = min(max((value - low) / (high - low), 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)


@njit(cache=True, error_model="numpy")
def _lay_one(relief, colour, gloss, path, half, thickness, tint, shine, bristles):  # type: ignore[no-untyped-def]
    rows, columns = relief.shape
    count = path.shape[0]
    left = max(int(path[:, 0].min() - half) - 1, 0)
    right = min(int(path[:, 0].max() + half) + 2, columns)
    top = max(int(path[:, 1].min() - half) - 1, 0)
    bottom = min(int(path[:, 1].max() + half) + 2, rows)
    step = math.hypot(path[1, 0] - path[0, 0], path[1, 1] - path[0, 1])
    length = step * (count - 1)
    for row in range(top, bottom):
        for column in range(left, right):
            best, along, across = 1e30, 0.0, 0.0
            for k in range(count - 1):
                ax, ay = path[k, 0], path[k, 1]
                bx, by = path[k + 1, 0] - ax, path[k + 1, 1] - ay
                px, py = column - ax, row - ay
                square = bx * bx + by * by
                t = min(max((px * bx + py * by) / square, 0.0), 1.0)
                dx, dy = px - t * bx, py - t * by
                distance = dx * dx + dy * dy
                if distance < best:
                    best = distance
                    along = (k + t) * step
                    across = math.copysign(math.sqrt(distance), bx * py - by * px)
            v = across / half
            if abs(v) >= 1.0:
                continue
            s = along / length
            ridges = 0.0
            for k in range(3):
                ridges += math.sin(bristles[k] * v + bristles[3 + k] + 0.7 * k * s)
            ridges /= 3.0
            # The last bristles leave the canvas at different places.
            end = 1.0 - 0.18 * (0.5 + 0.5 * math.sin(9.0 * v + bristles[4]))
            cover = _smooth(1.0, 0.72, abs(v))
            if length > 3.0 * half:  # a dab is round
                cover *= _smooth(0.0, 0.06, s + 0.03) * _smooth(end, end - 0.12, s)
            if cover <= 0.0:
                continue
            edge = math.exp(-(((abs(v) - 0.74) / 0.14) ** 2))
            lift = math.exp(-(((s - end + 0.14) / 0.07) ** 2))
            load = 1.0 - 0.45 * s
            fresh = thickness * load * (0.75 + 0.3 * ridges + 0.35 * edge) + 0.3 * thickness * lift
            old = relief[row, column]
            relief[row, column] = old + cover * (fresh - 0.5 * old)
            tone = 1.0 + 0.10 * ridges
            body = min(1.0, cover * (1.15 + 0.35 * ridges))
            for c in range(3):
                colour[row, column, c] += body * (tint[c] * tone - colour[row, column, c])
            gloss[row, column] += body * (shine - gloss[row, column])
