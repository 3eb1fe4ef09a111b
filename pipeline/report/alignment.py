"""Laying a measured surface over a true height field by a rigid motion alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from scipy.spatial.transform import Rotation

from pipeline.geometry.rigid import RigidTransform

Array = NDArray[np.float64]

_ITERATIONS = 30
_SETTLED_MM = 1e-5
_HUBER = 1.5
"""Residuals beyond this many standard deviations count linearly (Huber 1964)."""

_FAR = 8.0
"""Residuals beyond this many standard deviations do not count: they are not this surface."""


@dataclass(frozen=True)
class TrueSurface:
    """A height field on a regular grid in its own canvas frame.

    Parameters
    ----------
    x_mm, y_mm
        (columns,), (rows,) ascending and equally spaced.
    heights_mm
        (rows, columns); row 0 at the smallest y; NaN where there is no surface to compare with.
    """

    x_mm: Array
    y_mm: Array
    heights_mm: Array

    @property
    def spacing_mm(self) -> float:
        """Distance between neighbouring columns."""
        return float(self.x_mm[-1] - self.x_mm[0]) / (len(self.x_mm) - 1)

    def grid_position(self, points_mm: Array) -> tuple[Array, Array]:
        """Return the fractional rows and columns of points (..., 2 or 3)."""
        rows = (points_mm[..., 1] - self.y_mm[0]) / (self.y_mm[1] - self.y_mm[0])
        columns = (points_mm[..., 0] - self.x_mm[0]) / (self.x_mm[1] - self.x_mm[0])
        return rows, columns


def sample(image: Array, rows: Array, columns: Array) -> Array:
    """Interpolate bilinearly; NaN outside and next to NaN."""
    return np.asarray(
        map_coordinates(image, [rows, columns], order=1, mode="constant", cval=np.nan)
    )


def align(points_mm: Array, surface: TrueSurface, start: RigidTransform) -> RigidTransform:
    """Refine the rigid motion that brings measured points onto the surface.

    Each point is compared with the tangent plane of the surface above or below it, and the motion
    that makes the robustly weighted sum of squared distances least is found again and again.

    Parameters
    ----------
    points_mm
        (N, 3) measured points; those that fall outside the surface do not count.
    start
        The motion to start from; within a stroke's width of the right one.

    Raises
    ------
    ValueError
        Fewer than six points lie over the surface, or they leave a direction free.

    Source: point-to-plane ICP (Chen and Medioni 1992) with projective matching along z.
    """
    slope_y, slope_x = np.gradient(surface.heights_mm, surface.y_mm, surface.x_mm)
    layers = (surface.heights_mm, slope_x, slope_y)
    motion = start
    centre = start.apply(points_mm).mean(axis=0)
    for _ in range(_ITERATIONS):
        moved = motion.apply(points_mm)
        position = surface.grid_position(moved)
        height, gx, gy = (sample(np.asarray(layer), *position) for layer in layers)
        over = np.isfinite(height) & np.isfinite(gx) & np.isfinite(gy)
        if np.count_nonzero(over) < 6:
            raise ValueError("fewer than six points lie over the surface")
        normal = np.stack([-gx[over], -gy[over], np.ones(over.sum())], axis=1)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        residual = (moved[over, 2] - height[over]) * normal[:, 2]
        arm = moved[over] - centre
        jacobian = np.hstack([np.cross(arm, normal), normal])
        weight = _weights(residual)
        system = jacobian.T @ (weight[:, None] * jacobian)
        if np.linalg.matrix_rank(system, hermitian=True) < 6:
            raise ValueError("the points leave a direction of the motion free")
        step = np.linalg.solve(system, -jacobian.T @ (weight * residual))
        turn = Rotation.from_rotvec(step[:3]).as_matrix()
        motion = RigidTransform(turn, centre - turn @ centre + step[3:]) @ motion
        reach = float(np.linalg.norm(arm, axis=1).max())
        if np.linalg.norm(step[3:]) + np.linalg.norm(step[:3]) * reach < _SETTLED_MM:
            break
    return motion


def _weights(residual: Array) -> Array:
    """Return Huber's weights, 0 for what lies far off, by a robust standard deviation."""
    deviation = 1.4826 * float(np.median(np.abs(residual - np.median(residual))))
    size = np.abs(residual) / max(deviation, 1e-9)
    return np.asarray(np.where(size > _FAR, 0.0, _HUBER / np.maximum(size, _HUBER)))
