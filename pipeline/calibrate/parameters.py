"""Lenses and poses as vectors of parameters, and back."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.camera import Lens
from pipeline.geometry.rigid import RigidTransform

Array = NDArray[np.float64]

LENS_PARAMETERS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
POSE_PARAMETERS = ("r_x", "r_y", "r_z", "t_x", "t_y", "t_z")


def lens_vector(lens: Lens) -> Array:
    """Return a lens's nine parameters in the order of LENS_PARAMETERS."""
    K = lens.K
    return np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2], *lens.distortion])


def vector_lens(vector: Array, size_px: tuple[int, int]) -> Lens:
    """Invert :func:`lens_vector`."""
    fx, fy, cx, cy = vector[:4]
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
    return Lens(size_px, K, np.array(vector[4:9]))


def pose_vector(pose: RigidTransform) -> Array:
    """Return a pose as rotation vector and translation, (6,)."""
    return np.concatenate([cv2.Rodrigues(pose.rotation)[0].ravel(), pose.translation_mm])


def vector_pose(vector: Array) -> RigidTransform:
    """Invert :func:`pose_vector`."""
    return RigidTransform(cv2.Rodrigues(np.array(vector[:3]))[0], np.array(vector[3:]))
