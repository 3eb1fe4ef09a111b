"""The derivatives of a lens's projection, by the point and by the lens."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.camera import Lens, distort

Array = NDArray[np.float64]

LENS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2")
"""Parameters of a lens, in the order of its derivative."""


def point_derivative(lens: Lens, points_mm: Array) -> Array:
    """Return d(pixel)/d(point of the camera's frame), (N, 2, 3)."""
    k1, k2, p1, p2, k3 = lens.distortion
    inverse = 1 / points_mm[:, 2]
    x, y = points_mm[:, 0] * inverse, points_mm[:, 1] * inverse
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2 * (k1 + r2 * (2 * k2 + 3 * r2 * k3))
    a = radial + slope * x * x + 2 * p1 * y + 6 * p2 * x
    b = slope * x * y + 2 * p1 * x + 2 * p2 * y
    d = radial + slope * y * y + 2 * p2 * x + 6 * p1 * y
    lensed = np.stack([a, b, b, d], axis=1).reshape(-1, 2, 2)
    zero = np.zeros_like(x)
    pinhole = np.stack([inverse, zero, -x * inverse, zero, inverse, -y * inverse], axis=1)
    return np.asarray(lens.K[:2, :2] @ lensed @ pinhole.reshape(-1, 2, 3))


def lens_derivative(lens: Lens, points_mm: Array) -> Array:
    """Return d(pixel)/d(parameter of LENS), (N, 2, 8), of points (N, 3) of the camera's frame."""
    normalised = points_mm[:, :2] / points_mm[:, 2:]
    x, y = normalised.T
    r2 = x * x + y * y
    seen = distort(normalised, lens.distortion)
    one, zero = np.ones_like(x), np.zeros_like(x)
    of_x = np.stack([x * r2, x * r2 * r2, 2 * x * y, r2 + 2 * x * x], axis=1)
    of_y = np.stack([y * r2, y * r2 * r2, r2 + 2 * y * y, 2 * x * y], axis=1)
    column = np.stack([seen[:, 0], zero, one, zero], axis=1)
    row = np.stack([zero, seen[:, 1], zero, one], axis=1)
    return np.stack(
        [
            np.hstack([column, lens.K[0, 0] * of_x + lens.K[0, 1] * of_y]),
            np.hstack([row, lens.K[1, 1] * of_y]),
        ],
        axis=1,
    )


def changed(lens: Lens, change: Array) -> Lens:
    """Add to a lens's parameters, in the order of LENS."""
    K, distortion = lens.K.copy(), lens.distortion.copy()
    K[0, 0] += change[0]
    K[1, 1] += change[1]
    K[:2, 2] += change[2:4]
    distortion[:4] += change[4:8]
    return Lens(lens.size_px, K, distortion)
