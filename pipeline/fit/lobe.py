"""One isotropic Lafortune lobe per texel, by variable projection.

The model, with v and l in the texel's own frame (Lafortune et al. 1997; McAllister et al. 2002):

    f = rho_d + rho_s b^k,   b = max(0, C_xy (v_x l_x + v_y l_y) + C_z v_z l_z)

rho_d and rho_s are linear and solved exactly (non-negative, per colour) inside each step; only
p = C_xy / C_z and log k are iterated, by Levenberg and Marquardt with the analytic Jacobian in
Kaufman's (1975) form. The scale freedom C -> aC, rho_s -> a^-k rho_s is removed by scaling the
bracket's largest value to 1, so that rho_s is the lobe's peak.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

STARTS = np.array(
    [(p, k) for p in (-0.8, -1.0, -1.25) for k in (3.0, 12.0, 50.0, 200.0)]
    + [(1.0, 5.0), (1.0, 40.0)]
)
"""(p, k): lobes at the mirror direction and to both sides of it, and two that throw light back."""

LARGEST_RATIO = 4.0
SMALLEST_K, LARGEST_K = 0.5, 1000.0
FEWEST_SAMPLES = 6
"""Eight parameters against three colours per sample, with some samples to spare."""

OBSERVED = 0.25
"""A lobe counts as observed if some sample reached this share of its peak."""

_ROUNDS, _STEPS = 3, 15
_SETTLED = 1e-5
"""Relative gain of a step below which a texel is left; its error is then far below its noise."""

_CAUCHY = 2.385
"""The Cauchy weight's constant: 95 % efficiency on normal errors (Holland and Welsch 1977)."""


_PROPORTIONAL = 0.02
"""Errors that grow with the value (lamps, registration); they keep highlights from being taken for
outliers where all else fits perfectly."""


def fit_lobes(
    brdf: NDArray[np.float32],
    points_mm: NDArray[np.float64],
    normals: NDArray[np.float32],
    view_mm: NDArray[np.float64],
    light_mm: NDArray[np.float64],
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.int32], NDArray[np.bool_]]:
    """Fit every texel.

    Parameters
    ----------
    brdf
        (photos, rows, columns, 3) samples; NaN where there is none.
    points_mm, normals
        (rows, columns, 3), canvas coordinates.
    view_mm, light_mm
        (photos, 3), canvas coordinates.

    Returns
    -------
    parameters
        (rows, columns, 9): rho_d (3), rho_s (3), C_xy, C_z, k; NaN without samples; rho_s = 0 and
        (0, 0, 1) where the texel is matte.
    residual
        (rows, columns) RMS of the robustly weighted residuals.
    count, observed
        (rows, columns) samples, and whether a highlight was seen.
    """
    return _fit_all(brdf, points_mm, normals, view_mm, light_mm, STARTS)  # type: ignore[no-any-return]


@njit(cache=True, parallel=True)
def _fit_all(brdf, points, normals, view, light, starts):  # type: ignore[no-untyped-def]
    photos, rows, columns, _ = brdf.shape
    parameters = np.full((rows, columns, 9), np.nan, np.float32)
    residual = np.full((rows, columns), np.nan, np.float32)
    count = np.zeros((rows, columns), np.int32)
    observed = np.zeros((rows, columns), np.bool_)
    for row in prange(rows):
        across, along = np.empty(photos), np.empty(photos)
        values, weights = np.empty((photos, 3)), np.empty(photos)
        for column in range(columns):
            n = _gather(
                brdf, points, normals, view, light, row, column, across, along, values, weights
            )
            count[row, column] = n
            if n > 0:
                result, rms, seen = fit_texel(
                    across[:n], along[:n], values[:n], weights[:n], starts
                )
                parameters[row, column] = result.astype(np.float32)
                residual[row, column] = rms
                observed[row, column] = seen
    return parameters, residual, count, observed


@njit(cache=True)
def _gather(brdf, points, normals, view, light, row, column, across, along, values, weights):  # type: ignore[no-untyped-def]
    """Collect a texel's samples: v_x l_x + v_y l_y, v_z l_z, RGB, and a weight of irradiance.

    The noise of f = L / E is shot noise over E, so its variance falls as 1 / E.
    """
    n = 0
    normal = normals[row, column]
    for photo in range(brdf.shape[0]):
        if not math.isfinite(brdf[photo, row, column, 0] + brdf[photo, row, column, 1]):
            continue
        if not math.isfinite(brdf[photo, row, column, 2]):
            continue
        vv = ll = vl = vn = ln = 0.0
        for axis in range(3):
            v = view[photo, axis] - points[row, column, axis]
            to_light = light[photo, axis] - points[row, column, axis]
            vv += v * v
            ll += to_light * to_light
            vl += v * to_light
            vn += v * normal[axis]
            ln += to_light * normal[axis]
        length = math.sqrt(vv * ll)
        along[n] = vn * ln / length
        across[n] = vl / length - along[n]
        weights[n] = ln / (ll * math.sqrt(ll)) * 1e6
        for channel in range(3):
            values[n, channel] = brdf[photo, row, column, channel]
        n += 1
    return n


