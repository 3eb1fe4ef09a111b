"""The canvas plane: robust principal components, and axes that do not depend on luck."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import ImpastoError
from pipeline.geometry.camera import Camera
from pipeline.geometry.rigid import RigidTransform

Array = NDArray[np.float64]

_HUBER, _TUKEY = 1.345, 4.685  # 95 % efficient on normal residuals
_MAD_TO_SIGMA = 1.4826
_ITERATIONS = 30
_MOST_POINTS = 50_000
_FLATTEST = 1e-6  # below this ratio of spreads points lie on a line


@dataclass(frozen=True)
class Plane:
    """A plane through ``centre_mm`` (3,) with the unit ``normal`` (3,)."""

    centre_mm: Array
    normal: Array

    def heights(self, points_mm: NDArray[np.floating]) -> Array:
        """Return the signed distances (...,) of points (..., 3), mm."""
        return np.asarray((points_mm - self.centre_mm) @ self.normal)


def fit_plane(points_mm: NDArray[np.floating], weights: NDArray[np.floating]) -> Plane:
    """Fit a plane by principal components, reweighted so that high relief pulls little.

    Parameters
    ----------
    points_mm
        (N, 3), finite.
    weights
        (N,) >= 0, of the points apart from their residuals.

    Returns
    -------
    Plane
        The normal's sign is arbitrary; see :func:`facing`.

    Raises
    ------
    ImpastoError
        If fewer than three points have weight, or they lie on one line.

    Notes
    -----
    Iteratively reweighted total least squares on a scale from the median absolute residual (Huber
    1981, *Robust Statistics*, ch. 7). Huber's weights, which lead to one plane from anywhere, come
    first; Tukey's biweight goes on from there and gives up what stands far off. The scale of a deep
    relief is the relief's own, so that it gets its mean plane and not one of its facets.
    """
    used = np.flatnonzero(weights > 0)
    used = used[:: 1 + len(used) // _MOST_POINTS]
    if len(used) < 3:
        raise _too_few(len(used))
    points = np.asarray(points_mm[used], dtype=np.float64)
    prior = np.asarray(weights[used], dtype=np.float64)
    offset = points.mean(axis=0)
    points = points - offset
    plane = _principal_plane(points, prior)
    for loss in (_huber, _tukey):
        plane = _reweight(plane, points, prior, loss)
    return Plane(plane.centre_mm + offset, plane.normal)


def facing(plane: Plane, towards_mm: Array) -> Plane:
    """Turn the normal to the side of the point ``towards_mm`` (3,): out of the paint."""
    side = (towards_mm - plane.centre_mm) @ plane.normal
    return plane if side >= 0 else Plane(plane.centre_mm, -plane.normal)


def canvas_axes(plane: Plane, camera: Camera) -> RigidTransform:
    """Lay x, y, z on the plane: z along its normal, y as near to the picture's up as can be.

    Returns
    -------
    RigidTransform
        Scene from canvas, origin at the plane's centre; only a plane seen exactly edge-on from
        above or below has no such y, and then x takes the picture's right.
    """
    z = plane.normal
    right, down = camera.pose.rotation[0], camera.pose.rotation[1]
    y = -down + (down @ z) * z
    if np.linalg.norm(y) < 1e-3:
        x = right - (right @ z) * z
        y = np.cross(z, x)
    y = y / np.linalg.norm(y)
    return RigidTransform(np.stack([np.cross(y, z), y, z], axis=1), plane.centre_mm)


def _reweight(plane: Plane, points: Array, prior: Array, loss: Callable[[Array], Array]) -> Plane:
    size = float(np.abs(points).max())
    for _ in range(_ITERATIONS):
        residual = np.abs(plane.heights(points))
        scale = _MAD_TO_SIGMA * _weighted_median(residual, prior)
        if scale <= 1e-9 * size:
            break
        previous = plane
        plane = _principal_plane(points, prior * loss(residual / scale))
        turned = np.linalg.norm(np.cross(previous.normal, plane.normal))
        shifted = abs((plane.centre_mm - previous.centre_mm) @ plane.normal)
        if turned < 1e-7 and shifted < 1e-5 * scale:
            break
    return plane


def _huber(residual: Array) -> Array:
    return _HUBER / np.maximum(residual, _HUBER)


def _tukey(residual: Array) -> Array:
    return np.maximum(1 - (residual / _TUKEY) ** 2, 0) ** 2


def _principal_plane(points: Array, weights: Array) -> Plane:
    total = weights.sum()
    centre = weights @ points / total
    centred = points - centre
    spread, axes = np.linalg.eigh(centred.T @ (weights[:, None] * centred) / total)
    if not spread[1] > _FLATTEST**2 * spread[2]:
        raise ImpastoError(
            "the points lie on one line",
            where="scan/range.exr",
            expected="a surface",
            fix="look at the range map: impasto report",
        )
    return Plane(centre, axes[:, 0])


def _weighted_median(values: Array, weights: Array) -> float:
    order = np.argsort(values, kind="stable")
    cumulated = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(cumulated, 0.5 * cumulated[-1])]])


def _too_few(count: int) -> ImpastoError:
    return ImpastoError(
        f"only {count} points were measured near the middle of the picture",
        where="scan/range.exr",
        expected="the object in the middle of the scan camera's picture",
        fix="aim the camera at it, and look at the exposures",
    )
