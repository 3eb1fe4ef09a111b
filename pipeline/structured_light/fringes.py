"""Phase steps of one period, at any exposures, solved per pixel by weighted least squares."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from pipeline.structured_light.noise import SATURATED, NoiseModel

Image = NDArray[np.float32]

GAIN_PRIOR = 0.03
"""Expected spread of the frames' brightness; it holds what the data cannot tell apart."""

_FEWEST_PIXELS = 1000


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
    """

    phase: Image
    sigma: Image
    amplitude: Image
    offset: Image
    chi2: Image


def solve_fringes(
    stack: NDArray[np.number],
    shifts: NDArray[np.float64],
    light: NDArray[np.float64],
    full_scale: float,
    noise: NoiseModel,
) -> Fringes:
    """Solve every pixel from the steps that are not saturated there, three or more.

    Parameters
    ----------
    stack
        (frames, rows, columns) stored values.
    shifts
        (frames,) phase of each frame against the coordinate, radians.
    light
        (frames,) exposure times relative brightness; one dim long exposure and one bright short one
        weigh in by their noise.
    full_scale
        The stored value that means 1.
    """
    basis = np.stack([np.ones_like(shifts), np.cos(shifts), -np.sin(shifts)], axis=1)
    return Fringes(*_solve(stack, basis, light, 1 / full_scale, SATURATED, noise.shot, noise.floor))


@njit(cache=True, parallel=True)  # type: ignore[untyped-decorator]
def _solve(stack, basis, light, unit, saturated, shot, floor):  # type: ignore[no-untyped-def]
    frames, rows, columns = stack.shape
    phase = np.full((rows, columns), np.nan, np.float32)
    sigma, amplitude = phase.copy(), phase.copy()
    offset, chi2 = phase.copy(), phase.copy()
    for row in prange(rows):
        for column in range(columns):
            m00 = m01 = m02 = m11 = m12 = m22 = 0.0
            b0 = b1 = b2 = yy = 0.0
            used = 0
            for f in range(frames):
                v = stack[f, row, column] * unit
                if not v < saturated:
                    continue
                w = 1.0 / (shot * max(v, 0.0) + floor)
                c0, c1, c2 = light[f], light[f] * basis[f, 1], light[f] * basis[f, 2]
                m00 += w * c0 * c0
                m01 += w * c0 * c1
                m02 += w * c0 * c2
                m11 += w * c1 * c1
                m12 += w * c1 * c2
                m22 += w * c2 * c2
                b0 += w * c0 * v
                b1 += w * c1 * v
                b2 += w * c2 * v
                yy += w * v * v
                used += 1
            # Cofactors of the symmetric normal matrix.
            k00, k01, k02 = m11 * m22 - m12 * m12, m02 * m12 - m01 * m22, m01 * m12 - m02 * m11
            k11, k12, k22 = m00 * m22 - m02 * m02, m01 * m02 - m00 * m12, m00 * m11 - m01 * m01
            determinant = m00 * k00 + m01 * k01 + m02 * k02
            if used < 3 or not determinant > 1e-6 * m00 * m11 * m22:
                continue
            mean = (k00 * b0 + k01 * b1 + k02 * b2) / determinant
            c = (k01 * b0 + k11 * b1 + k12 * b2) / determinant
            s = (k02 * b0 + k12 * b1 + k22 * b2) / determinant
            power = c * c + s * s
            if not power > 0.0:
                continue
            phase[row, column] = math.atan2(s, c)
            variance = (s * s * k11 - 2 * s * c * k12 + c * c * k22) / determinant / (power * power)
            sigma[row, column] = math.sqrt(max(variance, 0.0))
            amplitude[row, column] = math.sqrt(power)
            offset[row, column] = mean
            if used > 3:
                chi2[row, column] = max(yy - mean * b0 - c * b1 - s * b2, 0.0) / (used - 3)
    return phase, sigma, amplitude, offset, chi2


def frame_gains(
    stack: NDArray[np.number], shifts: NDArray[np.float64], full_scale: float
) -> NDArray[np.float64]:
    """Find the relative brightness of frames of one exposure from the residuals of all pixels.

    With y_n = (1 + e_n) m_n and P the projection off the space of (1, cos, sin), a pixel's residual
    is P diag(m) e: linear in e, so one least-squares solution over all pixels, repeated as m
    improves. A prior of GAIN_PRIOR holds the directions that the phase itself would absorb.

    Returns
    -------
    (frames,) with mean 1; all 1 where there is no redundant step or too little to see.
    """
    frames = len(shifts)
    basis = np.stack([np.ones(frames), np.cos(shifts), -np.sin(shifts)], axis=1)
    sample = stack[:, ::2, ::2].reshape(frames, -1)
    values = sample[:, (sample < SATURATED * full_scale).all(axis=0)].astype(np.float64)
    if frames <= np.linalg.matrix_rank(basis) or values.shape[1] < _FEWEST_PIXELS:
        return np.ones(frames)
    swing = values.max(axis=0) - values.min(axis=0)
    values = values[:, swing > 0.3 * np.percentile(swing, 98)] / full_scale
    project = np.eye(frames) - basis @ np.linalg.pinv(basis)
    gains = np.ones(frames)
    for _ in range(4):
        residual = project @ (values / gains[:, None])
        model = values / gains[:, None] - residual
        noise = float(np.mean(residual**2))
        normal = project * (model @ model.T) + np.eye(frames) * noise / GAIN_PRIOR**2
        if not noise > 0:
            break
        step = np.linalg.solve(normal, (model * residual).sum(axis=1))
        gains *= 1 + step - step.mean()
        if np.abs(step).max() < 1e-6:
            break
    return np.asarray(gains / gains.mean())
