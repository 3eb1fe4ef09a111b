"""Points of one patch looked up in another: how far apart they are, and which way that tells."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.extract.patch import PatchMap, blur
from pipeline.geometry.height_grid import sample_bilinear
from pipeline.geometry.rigid import RigidTransform

Array = NDArray[np.float64]

FEWEST = 200
"""Points that an overlap has at least."""

_SLOPE_WIDTH = 1.0  # samples
_MOST_SAMPLES = 12_000  # of each overlap, from each side


@dataclass(frozen=True)
class Layers:
    """A map and its layers (rows, columns, 7).

    Height, its slopes along x and y, albedo detail, its slopes along x and y, and the height's
    standard deviation.
    """

    map: PatchMap
    stack: NDArray[np.float64]

    def points(self) -> tuple[Array, Array]:
        """Return all known points (N, 3) and their layers (N, 7)."""
        row, column = np.nonzero(np.isfinite(self.stack[..., :3]).all(axis=2))
        x = self.map.left_mm + column * self.map.spacing_mm
        y = self.map.top_mm - row * self.map.spacing_mm
        layers = self.stack[row, column]
        return np.column_stack([x, y, layers[:, 0]]), layers

    def at(self, points: Array) -> Array:
        """Return the layers (N, 7) under points (N, 3); NaN outside."""
        column = (points[:, 0] - self.map.left_mm) / self.map.spacing_mm
        row = (self.map.top_mm - points[:, 1]) / self.map.spacing_mm
        return np.asarray(sample_bilinear(self.stack, column, row))


def layers_of(one: PatchMap, width: float) -> Layers:
    """Smooth a map by a Gaussian of ``width`` samples and take its slopes."""
    stack = []
    for image in (one.heights, one.detail):
        smooth = blur(image, width)
        # Slopes that are mere noise would pass for relief that holds the patch in place.
        down, right = np.gradient(blur(smooth, _SLOPE_WIDTH), one.spacing_mm)
        stack += [smooth, right, -down]
    return Layers(one, np.stack([*stack, one.sigma], axis=-1))


@dataclass(frozen=True)
class Pairs:
    """Points of one patch over another, in common axes.

    Parameters
    ----------
    points
        (N, 3) mm.
    normal
        (N, 3) of the other patch, scaled so that its z in that patch's axes is 1.
    height, sigma
        (N,) heights above the other patch, and their standard deviations, mm.
    gradient
        (N, 3) of the other's albedo detail, per mm.
    albedo
        (N,) the other's albedo detail less the own; NaN where not known.
    stride
        One point was taken of so many.
    """

    points: Array
    normal: Array
    height: Array
    sigma: Array
    gradient: Array
    albedo: Array
    stride: float


def look_up(
    layers: list[Layers],
    points: list[tuple[Array, Array]],
    motions: list[RigidTransform],
    i: int,
    j: int,
) -> Pairs | None:
    """Look the points of patch i up in patch j; None where they do not overlap."""
    own, values = points[i]
    back = motions[j].inverse() @ motions[i]
    there = back.apply(own)
    box = _bounds(layers[j].map)
    over = np.flatnonzero(((there[:, :2] >= box[0]) & (there[:, :2] <= box[1])).all(axis=1))
    stride = max(1, len(over) // _MOST_SAMPLES)
    over = over[::stride]
    other = layers[j].at(there[over])
    good = np.isfinite(other[:, :3]).all(axis=1) & np.isfinite(other[:, 6])
    if np.count_nonzero(good) < FEWEST:
        return None
    over, other, there = over[good], other[good], there[over[good]]
    values = values[over]
    flat = np.zeros(len(over))
    turn = motions[j]
    return Pairs(
        motions[i].apply(own[over]),
        turn.rotate(np.column_stack([-other[:, 1], -other[:, 2], flat + 1])),
        there[:, 2] - other[:, 0],
        np.hypot(values[:, 6], other[:, 6]),
        turn.rotate(np.column_stack([other[:, 4], other[:, 5], flat])),
        other[:, 3] - values[:, 3],
        float(stride),
    )


def _bounds(one: PatchMap) -> tuple[Array, Array]:
    rows, columns = one.heights.shape
    low = np.array([one.left_mm, one.top_mm - (rows - 1) * one.spacing_mm])
    high = np.array([one.left_mm + (columns - 1) * one.spacing_mm, one.top_mm])
    return low, high
