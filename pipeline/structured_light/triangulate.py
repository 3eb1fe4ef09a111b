"""Camera rays met with the projector's coordinates: one depth per pixel, and how sure it is."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from pipeline.errors import ImpastoError
from pipeline.geometry.camera import Camera
from pipeline.structured_light.coordinates import ProjectorCoordinates

Image = NDArray[np.float32]

SMALLEST_ANGLE = math.radians(0.5)
"""A ray that crosses the coded lines more flatly than this says nothing of depth."""

_NEWTON_STEPS = 12


@dataclass(frozen=True)
class Triangulation:
    """Points along the camera's rays; (rows, columns), NaN where not determined.

    Parameters
    ----------
    points_mm
        (rows, columns, 3) float32 in the scan's frame.
    depth_mm
        float64 z in the camera's frame.
    sigma_mm
        Standard deviation of the point's position along its ray.
    across_px
        Projector coordinate measured minus expected, across the epipolar line; NaN where one axis
        alone was decoded. It is no depth: it is error.
    across
        (rows, columns, 2) the unit vector that ``across_px`` is measured along, projector px.
    """

    points_mm: Image
    depth_mm: NDArray[np.float64]
    sigma_mm: Image
    across_px: Image
    across: Image


def triangulate(
    coordinates: ProjectorCoordinates, camera: Camera, projector: Camera
) -> Triangulation:
    """Find for every pixel the depth at which its ray passes the measured projector coordinates.

    Both axes are weighted by their variances (Hartley and Sturm 1997, one unknown): the closed form
    without distortion starts Gauss-Newton steps with it.

    Raises
    ------
    ImpastoError
        The only coded axis lies along the baseline, so that no depth follows from it; or the images
        are not of the camera's size.
    """
    relative = projector.pose @ camera.pose.inverse()
    to_scan = camera.pose.inverse()
    width, height = camera.lens.size_px
    missing = np.full((height, width), np.nan, np.float32)
    axes = [
        missing if image is None else image
        for image in (coordinates.x, coordinates.y, coordinates.sigma_x, coordinates.sigma_y)
    ]
    if any(image.shape != (height, width) for image in axes):
        raise ImpastoError(
            f"the frames are {axes[0].shape[1]} x {axes[0].shape[0]} px",
            expected=f"{width} x {height} px, as the calibrated camera",
        )
    points = np.full((height, width, 3), np.nan, np.float32)
    depth = np.full((height, width), np.nan)
    sigma, residual = missing.copy(), missing.copy()
    across = np.full((height, width, 2), np.nan, np.float32)
    flat = np.zeros(height, np.int64)
    _depths(
        *axes,
        np.ascontiguousarray(camera.lens.K),
        camera.lens.distortion,
        np.ascontiguousarray(relative.rotation),
        relative.translation_mm,
        np.ascontiguousarray(projector.lens.K),
        projector.lens.distortion,
        np.ascontiguousarray(to_scan.rotation),
        to_scan.translation_mm,
        math.tan(SMALLEST_ANGLE),
        points,
        depth,
        sigma,
        residual,
        across,
        flat,
    )
    if flat.any() and not np.isfinite(depth).any():
        axis = "x" if coordinates.y is None else "y"
        raise ImpastoError(
            f"the only coded axis, {axis}, lies along the baseline of camera and projector",
            expected="patterns along the other axis",
            fix="turn the patterns by 90 degrees, or code both axes",
        )
    return Triangulation(points, depth, sigma, residual, across)


@njit(cache=True)
def _bend(a, b, distortion):  # type: ignore[no-untyped-def]
    """Distort (Brown 1971); return the result and its symmetric Jacobian."""
    k1, k2, p1, p2, k3 = distortion
    r2 = a * a + b * b
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2 * (k1 + r2 * (2 * k2 + 3 * r2 * k3))
    bent_a = a * radial + 2 * p1 * a * b + p2 * (r2 + 2 * a * a)
    bent_b = b * radial + 2 * p2 * a * b + p1 * (r2 + 2 * b * b)
    aa = radial + slope * a * a + 2 * p1 * b + 6 * p2 * a
    ab = slope * a * b + 2 * p1 * a + 2 * p2 * b
    bb = radial + slope * b * b + 2 * p2 * a + 6 * p1 * b
    return bent_a, bent_b, aa, ab, bb


@njit(cache=True)
def _direction(column, row, K, distortion):  # type: ignore[no-untyped-def]
    """Return the normalised direction of a pixel, NaN outside the lens's invertible field."""
    target_b = (row - K[1, 2]) / K[1, 1]
    target_a = (column - K[0, 2] - K[0, 1] * target_b) / K[0, 0]
    a, b = target_a, target_b
    for _ in range(_NEWTON_STEPS):
        bent_a, bent_b, aa, ab, bb = _bend(a, b, distortion)
        off_a, off_b = target_a - bent_a, target_b - bent_b
        if abs(off_a) + abs(off_b) < 1e-13:
            return a, b
        determinant = aa * bb - ab * ab
        if not determinant > 0.0:
            break
        a += (bb * off_a - ab * off_b) / determinant
        b += (aa * off_b - ab * off_a) / determinant
    return np.nan, np.nan