@njit(cache=True)
def fit_texel(across, along, values, weights, starts):  # type: ignore[no-untyped-def]
    """Fit one texel; return its nine parameters, the RMS residual, and if the lobe was observed."""
    n = len(across)
    result = np.zeros(9)
    result[8] = 1.0
    unit = weights / weights.sum() * n
    nothing = np.zeros(n)
    matte, _ = _linear(nothing, values, unit)
    if n >= FEWEST_SAMPLES:
        p, log_k, robust = _robust_lobe(across, along, values, unit, starts)
        g, peak = _lobe(across, along, p, log_k)
        linear, cost = _linear(g, values, robust)
        matte, matte_cost = _linear(nothing, values, robust)
        observations = 3.0 * n
        # Bayesian information criterion (Schwarz 1978): five more parameters must pay their way.
        gain = observations * math.log(max(matte_cost, 1e-300) / max(cost, 1e-300))
        seen = g.max() >= OBSERVED
        if seen and gain > 5.0 * math.log(observations) and linear[3:].max() > 0.0:
            result[:6] = linear
            result[6], result[7], result[8] = p / peak, 1.0 / peak, math.exp(log_k)
            return result, math.sqrt(cost / (3.0 * robust.sum())), True
        result[:3] = matte[:3]
        return result, math.sqrt(matte_cost / (3.0 * robust.sum())), seen
    result[:3] = matte[:3]
    _, cost = _linear(nothing, values, unit)
    return result, math.sqrt(cost / (3.0 * n)), False


@njit(cache=True)
def _robust_lobe(across, along, values, unit, starts):  # type: ignore[no-untyped-def]
    """Iterate the lobe under Cauchy weights; shadow edges and interreflections are outliers."""
    costs = np.empty(len(starts))
    for start in range(len(starts)):
        g, _ = _lobe(across, along, starts[start, 0], math.log(starts[start, 1]))
        _, costs[start] = _linear(g, values, unit)
    best_p, best_log_k, best_cost = 0.0, 0.0, np.inf
    for _ in range(2):
        start = int(np.argmin(costs))
        costs[start] = np.inf
        p, log_k, cost = _levenberg(
            across, along, values, unit, starts[start, 0], math.log(starts[start, 1]), _STEPS
        )
        if cost < best_cost:
            best_p, best_log_k, best_cost = p, log_k, cost
    robust = unit.copy()
    for _ in range(_ROUNDS):
        g, _ = _lobe(across, along, best_p, best_log_k)
        linear, _ = _linear(g, values, robust)
        square, expected = np.zeros(len(g)), np.zeros(len(g))
        for i in range(len(g)):
            for channel in range(3):
                model = linear[channel] + linear[3 + channel] * g[i]
                square[i] += (values[i, channel] - model) ** 2 / 3.0
                expected[i] += (_PROPORTIONAL * model) ** 2 / 3.0
        common = 1.4826**2 * np.median(square * unit)
        for i in range(len(g)):
            variance = common / unit[i] + expected[i]
            if variance > 0.0:
                robust[i] = unit[i] / (1.0 + square[i] / (_CAUCHY**2 * variance))
        best_p, best_log_k, _ = _levenberg(
            across, along, values, robust, best_p, best_log_k, _STEPS
        )
    return best_p, best_log_k, robust


