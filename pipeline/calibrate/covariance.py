"""How well an adjustment knows its parameters."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ViewBlock = tuple[Array, Array, Array]
"""One view's rows: derivatives by the shared parameters, by its own pose, and the residuals."""


def joint_covariance(jacobian: Array) -> tuple[Array, float]:
    """Return the covariance of all parameters for residuals of unit variance, and the condition.

    The condition is that of the Jacobian with columns scaled to length 1; infinite where a
    parameter changes nothing.
    """
    scale = np.linalg.norm(jacobian, axis=0)
    if not scale.all():
        return np.full((len(scale), len(scale)), np.inf), np.inf
    _, singular, rotation = np.linalg.svd(jacobian / scale, full_matrices=False)
    if not singular[-1] > 0:
        return np.full((len(scale), len(scale)), np.inf), np.inf
    covariance = (rotation.T / singular**2) @ rotation / np.outer(scale, scale)
    return np.asarray(covariance), float(singular[0] / singular[-1])


def jackknife_variance(views: Sequence[ViewBlock]) -> Array:
    """Return the shared parameters' variances from leaving out each view in turn.

    Corners of one view err together (blur, a bent board), which the residuals' spread alone does
    not tell. Linearised about the result (Efron 1982), each view's own pose eliminated (Triggs et
    al. 2000). Zero for fewer than three views.
    """
    shared = views[0][0].shape[1] if views else 0
    if len(views) < 3 or not shared:
        return np.zeros(shared)
    reduced, pulls = [], []
    for devices, own, residual in views:
        basis = np.linalg.qr(own)[0]
        free = devices - basis @ (basis.T @ devices)
        reduced.append(free.T @ free)
        pulls.append(free.T @ residual)
    total = np.sum(reduced, axis=0)
    # Without a view that alone tells a parameter, the others leave it where it was.
    moved = [
        np.linalg.pinv(total - own_part, hermitian=True) @ pull
        for own_part, pull in zip(reduced, pulls, strict=True)
    ]
    return np.asarray((len(views) - 1) * np.var(moved, axis=0))


def correlation(covariance: Array) -> Array:
    """Return the matrix of correlations, -1 to 1."""
    deviation = np.sqrt(np.diag(covariance))
    return np.asarray(np.clip(covariance / np.outer(deviation, deviation), -1, 1))