@njit(cache=True)
def _project(x, y, z, K, distortion):  # type: ignore[no-untyped-def]
    """Project; return u, v, their derivatives by the normalised coordinates, and those."""
    a, b = x / z, y / z
    bent_a, bent_b, aa, ab, bb = _bend(a, b, distortion)
    u = K[0, 0] * bent_a + K[0, 1] * bent_b + K[0, 2]
    v = K[1, 1] * bent_b + K[1, 2]
    u_a, u_b = K[0, 0] * aa + K[0, 1] * ab, K[0, 0] * ab + K[0, 1] * bb
    return u, v, u_a, u_b, K[1, 1] * ab, K[1, 1] * bb, a, b


@njit(cache=True, parallel=True)
def _depths(  # type: ignore[no-untyped-def]
    x,
    y,
    sigma_x,
    sigma_y,
    camera_K,
    camera_distortion,
    R,
    t,
    K,
    distortion,
    back_R,
    back_t,
    smallest,
    points,
    depth,
    sigma,
    residual,
    across,
    flat,
):
    rows, columns = x.shape
    focal = 0.5 * (K[0, 0] + K[1, 1])
    for row in prange(rows):
        for column in range(columns):
            weight_x = weight_y = 0.0
            if math.isfinite(x[row, column]) and sigma_x[row, column] > 0:
                weight_x = 1.0 / sigma_x[row, column] ** 2
            if math.isfinite(y[row, column]) and sigma_y[row, column] > 0:
                weight_y = 1.0 / sigma_y[row, column] ** 2
            if weight_x + weight_y == 0.0:
                continue
            d0, d1 = _direction(column, row, camera_K, camera_distortion)
            q0 = R[0, 0] * d0 + R[0, 1] * d1 + R[0, 2]
            q1 = R[1, 0] * d0 + R[1, 1] * d1 + R[1, 2]
            q2 = R[2, 0] * d0 + R[2, 1] * d1 + R[2, 2]
            # The epipolar line's direction, the same at all depths.
            line_a, line_b = q0 * t[2] - q2 * t[0], q1 * t[2] - q2 * t[1]
            seen_a = abs(line_a) if weight_x > 0 else 0.0
            seen_b = abs(line_b) if weight_y > 0 else 0.0
            if max(seen_a, seen_b) <= smallest * math.hypot(line_a, line_b):
                flat[row] += 1
                continue
            # Without distortion (q z + t) lies on a = constant: linear in z, weighted by axis.
            upper = lower = 0.0
            if weight_x > 0:
                a = (x[row, column] - K[0, 2]) / K[0, 0]
                e = q0 - a * q2
                upper -= weight_x * e * (t[0] - a * t[2])
                lower += weight_x * e * e
            if weight_y > 0:
                b = (y[row, column] - K[1, 2]) / K[1, 1]
                e = q1 - b * q2
                upper -= weight_y * e * (t[1] - b * t[2])
                lower += weight_y * e * e
            if not lower > 0.0:
                continue
            z = upper / lower
            settled = False
            information = off_x = off_y = along_x = along_y = 0.0
            for _ in range(_NEWTON_STEPS):
                if not (z > 0.0 and q2 * z + t[2] > 0.0):
                    break
                u, v, u_a, u_b, v_a, v_b, a, b = _project(
                    q0 * z + t[0], q1 * z + t[1], q2 * z + t[2], K, distortion
                )
                by_a, by_b = (q0 - a * q2) / (q2 * z + t[2]), (q1 - b * q2) / (q2 * z + t[2])
                along_x, along_y = u_a * by_a + u_b * by_b, v_a * by_a + v_b * by_b
                off_x = x[row, column] - u if weight_x > 0 else 0.0
                off_y = y[row, column] - v if weight_y > 0 else 0.0
                information = weight_x * along_x**2 + weight_y * along_y**2
                step = (weight_x * along_x * off_x + weight_y * along_y * off_y) / information
                z += step
                if abs(step) < 1e-10 * abs(z):
                    settled = True
                    break
            if not settled:
                continue
            length = math.sqrt(d0 * d0 + d1 * d1 + 1.0)
            seen_x = along_x if weight_x > 0 else 0.0
            seen_y = along_y if weight_y > 0 else 0.0
            # Projector px per relative change of depth, over the focal length: the ray's angle.
            if math.hypot(seen_x, seen_y) * z < smallest * focal:
                flat[row] += 1
                continue
            depth[row, column] = z
            for i in range(3):
                along = back_R[i, 0] * d0 + back_R[i, 1] * d1 + back_R[i, 2]
                points[row, column, i] = along * z + back_t[i]
            sigma[row, column] = length / math.sqrt(information)
            if weight_x > 0 and weight_y > 0:
                norm = math.hypot(along_x, along_y)
                across[row, column, 0], across[row, column, 1] = -along_y / norm, along_x / norm
                residual[row, column] = (along_x * off_y - along_y * off_x) / norm
