"""Brightness that drifts from frame to frame, and noise: both found from redundant phase steps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.structured_light.circle import fit_circle, rounded_basis
from pipeline.structured_light.fringes import solve_fringes
from pipeline.structured_light.noise import SATURATED, NoiseModel, fit_noise

GAIN_PRIOR = 0.03
"""Expected spread of the frames' brightness; it holds what the data cannot tell apart."""

FEWEST_FRAMES = 8
"""Frames from which on each one's place in the fringe is estimated, beside its brightness."""

MOST_PIXELS, WIDEST_STRIDE = 120_000, 3
"""What drifts is the same for all pixels: more of them tell nothing new. Sparser ones would no
longer tell fine fringes."""

_FEWEST_PIXELS = 1000
_CLEAR = 20.0
_FLAT = 1e-5
_ROUNDS = 3


def redundant(shifts: NDArray[np.float64]) -> int:
    """Return how many frames there are beyond the different unknowns that they can determine."""
    return len(shifts) - _rank(nominal_basis(shifts))


def evenly_spread(shifts: NDArray[np.float64]) -> int:
    """Return the number of different steps if they are evenly spread over one turn, else 0."""
    turn = 2 * np.pi
    steps = np.unique(np.round(np.mod(shifts, turn), 6) % round(turn, 6))
    gaps = np.diff(steps, append=steps[0] + turn)
    return len(steps) if np.allclose(gaps, turn / len(steps), atol=1e-4) else 0


def frame_basis(
    stack: NDArray[np.number],
    shifts: NDArray[np.float64],
    full_scale: float,
    light: NDArray[np.float32] | None = None,
) -> NDArray[np.float64]:
    """Find what frames of one exposure really showed: rows (1, cos, -sin)(shift), where ideal.

    A projector that flickers, or whose steps are not quite where they should be, gives
    y_n = a_n offset + c_n C + s_n S with other (a, c, s) than the nominal ones. Over many pixels
    the frames still span three dimensions, which the largest eigenvectors of y y^T are (Vargas,
    Quiroga and Belenguer 2011), and what most frames agree on turns it into place. With fewer
    frames than FEWEST_FRAMES their brightness alone is estimated, and nothing without a redundant
    step. What residuals cannot tell is then found from the circle, see :mod:`.circle`.

    Parameters
    ----------
    stack
        (frames, rows, columns) stored values of one exposure.
    shifts
        (frames,) nominal phase of each, radians.
    full_scale
        The stored value that means 1.
    light
        (rows, columns) the projector's light without a pattern, where known.

    Returns
    -------
    (frames, 3), near (1, cos, -sin) of the shifts.
    """
    stride = int(np.clip(np.sqrt(stack[0].size / MOST_PIXELS), 2, WIDEST_STRIDE))
    sample = np.ascontiguousarray(stack[:, ::stride, ::stride])
    basis = _from_residuals(sample, nominal_basis(shifts), full_scale)
    flat = NoiseModel(0.0, _FLAT, given=False)
    plain = None if light is None else light[::stride, ::stride]
    for _ in range(_ROUNDS):
        fringes = solve_fringes(sample, basis, np.ones(len(shifts)), full_scale, flat)
        circle = fit_circle(fringes, plain, (1, 2, len(shifts)))
        if circle is None or not (circle.harmonic[1] or circle.harmonic[2]):
            break
        basis = rounded_basis(basis, shifts, circle)
    return basis


def _from_residuals(
    sample: NDArray[np.number], nominal: NDArray[np.float64], full_scale: float
) -> NDArray[np.float64]:
    """Find the frames' rows as far as residuals tell them: not in what the solution absorbs."""
    frames = len(nominal)
    flat = sample.reshape(frames, -1)
    values = flat[:, (flat < SATURATED * full_scale).all(axis=0)].astype(np.float64)
    if frames <= _rank(nominal) or values.shape[1] < _FEWEST_PIXELS:
        return nominal
    swing = values.max(axis=0) - values.min(axis=0)
    values = values[:, swing > 0.3 * np.percentile(swing, 98)] / full_scale
    if frames >= FEWEST_FRAMES:
        size, vectors = np.linalg.eigh(values @ values.T / values.shape[1])
        if size[-3] > _CLEAR * max(size[-4], 0.0):
            return _turned(vectors[:, -3:], nominal)
    return _brightness(values, nominal)[:, None] * nominal


