"""Poses of many views refined together by robust least squares, with all that the views share.

Boards tell a lens's middle and the camera's orientation apart only so well, while views of one
canvas from all sides, taken with one lens, tell them well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.reflectance.reprojection import CAUCHY, Known, Problem, State, View

Array = NDArray[np.float64]

_STEPS = 40
_TRIES = 8
_SETTLED = 1e-7


@dataclass(frozen=True)
class Refined:
    """Result of :func:`refine`.

    Parameters
    ----------
    state
        As found.
    covariance
        Of all parameters: per view a turn (rad) and a shift (mm) in the camera's frame, then the
        axis, then the lenses in their names' order. From the scatter between tiles of the images
        (sandwich form, Liang and Zeger 1986), for neighbours err alike.
    residuals_px
        (N, 2) per view: projected minus seen.
    weights
        (N,) per view, 0 to 1: how far each point was believed.
    widths
        By view: the residuals' robust deviation relative to ``sigma_px``.
    cost
        Robust sum in units of variance; compare it only between equal ``widths``.
    """

    state: State
    covariance: Array
    residuals_px: tuple[Array, ...]
    weights: tuple[Array, ...]
    widths: tuple[float, ...]
    cost: float


def refine(
    views: Sequence[View],
    start: State,
    known: Known | None = None,
    *,
    widths: Sequence[float] | None = None,
) -> Refined:
    """Find the poses, lenses and axis of least robust reprojection error.

    Levenberg-Marquardt with analytic derivatives on Cauchy's loss, its width the residuals' own:
    the median of their size in units of ``sigma_px``, found anew as the fit improves.

    Parameters
    ----------
    views, start
        One pose per view.
    known
        What may move besides the poses, and how far.
    widths
        Fix the loss's widths.
    """
    problem = Problem(views, start, known or Known())
    state, size = start, problem.size
    fixed = widths is not None
    scale = list(widths) if widths is not None else problem.widths(state)
    damping, cost = 1e-4, problem.cost(state, scale)
    for _ in range(_STEPS):
        hessian, slope, _ = problem.normal_equations(state, scale)
        for _ in range(_TRIES):
            step = -_solve(hessian, slope, damping)
            tried = problem.moved(state, step)
            tried_cost = problem.cost(tried, scale)
            if tried_cost <= cost:
                break
            damping *= 10
        else:
            break
        settled = cost - tried_cost <= _SETTLED * max(cost, 1.0)
        state, cost, damping = tried, tried_cost, max(damping / 10, 1e-12)
        if not fixed:
            found = problem.widths(state)
            settled = settled and np.allclose(found, scale, rtol=1e-3)
            scale, cost = found, problem.cost(state, found)
        if settled:
            break
    hessian, _, scatter = problem.normal_equations(state, scale)
    length = _lengths(hessian)
    inverse = np.linalg.pinv(hessian / np.outer(length, length), rcond=1e-14, hermitian=True)
    inverse /= np.outer(length, length)
    residuals = tuple(problem.residual(state, index) for index in range(len(views)))
    return Refined(
        state,
        (inverse @ (scatter + np.diag(problem.prior)) @ inverse).reshape(size, size),
        residuals,
        tuple(1 / (1 + problem.squares(i, r, scale) / CAUCHY**2) for i, r in enumerate(residuals)),
        tuple(scale),
        cost,
    )


def _lengths(hessian: Array) -> Array:
    """Return the Jacobian's column lengths: radians and millimetres differ by many powers of 10."""
    return np.sqrt(np.maximum(np.diag(hessian), np.finfo(np.float64).tiny))


def _solve(hessian: Array, slope: Array, damping: float) -> Array:
    """Solve the damped normal equations with columns scaled to length 1 (Marquardt 1963)."""
    length = _lengths(hessian)
    scaled = hessian / np.outer(length, length) + damping * np.eye(len(length))
    return np.asarray(np.linalg.lstsq(scaled, slope / length, rcond=1e-15)[0] / length)
