"""The pinhole camera with Brown-Conrady distortion, OpenCV's conventions; projectors are the same.

x right, y down, z forward; pixel (0, 0) is the centre of the top-left pixel.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.rigid import RigidTransform

Array = NDArray[np.float64]
_NEWTON_STEPS = 8


@dataclass(frozen=True)
class Lens:
    """Intrinsics: what a camera sees in its own frame.

    Parameters
    ----------
    size_px
        (width, height).
    K
        (3, 3) camera matrix, px.
    distortion
        (5,) k1, k2, p1, p2, k3 (Brown 1971).
    """

    size_px: tuple[int, int]
    K: Array
    distortion: Array = field(default_factory=lambda: np.zeros(5))

    def project(self, points_mm: NDArray[np.floating]) -> Array:
        """Project points (..., 3) of the camera's frame to pixels (..., 2); z must be positive."""
        normalised = points_mm[..., :2] / points_mm[..., 2:3]
        return self._to_pixels(distort(normalised, self.distortion))

    def directions(self, pixels: NDArray[np.floating]) -> Array:
        """Return the ray directions (..., 3), scaled to z = 1, of pixels (..., 2)."""
        pixels = np.asarray(pixels, dtype=np.float64)
        y = (pixels[..., 1] - self.K[1, 2]) / self.K[1, 1]
        x = (pixels[..., 0] - self.K[0, 2] - self.K[0, 1] * y) / self.K[0, 0]
        normalised = undistort(np.stack([x, y], axis=-1), self.distortion)
        return np.concatenate([normalised, np.ones_like(normalised[..., :1])], axis=-1)

    def pixel_grid(self) -> Array:
        """Return the centres of all pixels, (height, width, 2) as x, y."""
        width, height = self.size_px
        x, y = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
        return np.stack([x, y], axis=-1)

    def _to_pixels(self, distorted: Array) -> Array:
        x = self.K[0, 0] * distorted[..., 0] + self.K[0, 1] * distorted[..., 1] + self.K[0, 2]
        y = self.K[1, 1] * distorted[..., 1] + self.K[1, 2]
        return np.stack([x, y], axis=-1)


@dataclass(frozen=True)
class Camera:
    """A lens with its pose; ``pose`` takes the scene's frame to the camera's."""

    lens: Lens
    pose: RigidTransform = field(default_factory=RigidTransform)

    @property
    def centre_mm(self) -> Array:
        """The optical centre in the scene's frame, (3,)."""
        return self.pose.inverse().translation_mm

    def project(self, points_mm: NDArray[np.floating]) -> Array:
        """Project scene points (..., 3) to pixels (..., 2)."""
        return self.lens.project(self.pose.apply(points_mm))

    def depth(self, points_mm: NDArray[np.floating]) -> Array:
        """Return the camera-frame z (...,) of scene points (..., 3), mm."""
        return np.asarray(points_mm @ self.pose.rotation[2] + self.pose.translation_mm[2])

    def rays(self, pixels: NDArray[np.floating]) -> tuple[Array, Array]:
        """Return origin (3,) and directions (..., 3) in the scene's frame, camera z = 1."""
        return self.centre_mm, self.pose.inverse().rotate(self.lens.directions(pixels))


def distort(normalised: NDArray[np.floating], distortion: NDArray[np.floating]) -> Array:
    """Apply Brown-Conrady distortion to normalised coordinates (..., 2)."""
    k1, k2, p1, p2, k3 = distortion
    x, y = normalised[..., 0], normalised[..., 1]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    xy2 = 2 * x * y
    return np.stack(
        [
            x * radial + p1 * xy2 + p2 * (r2 + 2 * x * x),
            y * radial + p2 * xy2 + p1 * (r2 + 2 * y * y),
        ],
        axis=-1,
    )


def undistort(distorted: NDArray[np.floating], distortion: NDArray[np.floating]) -> Array:
    """Invert :func:`distort` by Newton's method with the analytic Jacobian.

    Coordinates outside the lens's invertible field come back as NaN, never as a wrong value.
    """
    target = np.asarray(distorted, dtype=np.float64)
    if not np.any(distortion):
        return target.copy()
    k1, k2, p1, p2, k3 = distortion
    point = target.copy()
    for _ in range(_NEWTON_STEPS):
        x, y = point[..., 0], point[..., 1]
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        slope = 2 * (k1 + r2 * (2 * k2 + 3 * r2 * k3))
        error = distort(point, distortion) - target
        a = radial + slope * x * x + 2 * p1 * y + 6 * p2 * x
        b = slope * x * y + 2 * p1 * x + 2 * p2 * y
        d = radial + slope * y * y + 2 * p2 * x + 6 * p1 * y
        with np.errstate(all="ignore"):
            determinant = a * d - b * b
            step_x = (d * error[..., 0] - b * error[..., 1]) / determinant
            step_y = (a * error[..., 1] - b * error[..., 0]) / determinant
            point = point - np.stack([step_x, step_y], axis=-1)
        if np.nanmax(np.abs(error), initial=0.0) < 1e-14:
            break
    with np.errstate(all="ignore"):
        residual = np.abs(distort(point, distortion) - target).max(axis=-1)
    point[~(residual < 1e-9)] = np.nan
    return point
