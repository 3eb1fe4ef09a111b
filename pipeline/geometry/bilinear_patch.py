"""Where a ray meets the bilinear surface between four samples, exactly.

Along a ray the gap between ray and surface, F(s) = z(s) - h(s), is a quadratic. Its signs where the
ray enters and leaves the patch come from the crossed edges alone, by the same operations from
either side of an edge, so that no ray slips through between two patches: where the signs differ
there is a hit, whatever the rounding. Source: the stable quadratic of Press et al. (2007), 5.6.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from numba import njit

MISS = math.inf


class Ray(NamedTuple):
    """A ray in grid units: columns, rows (downwards) and mm; t is that of the canvas's ray.

    Parameters
    ----------
    column, row, z
        Origin.
    to_column, to_row, to_z
        Direction.
    per_column, per_row, per_z
        Reciprocal direction, infinite where the direction is 0.
    side_column, side_row
        The origin; on an axis that the ray does not move along, the middle of the patches that
        it is taken to pass over.
    ahead_column, ahead_row
        1 where the ray goes up the axis or stands, else 0.
    """

    column: float
    row: float
    z: float
    to_column: float
    to_row: float
    to_z: float
    per_column: float
    per_row: float
    per_z: float
    side_column: float
    side_row: float
    ahead_column: int
    ahead_row: int


@njit(cache=True, error_model="numpy", forceinline=True)
def interpolate(a, b, f):  # type: ignore[no-untyped-def]
    """Interpolate from a to b; exact at both ends, and where a = b."""
    difference = b - a
    return a + f * difference if f < 0.5 else b - (1.0 - f) * difference


@njit(cache=True, error_model="numpy", forceinline=True)
def patch_hit(h00, h10, h01, h11, column, row, ray, t_begin, t_end):  # type: ignore[no-untyped-def]
    """Return the smallest t at which a ray meets a patch, or infinity.

    Parameters
    ----------
    h00, h10, h01, h11
        Heights at (column, row), (column + 1, row), (column, row + 1), (column + 1, row + 1); a
        patch with a NaN is never met.
    column, row
        The patch.
    ray
        A :class:`Ray` that passes over the patch.
    t_begin, t_end
        Only hits between these count; finite unless the ray leaves the patch.
    """
    enter_column = (float(column + 1 - ray.ahead_column) - ray.side_column) * ray.per_column
    leave_column = (float(column + ray.ahead_column) - ray.side_column) * ray.per_column
    enter_row = (float(row + 1 - ray.ahead_row) - ray.side_row) * ray.per_row
    leave_row = (float(row + ray.ahead_row) - ray.side_row) * ray.per_row
    t_in = max(max(enter_column, enter_row), t_begin)
    t_out = max(min(min(leave_column, leave_row), t_end), t_in)
    z_in, z_out = ray.z + t_in * ray.to_z, ray.z + t_out * ray.to_z
    if min(z_in, z_out) > max(max(h00, h10), max(h01, h11)):
        return MISS
    if max(z_in, z_out) < min(min(h00, h10), min(h01, h11)):
        return MISS
    # Coordinates inside the patch, exactly on the edge that is crossed.
    a = min(max(ray.column + t_in * ray.to_column - column, 0.0), 1.0)
    b = min(max(ray.row + t_in * ray.to_row - row, 0.0), 1.0)
    c = min(max(ray.column + t_out * ray.to_column - column, 0.0), 1.0)
    d = min(max(ray.row + t_out * ray.to_row - row, 0.0), 1.0)
    a = float(1 - ray.ahead_column) if t_in == enter_column else a
    b = float(1 - ray.ahead_row) if t_in == enter_row else b
    c = float(ray.ahead_column) if t_out == leave_column else c
    d = float(ray.ahead_row) if t_out == leave_row else d
    gap_in = z_in - interpolate(interpolate(h00, h01, b), interpolate(h10, h11, b), a)
    gap_out = z_out - interpolate(interpolate(h00, h01, d), interpolate(h10, h11, d), c)
    if gap_in == 0.0:
        return t_in
    length = t_out - t_in
    twist = (h11 - h01) - (h10 - h00)
    A = -twist * ray.to_column * ray.to_row
    crosses = gap_in * gap_out <= 0.0
    # Without a change of sign, F = chord - A s (length - s) can only touch 0 between the ends.
    sag = A * math.copysign(0.25 * length * length, gap_in)
    if not crosses and not sag >= min(abs(gap_in), abs(gap_out)):
        return MISS
    B = ray.to_z - (h10 - h00) * ray.to_column - (h01 - h00) * ray.to_row
    B -= twist * (a * ray.to_row + b * ray.to_column)
    discriminant = B * B - 4.0 * A * gap_in
    if not crosses and discriminant < 0.0:
        return MISS
    q = -0.5 * (B + math.copysign(math.sqrt(max(discriminant, 0.0)), B))
    # The first root is the one where F moves against the sign it starts with; B may be -0 or 0.
    s = q / A if (math.copysign(1.0, B) > 0.0) == (gap_in > 0.0) else gap_in / q
    if crosses:
        return t_in + (max(s, 0.0) if s < length else length)
    return t_in + s if 0.0 <= s <= length else MISS
