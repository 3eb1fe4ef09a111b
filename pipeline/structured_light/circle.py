"""Fringes as a circle: their contrast must not depend on the phase, and if it does, why.

Over many periods the phase has nothing to do with what the scene's contrast is, so the radius of
(C, S) / A is the same for all phases. A first harmonic of the radius over the phase says that the
circle's centre has moved (brightness that drifts as slowly as one turn), a second that it is an
ellipse (as twice per turn); no residual of the steps can tell these two, for they are what the
solution itself absorbs (ellipse fitting: Farrell and Player 1992). An N-th one is the projector's
(N - 1)-th harmonic, which N steps mistake for the fringe.
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

LARGEST = 0.25
"""A larger harmonic is no drift."""

_FEWEST_PIXELS = 3000
_BINS = 48
_SIGNIFICANT = 3.0


@dataclass(frozen=True)
class Circle:
    """Harmonics of the radius over the phase, relative to its mean.

    ``harmonic[m]`` is r_m of r(phase) = 1 + sum over m of Re(r_m exp(-i m phase)); those that noise
    explains are 0. ``contrast`` is the mean radius.
    """

    contrast: float
    harmonic: dict[int, complex]


def fit_circle(fringes: Fringes, orders: tuple[int, ...]) -> Circle | None:
    """Measure how the radius depends on the phase; None where the scene does not tell."""
    with np.errstate(invalid="ignore", divide="ignore"):
        radius = fringes.amplitude / fringes.offset
    lit = np.isfinite(radius) & (fringes.sigma < 0.1) & (fringes.offset > 0)
    if np.count_nonzero(lit) < _FEWEST_PIXELS:
        return None
    lit &= radius > 0.3 * np.median(radius[lit])
    turn = _turn_per_pixel(fringes.phase, lit)
    if not turn > 0 or math.sqrt(np.count_nonzero(lit)) * turn < FEWEST_PERIODS * 2 * math.pi:
        return None
    # Against the mean over some periods around, so that contrast that changes slowly cancels.
    width = 2 * round(1.5 * 2 * math.pi / turn) + 1
    known = lit.astype(np.float32)
    mean = _blur(np.where(lit, radius, 0), width) / np.maximum(_blur(known, width), 1e-6)
    relative = (radius[lit] / mean[lit]).astype(np.float64)
    phase = fringes.phase[lit].astype(np.float64)
    bins = np.floor((phase / (2 * math.pi) + 0.5) * _BINS).astype(np.int64) % _BINS
    order = np.argsort(bins, kind="stable")
    parts = np.split(relative[order], np.searchsorted(bins[order], np.arange(1, _BINS)))
    if min(len(part) for part in parts) < 20:
        return None
    middle = np.array([np.median(part) for part in parts])
    error = np.array([1.5 * np.std(np.clip(p, 0.5, 1.5)) / math.sqrt(len(p)) for p in parts])
    centre = ((np.arange(_BINS) + 0.5) / _BINS - 0.5) * 2 * math.pi
    columns = [np.ones(_BINS)]
    for m in orders:
        columns += [np.cos(m * centre), np.sin(m * centre)]
    design = np.stack(columns, axis=1)
    weighted = design / error[:, None]
    covariance = np.linalg.inv(weighted.T @ weighted)
    solution = covariance @ (weighted.T @ (middle / error))
    harmonic = {}
    for i, m in enumerate(orders):
        value = complex(solution[1 + 2 * i], solution[2 + 2 * i]) / solution[0]
        doubt = _SIGNIFICANT * math.sqrt(covariance[1 + 2 * i, 1 + 2 * i])
        kept = max(0.0, 1 - (doubt / abs(value)) ** 2) if value else 0.0
        harmonic[m] = value * kept if abs(value) < LARGEST else 0j
    return Circle(float(np.median(radius[lit])), harmonic)


def rounded_basis(basis: NDArray[np.float64], circle: Circle) -> NDArray[np.float64]:
    """Change the frames' rows (a, c, s) so that the circle is centred and round."""
    shift = circle.contrast * circle.harmonic.get(1, 0j)
    bend = circle.harmonic.get(2, 0j)
    centred = np.array([[1, 0, 0], [-shift.real, 1, 0], [-shift.imag, 0, 1]])
    ellipse = np.array([[1, 0, 0], [0, 1 - bend.real, -bend.imag], [0, -bend.imag, 1 + bend.real]])
    return np.asarray(basis @ np.linalg.inv(ellipse @ centred))


def without_harmonic(phase: Image, circle: Circle, steps: int) -> Image:
    """Correct the phase for the projector's harmonic that aliases onto the fringe.

    exp(i p) + r exp(-i (N - 1) p) has the radius 1 + r cos(N p) and the phase p - r sin(N p).
    """
    found = circle.harmonic.get(steps, 0j)
    if not found:
        return phase
    angle = steps * phase - np.float32(np.angle(found))
    corrected: Image = phase + np.float32(abs(found)) * np.sin(angle)
    turns = np.floor(corrected / np.float32(2 * np.pi) + np.float32(0.5))
    return np.asarray(corrected - np.float32(2 * np.pi) * turns, dtype=np.float32)


def _turn_per_pixel(phase: Image, lit: NDArray[np.bool_]) -> float:
    """Return the median size of the phase's gradient, radians per pixel."""
    along = []
    for axis in (0, 1):
        step = np.diff(phase, axis=axis)
        both = np.logical_and(*((lit[1:], lit[:-1]) if axis == 0 else (lit[:, 1:], lit[:, :-1])))
        turn = np.abs(np.angle(np.exp(1j * step[both])))
        along.append(float(np.median(turn)) if turn.size else 0.0)
    return math.hypot(*along)


def _blur(image: Image, width: int) -> Image:
    blurred = cv2.blur(image.astype(np.float32), (width, width), borderType=cv2.BORDER_CONSTANT)
    return np.asarray(blurred, dtype=np.float32)
