"""Fringes as a circle: their contrast must not depend on the phase, and if it does, why.

Over many periods the phase has nothing to do with what the scene's contrast is, so the radius of
(C, S) over the light is the same for all phases. A first harmonic of the radius over the phase says
that the circle's centre has moved (brightness that drifts as slowly as one turn), a second that it
is an ellipse (as twice per turn); no residual of the steps can tell these two, for they are what
the solution itself absorbs (ellipse fitting: Farrell and Player 1992). An N-th one is the
projector's (N - 1)-th harmonic, which N steps mistake for the fringe.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.structured_light.fringes import Fringes

Image = NDArray[np.float32]

FEWEST_PERIODS = 5.0
"""Periods that the lit area must span: with fewer, contrast and phase are confounded."""

LARGEST = 0.4
"""A larger harmonic is no drift."""

CERTAIN = 0.1
"""Radians; the radius of a less certain phase is too noisy to weigh in."""

_FEWEST_PIXELS = 3000
_FEWEST_PER_BIN = 20
_ROUNDS = 4
_BINS = 48
_SIGNIFICANT = 3.0


@dataclass(frozen=True)
class Circle:
    """Harmonics of the radius over the phase, relative to its mean.

    Parameters
    ----------
    harmonic
        r_m of r(phase) = 1 + sum over m of Re(r_m exp(-i m phase)); 0 where noise explains it.
    contrast
        Amplitude over offset.
    by_offset
        The radius was taken relative to the offset, not to a plain image.
    """

    harmonic: dict[int, complex]
    contrast: float
    by_offset: bool


def fit_circle(
    fringes: Fringes, light: Image | None, orders: tuple[int, ...], phase: Image | None = None
) -> Circle | None:
    """Measure how the radius depends on the phase; None where the scene does not tell.

    Parameters
    ----------
    fringes
        A period's solution.
    light
        The projector's light without a pattern; the fringes' offset takes its place if None.
    orders
        The harmonics to measure.
    phase
        A better phase than that of ``fringes``.
    """
    measured = fringes.phase if phase is None else phase
    with np.errstate(invalid="ignore", divide="ignore"):
        radius = fringes.amplitude / (fringes.offset if light is None else light)
    lit = np.isfinite(radius) & (fringes.sigma < CERTAIN) & (fringes.offset > 0)
    if np.count_nonzero(lit) < _FEWEST_PIXELS:
        return None
    lit &= radius > 0.3 * np.median(radius[lit])
    turn = _turn_per_pixel(measured, lit)
    if not turn > 0 or math.sqrt(np.count_nonzero(lit)) * turn < FEWEST_PERIODS * 2 * math.pi:
        return None
    # Against the mean over some periods around, so that contrast that changes slowly cancels.
    width = 2 * round(1.5 * 2 * math.pi / turn) + 1
    known = lit.astype(np.float32)
    mean = _blur(np.where(lit, radius, 0), width) / np.maximum(_blur(known, width), 1e-6)
    squared = (radius[lit] / mean[lit]).astype(np.float64) ** 2
    harmonic = _harmonics(measured[lit].astype(np.float64), squared, orders)
    if harmonic is None:
        return None
    contrast = float(np.median(fringes.amplitude[lit] / fringes.offset[lit]))
    return Circle(harmonic, contrast, light is None)


def _harmonics(
    phase: NDArray[np.float64], squared: NDArray[np.float64], orders: tuple[int, ...]
) -> dict[int, complex] | None:
    """Fit harmonics to the medians of the squared radius, |1 + r exp(-i m phase)|^2, over bins."""
    bins = np.floor((phase / (2 * math.pi) + 0.5) * _BINS).astype(np.int64) % _BINS
    order = np.argsort(bins, kind="stable")
    parts = np.split(squared[order], np.searchsorted(bins[order], np.arange(1, _BINS)))
    if min(len(part) for part in parts) < _FEWEST_PER_BIN:
        return None
    middle = np.array([np.median(part) for part in parts])
    error = [1.25 * np.std(np.clip(p, 0.25, 2.25)) / math.sqrt(len(p)) for p in parts]
    weight = 1 / np.maximum(error, 1e-6)
    centre = ((np.arange(_BINS) + 0.5) / _BINS - 0.5) * 2 * math.pi
    columns = [np.ones(_BINS)]
    for m in orders:
        columns += [2 * np.cos(m * centre), 2 * np.sin(m * centre)]
    design = np.stack(columns, axis=1) * weight[:, None]
    covariance = np.linalg.inv(design.T @ design)
    solution = covariance @ (design.T @ (middle * weight))
    found = {}
    for i, m in enumerate(orders):
        value = complex(solution[1 + 2 * i], solution[2 + 2 * i]) / solution[0]
        doubt = _SIGNIFICANT * math.sqrt(covariance[1 + 2 * i, 1 + 2 * i])
        size = abs(value)
        kept = max(0.0, 1 - (doubt / size) ** 2) if 0 < size < LARGEST else 0.0
        found[m] = value * kept
    return found


def rounded_basis(
    basis: NDArray[np.float64], shifts: NDArray[np.float64], circle: Circle
) -> NDArray[np.float64]:
    """Change the frames' rows (a, c, s) so that the circle is centred and round.

    Gains 1 + Re(e exp(i shift)) move its centre: they add e offset to (C, -S), which is
    e / contrast of the radius, and e / 2 amplitude to the offset. Four frames or fewer get those
    gains; of more, only the part that the solution absorbs is left to correct.
    """
    first, bend = circle.harmonic.get(1, 0j), circle.harmonic.get(2, 0j)
    contrast = circle.contrast
    drift = first / (1 / contrast - (0.5 * contrast if circle.by_offset else 0.0))
    ellipse = np.array([[1, 0, 0], [0, 1 + bend.real, bend.imag], [0, bend.imag, 1 - bend.real]])
    rounded = basis @ ellipse
    if len(shifts) <= 4:
        return np.asarray((1 + (drift * np.exp(1j * shifts)).real)[:, None] * rounded)
    half = 0.5 * drift
    centre = np.array([[1, half.real, half.imag], [drift.real, 1, 0], [drift.imag, 0, 1]])
    return np.asarray(rounded @ centre)


def without_harmonic(
    fringes: Fringes, light: Image | None, steps: int
) -> tuple[Image, complex] | None:
    """Correct the phase for the projector's harmonic that aliases onto the fringe.

    It turns exp(i p) into exp(i p) + h exp(-i (N - 1) p), whose radius squared is
    1 + h^2 + 2 h cos(N p): h is fitted, the phase solved for, and both again.

    Returns
    -------
    The phase and h; None where the scene does not tell.
    """
    phase, found = fringes.phase, 0j
    for _ in range(_ROUNDS):
        circle = fit_circle(fringes, light, (1, 2, steps), phase)
        if circle is None:
            return None
        found = circle.harmonic[steps]
        if not found:
            return fringes.phase, found
        phase = _unbent(fringes.phase, found, steps)
    return phase, found


def _unbent(phase: Image, harmonic: complex, steps: int) -> Image:
    """Solve ``phase = p + arg(1 + h exp(-i N p))`` for p."""
    bent, turned = phase, np.float32(np.angle(harmonic))
    size = np.float32(abs(harmonic))
    for _ in range(_ROUNDS + math.ceil(20 * abs(harmonic))):
        angle = np.float32(steps) * bent - turned
        bent = phase + np.arctan2(size * np.sin(angle), 1 + size * np.cos(angle))
    turns = np.floor(bent / np.float32(2 * np.pi) + np.float32(0.5))
    return np.asarray(bent - np.float32(2 * np.pi) * turns, dtype=np.float32)


def _turn_per_pixel(phase: Image, lit: NDArray[np.bool_]) -> float:
    """Return the median size of the phase's gradient, radians per pixel."""
    along = []
    for axis in (0, 1):
        step = np.diff(phase, axis=axis)
        step -= np.float32(2 * np.pi) * np.rint(step / np.float32(2 * np.pi))
        both = np.logical_and(*((lit[1:], lit[:-1]) if axis == 0 else (lit[:, 1:], lit[:, :-1])))
        turn = np.abs(step[both])
        along.append(float(np.median(turn)) if turn.size else 0.0)
    return math.hypot(*along)


def _blur(image: Image, width: int) -> Image:
    blurred = cv2.blur(image.astype(np.float32), (width, width), borderType=cv2.BORDER_CONSTANT)
    return np.asarray(blurred, dtype=np.float32)