@njit(cache=True)
def _levenberg(across, along, values, weights, p, log_k, steps):  # type: ignore[no-untyped-def]
    g, peak = _lobe(across, along, p, log_k)
    linear, cost = _linear(g, values, weights)
    damping = 1e-2
    for _ in range(steps):
        a, b, c, ga, gb = _normal_equations(
            across, along, values, weights, p, log_k, g, peak, linear
        )
        if not a + b > 0.0:
            break
        improved = False
        for _ in range(6):
            da, db = a * (1.0 + damping) + 1e-300, b * (1.0 + damping) + 1e-300
            determinant = da * db - c * c
            if determinant > 0.0:
                step_p = (db * ga - c * gb) / determinant
                step_k = (da * gb - c * ga) / determinant
                new_p = min(max(p + step_p, -LARGEST_RATIO), LARGEST_RATIO)
                new_k = min(max(log_k + step_k, math.log(SMALLEST_K)), math.log(LARGEST_K))
                new_g, new_peak = _lobe(across, along, new_p, new_k)
                new_linear, new_cost = _linear(new_g, values, weights)
                if new_cost < cost:
                    improved = True
                    break
            damping *= 8.0
        if not improved:
            break
        settled = cost - new_cost <= _SETTLED * cost
        p, log_k, g, peak, linear, cost = new_p, new_k, new_g, new_peak, new_linear, new_cost
        damping = max(damping / 10.0, 1e-9)
        if settled:
            break
    return p, log_k, cost


@njit(cache=True)
def _lobe(across, along, p, log_k):  # type: ignore[no-untyped-def]
    """Return b^k with its peak scaled to 1, and the bracket's largest value before scaling."""
    peak, k = max(1.0, abs(p)), math.exp(log_k)
    g = np.zeros(len(across))
    for i in range(len(across)):
        base = (along[i] + p * across[i]) / peak
        if base > 0.0:
            g[i] = math.exp(k * math.log(base))
    return g, peak


@njit(cache=True)
def _linear(g, values, weights):  # type: ignore[no-untyped-def]
    """Solve rho_d, rho_s of each colour by non-negative least squares; return both and the cost."""
    linear, cost = np.zeros(6), 0.0
    total = weights.sum()
    wg, wgg = (weights * g).sum(), (weights * g * g).sum()
    determinant = total * wgg - wg * wg
    for channel in range(3):
        y = values[:, channel]
        wy, wgy = (weights * y).sum(), (weights * g * y).sum()
        diffuse, specular = max(wy / total, 0.0), 0.0
        if determinant > 1e-12 * total * wgg:
            specular = (total * wgy - wg * wy) / determinant
            diffuse = (wy - wg * specular) / total
            if specular < 0.0:
                diffuse, specular = max(wy / total, 0.0), 0.0
            elif diffuse < 0.0:
                diffuse, specular = 0.0, max(wgy / wgg, 0.0)
        linear[channel], linear[3 + channel] = diffuse, specular
        for i in range(len(g)):
            cost += weights[i] * (y[i] - diffuse - specular * g[i]) ** 2
    return linear, cost


@njit(cache=True)
def _normal_equations(across, along, values, weights, p, log_k, g, peak, linear):  # type: ignore[no-untyped-def]
    """Return the 2 x 2 normal matrix (a, b on its diagonal, c off it) and the descent direction.

    With D the derivatives of g, projected off the space of the linear parameters (1 and g):
    J^T J = sum of rho_s^2 times D^T P D, and -J^T r = sum of rho_s times D^T r.
    """
    k = math.exp(log_k)
    total, wg, wgg = 0.0, 0.0, 0.0
    w_p, w_k, wg_p, wg_k, pp, kk, pk = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    ga, gb, power = 0.0, 0.0, 0.0
    for i in range(len(g)):
        w = weights[i]
        total += w
        if g[i] <= 0.0:
            continue
        base = (along[i] + p * across[i]) / peak
        by_p = k * g[i] * across[i] / (base * peak)
        by_k = k * g[i] * math.log(base)
        wg += w * g[i]
        wgg += w * g[i] * g[i]
        w_p += w * by_p
        w_k += w * by_k
        wg_p += w * g[i] * by_p
        wg_k += w * g[i] * by_k
        pp += w * by_p * by_p
        kk += w * by_k * by_k
        pk += w * by_p * by_k
        for channel in range(3):
            rest = values[i, channel] - linear[channel] - linear[3 + channel] * g[i]
            ga += w * linear[3 + channel] * rest * by_p
            gb += w * linear[3 + channel] * rest * by_k
    for channel in range(3):
        power += linear[3 + channel] ** 2
    determinant = total * wgg - wg * wg
    if determinant > 1e-12 * total * wgg:
        pp -= (wgg * w_p * w_p - 2.0 * wg * w_p * wg_p + total * wg_p * wg_p) / determinant
        kk -= (wgg * w_k * w_k - 2.0 * wg * w_k * wg_k + total * wg_k * wg_k) / determinant
        pk -= (wgg * w_p * w_k - wg * (w_p * wg_k + w_k * wg_p) + total * wg_p * wg_k) / determinant
    return power * max(pp, 0.0), power * max(kk, 0.0), power * pk, ga, gb
