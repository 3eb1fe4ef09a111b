"""Phase steps of one period, at any exposures, solved per pixel by weighted least squares."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from pipeline.structured_light.noise import SATURATED, NoiseModel

Image = NDArray[np.float32]

_BLOCK = 128


@dataclass(frozen=True)
class Fringes:
    """offset + amplitude cos(phase + shift); (rows, columns) float32, NaN where undetermined.

    Parameters
    ----------
    phase, sigma
        Radians in (-pi, pi], and their standard deviation.
    amplitude, offset
        Light per second of exposure.
    chi2
        Reduced sum of squared residuals; NaN where no step is redundant.
    share_dropped
        Share of all steps that were left out because they are saturated.
    """

    phase: Image
    sigma: Image
    amplitude: Image
    offset: Image
    chi2: Image
    share_dropped: float = 0.0


def solve_fringes(
    stack: NDArray[np.number],
    basis: NDArray[np.float64],
    light: NDArray[np.float64],
    full_scale: float,
    noise: NoiseModel,
) -> Fringes:
    """Solve every pixel from the steps that are not saturated there, three or more.

    Parameters
    ----------
    stack
        (frames, rows, columns) stored values.
    basis
        (frames, 3) what each frame shows of offset, cosine and sine: (1, cos, -sin) of its shift
        where nothing drifts.
    light
        (frames,) exposure times; one dim long exposure and one bright short one weigh in by their
        noise.
    full_scale
        The stored value that means 1.
    """
    found = np.full((5, *stack.shape[1:]), np.nan, np.float32)
    kept = np.zeros(stack.shape[1], np.int64)
    _solve(stack, basis, light, 1 / full_scale, SATURATED, noise.shot, noise.floor, found, kept)
    phase, sigma, amplitude, offset, chi2 = found
    dropped = 1 - int(kept.sum()) / max(stack.size, 1)
    return Fringes(phase, sigma, amplitude, offset, chi2, dropped)


# The kernels fill arrays that are made outside: what numba parallelises is their loop alone. Pixels
# go in blocks, each step over a whole block at a time, which LLVM turns into vector instructions.
@njit(cache=True, parallel=True)
def _solve(stack, basis, light, unit, saturated, shot, floor, found, kept):  # type: ignore[no-untyped-def]
    frames, rows, columns = stack.shape
    for row in prange(rows):
        values = np.empty((frames, _BLOCK))
        use = np.empty((frames, _BLOCK))
        sums = np.empty((15, _BLOCK))
        state = np.empty((5, _BLOCK))
        for first in range(0, columns, _BLOCK):
            size = min(_BLOCK, columns - first)
            kept[row] += _gather(
                stack, row, first, size, basis, light, unit, saturated, values, use, sums, state
            )
            for _ in range(2):
                _weigh(size, values, use, basis, light, shot, floor, sums, state)
                _step(size, sums, state)
            _finish(row, first, size, values, use, basis, light, shot, floor, sums, state, found)


@njit(cache=True)
def _gather(stack, row, first, size, basis, light, unit, saturated, values, use, sums, state):  # type: ignore[no-untyped-def]
    """Read a block; start from its mean light. State: mean, c, s, number of steps, going on."""
    state[:] = 0.0
    sums[0, :] = 0.0
    level, steps, seconds = state[0], state[3], sums[0]
    total = 0
    for f in range(len(light)):
        time = light[f] * basis[f, 0]
        stored, value, lit = stack[f, row, first : first + size], values[f], use[f]
        for j in range(size):
            value[j] = stored[j] * unit
        for j in range(size):
            lit[j] = 1.0 if value[j] < saturated else 0.0
        for j in range(size):
            level[j] += lit[j] * value[j]
            seconds[j] += lit[j] * time
            steps[j] += lit[j]
    for j in range(size):
        total += int(steps[j])
        enough = steps[j] >= 3.0
        state[4, j] = 1.0 if enough else 0.0
        level[j] = level[j] / seconds[j] if enough else 0.0
    return total


@njit(cache=True)
def _weigh(size, values, use, basis, light, shot, floor, sums, state):  # type: ignore[no-untyped-def]
    """Sum the normal equations: m00 m01 m02 m11 m12 m22 b0 b1 b2.

    The noise follows the light, first its mean, then what the first solution says. The noisy value
    itself would favour the steps that happen to be low.
    """
    sums[:9] = 0.0
    mean, cosine, sine = state[0], state[1], state[2]
    weight, pull = sums[13], sums[14]
    for f in range(len(light)):
        t, c0, c1, c2 = light[f], basis[f, 0], basis[f, 1], basis[f, 2]
        value, lit = values[f], use[f]
        for j in range(size):
            seen = t * (mean[j] * c0 + cosine[j] * c1 + sine[j] * c2)
            weight[j] = lit[j] * t / (shot * (seen if seen > 0.0 else 0.0) + floor)
        for j in range(size):
            pull[j] = weight[j] * value[j]
        for k, factor in ((6, c0), (7, c1), (8, c2)):
            of = sums[k]
            for j in range(size):
                of[j] += pull[j] * factor
        for k, factor in (
            (0, t * c0 * c0), (1, t * c0 * c1), (2, t * c0 * c2),
            (3, t * c1 * c1), (4, t * c1 * c2), (5, t * c2 * c2),
        ):  # fmt: skip
            of = sums[k]
            for j in range(size):
                of[j] += weight[j] * factor


@njit(cache=True)
def _step(size, sums, state):  # type: ignore[no-untyped-def]
    """Solve the normal equations by cofactors, where they can be; keep k11, k12, k22 and det."""
    for j in range(size):
        if state[4, j] != 1.0:
            continue
        m00, m01, m02 = sums[0, j], sums[1, j], sums[2, j]
        m11, m12, m22 = sums[3, j], sums[4, j], sums[5, j]
        k00, k01, k02 = m11 * m22 - m12 * m12, m02 * m12 - m01 * m22, m01 * m12 - m02 * m11
        k11, k12, k22 = m00 * m22 - m02 * m02, m01 * m02 - m00 * m12, m00 * m11 - m01 * m01
        determinant = m00 * k00 + m01 * k01 + m02 * k02
        if not determinant > 1e-6 * m00 * m11 * m22:
            state[4, j] = 0.0
            continue
        b0, b1, b2 = sums[6, j], sums[7, j], sums[8, j]
        state[0, j] = (k00 * b0 + k01 * b1 + k02 * b2) / determinant
        c = (k01 * b0 + k11 * b1 + k12 * b2) / determinant
        s = (k02 * b0 + k12 * b1 + k22 * b2) / determinant
        state[1, j], state[2, j] = c, s
        sums[9, j], sums[10, j], sums[11, j], sums[12, j] = k11, k12, k22, determinant
        if (c * c + s * s) ** 2 * determinant < s * s * k11 - 2 * s * c * k12 + c * c * k22:
            state[4, j] = 2.0  # more than a radian unsure: no fringes here, and no better weights


@njit(cache=True)
def _finish(row, first, size, values, use, basis, light, shot, floor, sums, state, found):  # type: ignore[no-untyped-def]
    """Turn solutions into phase, deviation, amplitude, offset and what the steps leave over."""
    mean, cosine, sine, rest = state[0], state[1], state[2], sums[0]
    rest[:size] = 0.0
    for f in range(len(light)):
        t, c0, c1, c2 = light[f], basis[f, 0], basis[f, 1], basis[f, 2]
        value, lit = values[f], use[f]
        for j in range(size):
            model = t * (mean[j] * c0 + cosine[j] * c1 + sine[j] * c2)
            away = value[j] - model
            rest[j] += lit[j] * (away * away) / (shot * (model if model > 0.0 else 0.0) + floor)
    for j in range(size):
        c, s = state[1, j], state[2, j]
        power = c * c + s * s
        if state[4, j] == 0.0 or not power > 0.0:
            continue
        k11, k12, k22, determinant = sums[9, j], sums[10, j], sums[11, j], sums[12, j]
        column = first + j
        found[0, row, column] = math.atan2(s, c)
        variance = (s * s * k11 - 2 * s * c * k12 + c * c * k22) / determinant / (power * power)
        found[1, row, column] = math.sqrt(max(variance, 0.0))
        found[2, row, column] = math.sqrt(power)
        found[3, row, column] = state[0, j]
        if state[3, j] > 3.0:
            found[4, row, column] = rest[j] / (state[3, j] - 3.0)
