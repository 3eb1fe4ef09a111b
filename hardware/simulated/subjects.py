"""What stands before the simulated cameras: a painting on the table, a board in the air.

Everything is in the rig's frame, mm. The table is the plane z = 0, dark and matte, without end.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from hardware.simulated.painting import Painting
from pipeline.geometry.raycast import RayCaster
from pipeline.geometry.rigid import RigidTransform

Array = NDArray[np.float64]

NOTHING, CANVAS, FRAME, TABLE, BOARD = range(5)

TABLE_ALBEDO, BOARD_WHITE, BOARD_BLACK = 0.045, 0.85, 0.04
MARGIN_MM = 0.02
"""A shadow ray's start that is not tested: the surface itself, within rounding."""

# A material: unit normal (0..2), rho_d (3..5), rho_s (6..8), C_xy, C_z, k (9..11).
_MATTE = (0.0, 0.0, 0.0, -1.0, 1.0, 1.0)


class Hits(NamedTuple):
    """What N rays meet.

    Parameters
    ----------
    points_mm
        (N, 3); NaN where a ray meets nothing.
    material
        (N, 12) float32: unit normal towards the viewer, rho_d, rho_s (RGB, 1/sr), C_xy, C_z, k.
    kind
        (N,) uint8, one of this module's constants.
    """

    points_mm: Array
    material: NDArray[np.float32]
    kind: NDArray[np.uint8]


class Subject(Protocol):
    """Something to look at."""

    def trace(self, origin_mm: Array, directions: Array) -> Hits:
        """Meet rays from one point along (N, 3) directions."""

    def lit(self, points_mm: Array, source_mm: Array) -> NDArray[np.bool_]:
        """Tell which points (N, 3) see the source."""


class PaintedCanvas:
    """A painting prepared for ray casting; poses come and go, this stays."""

    def __init__(self, painting: Painting) -> None:
        self.painting = painting
        self.caster = RayCaster(painting.heights_mm, painting.spacing_mm)
        self.corner = np.array([painting.left_mm, painting.top_mm, 0.0])
        kind = np.where(painting.canvas, CANVAS, FRAME).astype(np.uint8)
        self.kind = np.ascontiguousarray(kind)
        self.maps = np.concatenate(
            [painting.normals, painting.diffuse, painting.specular, painting.lobe], axis=2
        ).astype(np.float32)


class PaintingOnTable:
    """A painting as it lies on the table, at one angle of it."""

    def __init__(self, canvas: PaintedCanvas, rig_from_canvas: RigidTransform) -> None:
        self._canvas, self._pose = canvas, rig_from_canvas
        self._back = rig_from_canvas.inverse()

    def trace(self, origin_mm: Array, directions: Array) -> Hits:
        """Meet the painting or the table, whichever is nearer."""
        canvas = self._canvas
        origin = self._back.apply(origin_mm) - canvas.corner
        turned = self._back.rotate(directions)
        distance = canvas.caster.first_hit(np.tile(origin, (len(turned), 1)), turned)
        table = _distance_to_table(origin_mm, directions)
        material = np.empty((len(turned), 12), np.float32)
        kind = np.empty(len(turned), np.uint8)
        here = origin + turned * np.where(np.isfinite(distance), distance, 0.0)[:, None]
        on_table = table < distance
        _gather(
            canvas.maps,
            canvas.kind,
            here,
            np.isfinite(distance) & ~on_table,
            self._pose.rotation,
            canvas.painting.spacing_mm,
            material,
            kind,
        )
        _fill_table(material, kind, on_table)
        nearest = np.minimum(distance, table)
        nearest[~np.isfinite(nearest)] = np.nan
        return Hits(origin_mm + directions * nearest[:, None], material, kind)

    def lit(self, points_mm: Array, source_mm: Array) -> NDArray[np.bool_]:
        """Tell which points see the source past the painting's own relief and its frame."""
        known = np.isfinite(points_mm[:, 0])
        points = self._back.apply(points_mm[known]) - self._canvas.corner
        target = self._back.apply(source_mm) - self._canvas.corner
        lit = np.zeros(len(points_mm), dtype=bool)
        lit[known] = ~self._canvas.caster.occluded(
            points, np.tile(target, (len(points), 1)), MARGIN_MM
        )
        return lit


@dataclass(frozen=True)
class Chessboard:
    """A matte board, its first inner corner at the origin, x along the columns, z away."""

    inner_corners: tuple[int, int]
    square_mm: float
    border_mm: float = 8.0


