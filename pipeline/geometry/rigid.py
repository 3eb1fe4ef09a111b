"""Rigid transforms between right-handed frames in mm."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RigidTransform:
    """``x_to = rotation @ x_from + translation_mm``.

    Parameters
    ----------
    rotation
        (3, 3) orthonormal, determinant +1.
    translation_mm
        (3,) in mm.
    """

    rotation: Array = field(default_factory=lambda: np.eye(3))
    translation_mm: Array = field(default_factory=lambda: np.zeros(3))

    def apply(self, points_mm: NDArray[np.floating]) -> Array:
        """Transform points of shape (..., 3)."""
        return self.rotate(points_mm) + self.translation_mm

    def rotate(self, directions: NDArray[np.floating]) -> Array:
        """Rotate directions of shape (..., 3)."""
        # Not a matrix product: BLAS spreads these thin ones over threads, and is ten times slower.
        return np.asarray(np.einsum("...j,ij->...i", directions, self.rotation))

    def inverse(self) -> RigidTransform:
        """Return the transform that undoes this one."""
        return RigidTransform(self.rotation.T, -self.rotation.T @ self.translation_mm)

    def __matmul__(self, other: RigidTransform) -> RigidTransform:
        """Compose: ``(a @ b).apply(x) == a.apply(b.apply(x))``."""
        return RigidTransform(
            self.rotation @ other.rotation,
            self.rotation @ other.translation_mm + self.translation_mm,
        )

    @property
    def matrix(self) -> Array:
        """The (4, 4) homogeneous matrix."""
        matrix = np.eye(4)
        matrix[:3, :3] = self.rotation
        matrix[:3, 3] = self.translation_mm
        return matrix

    @classmethod
    def from_matrix(cls, matrix: NDArray[np.floating]) -> RigidTransform:
        """Take the rotation and translation of a (4, 4) homogeneous matrix."""
        homogeneous = np.array(matrix, dtype=np.float64)
        return cls(homogeneous[:3, :3], homogeneous[:3, 3])


def rotation_about_axis(
    axis_point_mm: NDArray[np.floating], axis_direction: NDArray[np.floating], angle_deg: float
) -> RigidTransform:
    """Turn counter-clockwise seen from the tip of ``axis_direction`` (Rodrigues 1840)."""
    axis = np.asarray(axis_direction, dtype=np.float64)
    axis = axis / np.linalg.norm(axis)
    point = np.asarray(axis_point_mm, dtype=np.float64)
    angle = np.deg2rad(angle_deg)
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    rotation = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return RigidTransform(rotation, point - rotation @ point)


def align_rigidly(
    source_mm: NDArray[np.floating],
    target_mm: NDArray[np.floating],
    weights: NDArray[np.floating] | None = None,
) -> RigidTransform:
    """Find the rigid transform that brings matched points together in least squares.

    Parameters
    ----------
    source_mm, target_mm
        (N, 3) matched points, N >= 3 and not on one line.
    weights
        (N,) non-negative; equal if left out.

    Source: Kabsch (1976), with the reflection removed as in Umeyama (1991).
    """
    source = np.asarray(source_mm, dtype=np.float64)
    target = np.asarray(target_mm, dtype=np.float64)
    w = np.ones(len(source)) if weights is None else np.asarray(weights, dtype=np.float64)
    w = w / w.sum()
    source_mean, target_mean = w @ source, w @ target
    covariance = (target - target_mean).T @ (w[:, None] * (source - source_mean))
    u, _, vt = np.linalg.svd(covariance)
    u = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = u @ vt
    return RigidTransform(rotation, target_mean - rotation @ source_mean)
