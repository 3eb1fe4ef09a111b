"""The canvas's own form: a low-order bulge or twist, told apart from the paint's relief."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.form import HIGHEST_DEGREE, Form, exponents

Array = NDArray[np.float64]

_MOST_SAMPLES = 15_000
_BLOCKS = 10  # along each side: samples of one block may err together
_HUBER, _TUKEY = 1.345, 4.685  # 95 % efficient on normal residuals
_MAD_TO_SIGMA = 1.4826
_ITERATIONS = 20
_SIGNIFICANT = 25.0  # Wald statistic per added coefficient, that is five standard deviations
_CERTAIN = 10.0  # range of the form over its standard deviation
_BEYOND_RELIEF = 2.0  # range of the form over the relief's
_RELIEF_PERCENTILES = (5.0, 95.0)
_STEEPEST = 0.05  # range over the canvas's longer side: no stretched canvas bends as far


@dataclass(frozen=True)
class FoundForm:
    """The form of a canvas.

    Parameters
    ----------
    form
        Its polynomial.
    heights_mm
        (rows, columns) float32 above the plane; NaN outside the canvas.
    sigma_mm
        RMS over the canvas of its standard deviation, the relief counted as noise.
    """

    form: Form
    heights_mm: NDArray[np.float32]
    sigma_mm: float


def find_form(
    heights_mm: NDArray[np.floating], spacing_mm: float, least_mm: float
) -> FoundForm | str:
    """Fit the low-order form of a height field, if it has one that is worth removing.

    Parameters
    ----------
    heights_mm
        (rows, columns) above the canvas plane; NaN where not known.
    spacing_mm
        Between samples.
    least_mm
        A form of a smaller range (peak to peak) is left where it is.

    Returns
    -------
    FoundForm or str
        The form, or in words why there is none.

    Notes
    -----
    Polynomials of total degree 2 to 4 by iteratively reweighted least squares (Huber, then Tukey's
    biweight), so that paint that stands off the ground pulls little. Relief is correlated from
    sample to sample, which a plain covariance would not see: the coefficients' covariance sums the
    scores over blocks first (Liang and Zeger 1986). A degree is taken if Wald's statistic of what
    it adds, on that covariance, is significant.
    """
    known = np.isfinite(heights_mm)
    step = max(1, int(np.sqrt(np.count_nonzero(known) / _MOST_SAMPLES)))
    row, column = np.nonzero(known[::step, ::step])
    row, column = row * step, column * step
    z = heights_mm[row, column].astype(np.float64)
    # What the whole surface does not span its form does not either: most canvases end here.
    if not len(z) or np.ptp(np.percentile(z, (0.5, 99.5))) < least_mm:
        return f"the canvas is flat to {least_mm:g} mm"
    rows, columns = heights_mm.shape
    scale = 0.5 * spacing_mm * max(rows - 1, columns - 1, 1)
    centre = np.array([0.5 * (columns - 1), -0.5 * (rows - 1)]) * spacing_mm
    u = (column * spacing_mm - centre[0]) / scale
    v = (-row * spacing_mm - centre[1]) / scale
    blocks = _BLOCKS * (row * _BLOCKS // rows) + column * _BLOCKS // columns
    fit = _lowest_sufficient(u, v, z, blocks)
    if fit is None:
        return "the canvas has no bulge or twist that stands out from its relief"
    coefficients, covariance, degree = fit
    basis = _basis(u, v, degree)
    shape = basis @ coefficients
    sigma = float(np.sqrt(np.einsum("ni,ij,nj->n", basis, covariance, basis).mean()))
    span = float(np.ptp(shape))
    relief = float(np.ptp(np.percentile(z - shape, _RELIEF_PERCENTILES)))
    for reason in (
        (span < least_mm, f"its range of {span:.2g} mm is less than {least_mm:g} mm"),
        (span < _BEYOND_RELIEF * relief, f"the relief spans {relief:.2g} mm, it {span:.2g} mm"),
        (span < _CERTAIN * sigma, f"it is known to {sigma:.2g} mm only"),
        (span > _STEEPEST * 2 * scale, f"with {span:.2g} mm it is no stretched canvas"),
    ):
        if reason[0]:
            return reason[1]
    form = Form(degree, tuple(coefficients.tolist()), (centre[0], centre[1]), scale, span)
    return FoundForm(form, form.heights(rows, columns, spacing_mm, known), sigma)


def _lowest_sufficient(
    u: Array, v: Array, z: Array, blocks: NDArray[np.integer]
) -> tuple[Array, Array, int] | None:
    """Return coefficients, their covariance and the degree; None if a plane is all there is."""
    best = None
    for degree in range(2, HIGHEST_DEGREE + 1):
        basis = _basis(u, v, degree)
        fitted = _fit(basis, z, blocks)
        if fitted is None:
            break
        coefficients, covariance = fitted
        added = np.s_[-(degree + 1) :]
        wald = coefficients[added] @ np.linalg.pinv(covariance[added, added]) @ coefficients[added]
        if wald > _SIGNIFICANT * (degree + 1):
            best = coefficients, covariance, degree
    return best


def _fit(basis: Array, z: Array, blocks: NDArray[np.integer]) -> tuple[Array, Array] | None:
    """Fit robustly; None if the samples leave a coefficient free."""
    weights: Array = np.ones(len(z))
    coefficients: Array = np.zeros(basis.shape[1])
    floor = 1e-9 * max(float(np.ptp(z)), 1e-9)
    for loss in (_huber, _tukey):
        for _ in range(_ITERATIONS):
            previous = coefficients
            normal = basis.T @ (weights[:, None] * basis)
            if np.linalg.cond(normal) > 1e12:
                return None
            coefficients = np.asarray(np.linalg.solve(normal, basis.T @ (weights * z)), np.float64)
            residual = z - basis @ coefficients
            scale = _MAD_TO_SIGMA * float(np.median(np.abs(residual))) + floor
            weights = loss(np.abs(residual) / scale)
            if np.abs(coefficients - previous).max() < 1e-4 * scale:
                break
    scores = np.zeros((_BLOCKS * _BLOCKS, basis.shape[1]))
    np.add.at(scores, blocks, (weights * residual)[:, None] * basis)
    used = int(np.count_nonzero(np.bincount(blocks)))
    bread = np.linalg.inv(normal)
    correction = used / max(used - basis.shape[1], 1)  # few blocks: their scores are fitted away
    return coefficients, bread @ (correction * scores.T @ scores) @ bread


def _huber(residual: Array) -> Array:
    return _HUBER / np.maximum(residual, _HUBER)


def _tukey(residual: Array) -> Array:
    return np.maximum(1 - (residual / _TUKEY) ** 2, 0) ** 2


def _basis(u: Array, v: Array, degree: int) -> Array:
    return np.stack([u**i * v**j for i, j in exponents(degree)], axis=1)