def _turned(space: NDArray[np.float64], nominal: NDArray[np.float64]) -> NDArray[np.float64]:
    """Turn a basis of three dimensions until its rows are the nominal ones times a gain each.

    By least absolute row distances, so that single frames may be elsewhere; turn and gains in turn.
    """
    weight = np.ones(len(nominal))
    gains = np.ones(len(nominal))
    for _ in range(300):
        root = np.sqrt(weight)[:, None]
        target = gains[:, None] * nominal
        turn = np.linalg.lstsq(root * space, root * target, rcond=None)[0]
        rows = space @ turn
        gains = (rows * nominal).sum(axis=1) / (nominal * nominal).sum(axis=1)
        gains /= gains.mean()
        distance = np.linalg.norm(rows - gains[:, None] * nominal, axis=1)
        weight = 1 / np.maximum(distance, 1e-4)
    return np.asarray(space @ turn)


def _brightness(values: NDArray[np.float64], nominal: NDArray[np.float64]) -> NDArray[np.float64]:
    """Find the frames' relative brightness from the residuals of all pixels.

    With y_n = (1 + e_n) m_n and P the projection off the space of (1, cos, sin), a pixel's residual
    is P diag(m) e: linear in e, so one least-squares solution over all pixels, repeated as m
    improves. A prior of GAIN_PRIOR holds the directions that the phase itself would absorb.
    """
    frames = len(nominal)
    project = np.eye(frames) - nominal @ np.linalg.pinv(nominal)
    gains = np.ones(frames)
    for _ in range(6):
        residual = project @ (values / gains[:, None])
        model = values / gains[:, None] - residual
        # Of the residual only what no gain explains is noise; the median passes over outliers.
        noise = float(np.median(residual**2)) / 0.455
        if not noise > 0:
            break
        normal = project * (model @ model.T) + np.eye(frames) * noise / GAIN_PRIOR**2
        pull = (model * residual).sum(axis=1) - (gains - 1) * noise / GAIN_PRIOR**2
        step = np.linalg.solve(normal, pull)
        gains *= 1 + step - step.mean()
        if np.abs(step).max() < 1e-6:
            break
    return np.asarray(gains / gains.mean())


def measured_noise(
    stack: NDArray[np.number],
    shifts: NDArray[np.float64],
    basis: NDArray[np.float64],
    seconds: NDArray[np.float64],
    full_scale: float,
) -> NoiseModel | None:
    """Estimate shot and read noise from what the steps of each exposure leave unexplained.

    Returns
    -------
    None where no step is redundant or too few pixels are lit.
    """
    levels, variances = [], []
    freedom = 0
    for exposure in np.unique(seconds):
        same = seconds == exposure
        if redundant(shifts[same]) < 1:
            continue
        freedom = int(same.sum()) - 3
        found = solve_fringes(
            np.ascontiguousarray(stack[same][:, ::3, ::3]),
            basis[same],
            np.ones(int(same.sum())),
            full_scale,
            NoiseModel(0.0, 1.0, given=False),
        )
        peak = found.offset + found.amplitude
        lit = (found.amplitude > 0.02 * found.offset) & (peak * basis[same, 0].max() < SATURATED)
        levels.append(found.offset[lit])
        variances.append(found.chi2[lit])
    if not levels:
        return None
    return fit_noise(np.concatenate(levels), np.concatenate(variances), freedom)


def nominal_basis(shifts: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rows (1, cos, -sin) of phase steps, (frames, 3)."""
    return np.stack([np.ones(len(shifts)), np.cos(shifts), -np.sin(shifts)], axis=1)


def _rank(basis: NDArray[np.float64]) -> int:
    return int(np.linalg.matrix_rank(basis, tol=1e-6))
