"""How points seen by the projector's light move when the table's axis is taken to be elsewhere.

The points lie where rays of the projector, which stands still, meet a canvas that the table has
turned. If the axis moves by a little, the canvas moves by v, and the point along its ray d by
(n . v) / (n . d) d, n the canvas's normal: so views of a turned canvas tell of the axis as well.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.rigid import rotation_about_axis

Array = NDArray[np.float64]

AXIS = 4
"""Parameters of an axis: its tilt about two directions across it, its shift along them."""

AXIS_SIGMA = np.array([2e-4, 2e-4, 0.05, 0.05])
"""How well boards on the table tell its axis: tilt, rad, and place, mm."""

_STEP = 1e-5


def axis_motion(
    points_mm: Array,
    normals: Array,
    rays: Array,
    axis_point_mm: Array,
    axis_direction: Array,
    angle_deg: float,
) -> Array:
    """Return how points where rays meet the turned canvas move with the axis, (N, 3, 4).

    Parameters
    ----------
    points_mm, normals, rays
        (N, 3) in the scan's frame, as turned by ``angle_deg``.
    """
    table = rotation_about_axis(axis_point_mm, axis_direction, angle_deg)
    before = table.inverse().apply(points_mm)
    columns = []
    for index in range(AXIS):
        step = np.zeros(AXIS)
        step[index] = _STEP
        point, direction = moved_axis(axis_point_mm, axis_direction, step)
        there = rotation_about_axis(point, direction, angle_deg).apply(before)
        velocity = (there - points_mm) / _STEP
        along = np.einsum("ij,ij->i", normals, velocity) / np.einsum("ij,ij->i", normals, rays)
        columns.append(along[:, None] * rays)
    return np.stack(columns, axis=-1)


def moved_axis(point_mm: Array, direction: Array, change: Array) -> tuple[Array, Array]:
    """Tilt an axis by two angles (rad) and shift it by two lengths (mm), all across it."""
    direction = direction / np.linalg.norm(direction)
    first = np.cross(direction, np.eye(3)[np.argmin(np.abs(direction))])
    first /= np.linalg.norm(first)
    second = np.cross(direction, first)
    tilted = direction + change[0] * first + change[1] * second
    return (
        point_mm + change[2] * first + change[3] * second,
        tilted / np.linalg.norm(tilted),
    )
