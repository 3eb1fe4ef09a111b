"""Phase steps of one period, at any exposures, solved per pixel by weighted least squares."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from pipeline.structured_light.noise import SATURATED, NoiseModel

Image = NDArray[np.float32]


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


# The kernels fill arrays that are made outside: what numba parallelises is their loop alone.
@njit(cache=True, parallel=True)
def _solve(stack, basis, light, unit, saturated, shot, floor, found, kept):  # type: ignore[no-untyped-def]
    frames, rows, columns = stack.shape
    for row in prange(rows):
        values = np.empty(frames)
        for column in range(columns):
            used = 0
            level = time = 0.0
            for f in range(frames):
                v = stack[f, row, column] * unit
                if v < saturated:
                    values[f] = v
                    level += v
                    time += light[f] * basis[f, 0]
                    used += 1
                else:
                    values[f] = np.nan
            kept[row] += used
            if used < 3:
                continue
            # The noise follows the light, first its mean, then what the first solution says. The
            # noisy value itself would favour the steps that happen to be low.
            mean, c, s = level / time, 0.0, 0.0
            k11 = k12 = k22 = determinant = 0.0
            solved = True
            for _ in range(2):
                m00 = m01 = m02 = m11 = m12 = m22 = 0.0
                b0 = b1 = b2 = 0.0
                for f in range(frames):
                    v = values[f]
                    if math.isnan(v):
                        continue
                    t = light[f]
                    c0, c1, c2 = basis[f, 0], basis[f, 1], basis[f, 2]
                    w = t / (shot * max(t * (mean * c0 + c * c1 + s * c2), 0.0) + floor)
                    b0 += w * v * c0
                    b1 += w * v * c1
                    b2 += w * v * c2
                    w *= t
                    m00 += w * c0 * c0
                    m01 += w * c0 * c1
                    m02 += w * c0 * c2
                    m11 += w * c1 * c1
                    m12 += w * c1 * c2
                    m22 += w * c2 * c2
                # Cofactors of the symmetric normal matrix.
                k00, k01, k02 = m11 * m22 - m12 * m12, m02 * m12 - m01 * m22, m01 * m12 - m02 * m11
                k11, k12, k22 = m00 * m22 - m02 * m02, m01 * m02 - m00 * m12, m00 * m11 - m01 * m01
                determinant = m00 * k00 + m01 * k01 + m02 * k02
                if not determinant > 1e-6 * m00 * m11 * m22:
                    solved = False
                    break
                mean = (k00 * b0 + k01 * b1 + k02 * b2) / determinant
                c = (k01 * b0 + k11 * b1 + k12 * b2) / determinant
                s = (k02 * b0 + k12 * b1 + k22 * b2) / determinant
                if (c * c + s * s) ** 2 * determinant < s * s * k11 - 2 * s * c * k12 + c * c * k22:
                    break  # more than a radian unsure: no fringes here
            power = c * c + s * s
            if not solved or not power > 0.0:
                continue
            found[0, row, column] = math.atan2(s, c)
            variance = (s * s * k11 - 2 * s * c * k12 + c * c * k22) / determinant / (power * power)
            found[1, row, column] = math.sqrt(max(variance, 0.0))
            found[2, row, column] = math.sqrt(power)
            found[3, row, column] = mean
            if used > 3:
                rest = 0.0
                for f in range(frames):
                    if not math.isnan(values[f]):
                        model = light[f] * (mean * basis[f, 0] + c * basis[f, 1] + s * basis[f, 2])
                        rest += (values[f] - model) ** 2 / (shot * max(model, 0.0) + floor)
                found[4, row, column] = rest / (used - 3)