class BoardInAir:
    """A chessboard held over the table."""

    def __init__(self, board: Chessboard, rig_from_board: RigidTransform, grain_mm: float) -> None:
        self._board, self._pose, self._back = board, rig_from_board, rig_from_board.inverse()
        self._grain = grain_mm

    def trace(self, origin_mm: Array, directions: Array) -> Hits:
        """Meet the board or the table; a ray stands for a patch of the board ``grain_mm`` wide."""
        board = self._board
        origin, turned = self._back.apply(origin_mm), self._back.rotate(directions)
        with np.errstate(divide="ignore"):
            distance = -origin[2] / turned[:, 2]
        place = origin[:2] + turned[:, :2] * distance[:, None]
        last = (np.array(board.inner_corners) * board.square_mm) + board.border_mm
        first = -board.square_mm - board.border_mm
        on_board = ((place > first) & (place < last)).all(axis=1) & (distance > 0)
        points = origin_mm + directions * np.where(on_board, distance, np.nan)[:, None]
        table = _distance_to_table(origin_mm, directions)
        on_table = ~on_board & np.isfinite(table)
        points[on_table] = origin_mm + directions[on_table] * table[on_table, None]

        shade = self._shade(place)
        normal = self._pose.rotation[:, 2] * np.sign(origin[2])
        material = np.empty((len(turned), 12), np.float32)
        material[:, :3] = normal
        material[:, 3:6] = (shade / np.pi)[:, None]
        material[:, 6:] = _MATTE
        kind = np.where(on_board, BOARD, NOTHING).astype(np.uint8)
        _fill_table(material, kind, on_table)
        return Hits(points, material, kind)

    def lit(self, points_mm: Array, source_mm: Array) -> NDArray[np.bool_]:
        """Tell which points see the source; only the table can lie in the board's shadow."""
        board = self._board
        points, source = self._back.apply(points_mm), self._back.apply(source_mm)
        with np.errstate(divide="ignore", invalid="ignore"):
            share = points[:, 2] / (points[:, 2] - source[2])
            place = points[:, :2] + share[:, None] * (source[:2] - points[:, :2])
        last = (np.array(board.inner_corners) * board.square_mm) + board.border_mm
        first = -board.square_mm - board.border_mm
        crosses = (share > 1e-6) & (share < 1) & ((place > first) & (place < last)).all(axis=1)
        return np.asarray(np.isfinite(points_mm[:, 0]) & ~crosses)

    def _shade(self, place_mm: Array) -> Array:
        """Return the albedo at places (N, 2), averaged over the grain."""
        square = self._board.square_mm
        columns, rows = self._board.inner_corners
        width = self._grain / square
        u, v = place_mm[:, 0] / square, place_mm[:, 1] / square
        # Black are the squares even both ways and those odd both ways.
        black = sum(
            _share_of_squares(u, columns, parity, width) * _share_of_squares(v, rows, parity, width)
            for parity in (0, 1)
        )
        return np.asarray(BOARD_WHITE - (BOARD_WHITE - BOARD_BLACK) * black)


def _share_of_squares(u: Array, last: int, parity: int, width: float) -> Array:
    """Return the share of [u - width / 2, u + width / 2] in the squares of one parity.

    Square n lies between n and n + 1; they go from -1 to ``last``.
    """

    def covered(t: Array) -> Array:
        t = np.clip(t, -1, last) - parity
        whole = np.floor(t / 2)
        return np.asarray(whole + np.minimum(t - 2 * whole, 1))

    return np.asarray((covered(u + width / 2) - covered(u - width / 2)) / width)


def _distance_to_table(origin_mm: Array, directions: Array) -> Array:
    with np.errstate(divide="ignore"):
        distance = -origin_mm[2] / directions[:, 2]
    return np.where(distance > 0, distance, np.inf)


def _fill_table(
    material: NDArray[np.float32], kind: NDArray[np.uint8], where: NDArray[np.bool_]
) -> None:
    rho = TABLE_ALBEDO / np.pi
    material[where] = (0.0, 0.0, 1.0, rho, rho, rho, *_MATTE)
    kind[where] = TABLE


@njit(cache=True, parallel=True)
def _gather(maps, kinds, points, wanted, rotation, spacing, material, kind):  # type: ignore[no-untyped-def]
    """Interpolate the maps bilinearly at points (N, 3) of the grid; turn the normals."""
    rows, columns, layers = maps.shape
    for i in prange(len(points)):
        kind[i] = 0
        material[i] = 0
        if not wanted[i]:
            continue
        u = min(max(points[i, 0] / spacing, 0.0), columns - 1.0)
        v = min(max(-points[i, 1] / spacing, 0.0), rows - 1.0)
        c, r = min(int(u), columns - 2), min(int(v), rows - 2)
        a, b = u - c, v - r
        for k in range(layers):
            upper = (1 - a) * maps[r, c, k] + a * maps[r, c + 1, k]
            lower = (1 - a) * maps[r + 1, c, k] + a * maps[r + 1, c + 1, k]
            material[i, k] = (1 - b) * upper + b * lower
        x, y, z = material[i, 0], material[i, 1], material[i, 2]
        length = np.sqrt(x * x + y * y + z * z)
        for k in range(3):
            turned = rotation[k, 0] * x + rotation[k, 1] * y + rotation[k, 2] * z
            material[i, k] = turned / length
        kind[i] = kinds[int(v + 0.5), int(u + 0.5)]
