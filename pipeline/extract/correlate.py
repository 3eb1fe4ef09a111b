"""How two patches lie to each other, roughly: correlation of relief and albedo over all shifts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from pipeline.extract.patch import PatchMap, blur, high_pass
from pipeline.geometry.rigid import RigidTransform, rotation_about_axis

Array = NDArray[np.float64]

_SIDE = 128  # samples of the coarse maps' longer side
_DETAIL = 5.0  # coarse samples; what is wider is form, tilt and light
_LARGEST_TURN_DEG, _TURN_STEP_DEG = 12.0, 1.5
_LEAST_OVERLAP = 0.04  # of the smaller patch
_LEAST_INDEPENDENT = 8.0
_LEAST_POWER = 1e-3  # of a whole patch's, lest nothing be divided by nothing

SIGNIFICANT = 8.0
"""Score of a match that is not by chance: the best of 10^6 shifts of unrelated maps has 5 to 6."""


@dataclass(frozen=True)
class Match:
    """How one patch lies on another.

    Parameters
    ----------
    motion
        Takes the second patch's axes to the first's: a shift and turn in the plane.
    score
        In standard deviations of the correlation of unrelated maps.
    """

    motion: RigidTransform
    score: float


@dataclass(frozen=True)
class CoarseMap:
    """Layers (2, rows, columns) of relief and albedo, zero-mean, NaN where not known."""

    left_mm: float
    top_mm: float
    spacing_mm: float
    layers: Array


def coarse_spacing(maps: list[PatchMap]) -> float:
    """Return the spacing of all the coarse maps."""
    return float(max(max(m.heights.shape) * m.spacing_mm for m in maps)) / _SIDE


def coarse(fine: PatchMap, spacing_mm: float) -> CoarseMap:
    """Thin a map, and keep of it what tells where it lies."""
    factor = max(1.0, spacing_mm / fine.spacing_mm)
    rows, columns = (int((n - 1) / factor) + 1 for n in fine.heights.shape)
    position = np.meshgrid(np.arange(rows) * factor, np.arange(columns) * factor, indexing="ij")
    layers = []
    for image in (fine.heights, fine.detail):
        smooth = blur(image, 0.5 * factor if factor > 1 else 0.0)
        thin = ndimage.map_coordinates(smooth, position, order=1, cval=np.nan)
        layers.append(high_pass(thin, _DETAIL))
    return CoarseMap(fine.left_mm, fine.top_mm, fine.spacing_mm * factor, np.stack(layers))


def match(first: CoarseMap, second: CoarseMap) -> Match:
    """Find the shift and turn in the plane that bring the second map onto the first.

    Notes
    -----
    Normalised cross-correlation of masked images for all shifts at once (Padfield 2012), at each of
    a range of turns; unlike plain phase correlation it is not led astray where the overlap is a
    small part. Fisher's z over its standard deviation ranks the shifts, so that a large overlap
    that agrees well beats a small one that agrees better by chance; neighbouring samples are not
    independent, which Bartlett's formula (1946) accounts for. Relief and albedo add up.
    """
    rows, columns = (
        fft.next_fast_len(a + b, real=True)
        for a, b in zip(
            first.layers.shape[1:], (int(1.25 * max(second.layers.shape[1:])) + 2,) * 2, strict=True
        )
    )
    shape = (rows, columns)
    fixed = [_spectra(layer, shape) for layer in first.layers]
    spread = [_correlation_area(a, b) for a, b in zip(first.layers, second.layers, strict=True)]
    best, motion = -np.inf, RigidTransform()
    for angle in np.arange(-_LARGEST_TURN_DEG, _LARGEST_TURN_DEG + 0.1, _TURN_STEP_DEG):
        turned, corner = _turned(second, float(angle))
        score = np.zeros(shape)
        for layer, spectra, area in zip(turned, fixed, spread, strict=True):
            if spectra is not None and (moving := _spectra(layer, shape)) is not None:
                score += _scores(spectra, moving, area, shape)
        top = int(np.argmax(score))
        if score.flat[top] > best:
            best = float(score.flat[top])
            shift = np.array(np.unravel_index(top, shape), dtype=np.int64)
            limit = first.layers.shape[1:]
            shift = np.where(shift >= limit, shift - shape, shift)
            place = np.array([first.left_mm, first.top_mm])
            place = place + np.array([shift[1], -shift[0]]) * first.spacing_mm - corner
            turn = rotation_about_axis(np.zeros(3), np.array([0.0, 0.0, 1.0]), float(angle))
            motion = RigidTransform(turn.rotation, np.array([*place, 0.0]))
    return Match(motion, best / np.sqrt(2))


@dataclass(frozen=True)
class _Spectra:
    """Transforms of mask, values (of unit power) and their squares; count of the mask."""

    mask: NDArray[np.complexfloating]
    values: NDArray[np.complexfloating]
    squares: NDArray[np.complexfloating]
    count: float


def _spectra(layer: Array, shape: tuple[int, int]) -> _Spectra | None:
    known = np.isfinite(layer)
    values = np.where(known, layer, 0.0)
    power = float(np.mean(values[known] ** 2)) if known.any() else 0.0
    if not power > 0:
        return None
    values = values / np.sqrt(power)
    mask, plain, squares = (fft.rfft2(a, shape) for a in (1.0 * known, values, values**2))
    return _Spectra(mask, plain, squares, float(np.count_nonzero(known)))


def _scores(a: _Spectra, b: _Spectra, area: float, shape: tuple[int, int]) -> Array:
    """Return Fisher's z over its deviation for all shifts of ``b`` over ``a``."""

    def correlate(x: NDArray[np.complexfloating], y: NDArray[np.complexfloating]) -> Array:
        return np.asarray(fft.irfft2(x * np.conj(y), shape))

    count = correlate(a.mask, b.mask)
    least = max(_LEAST_OVERLAP * min(a.count, b.count), _LEAST_INDEPENDENT * area)
    enough = count > least
    count = np.maximum(count, 1.0)
    floor = _LEAST_POWER * count
    power = np.maximum(correlate(a.squares, b.mask), floor)
    power *= np.maximum(correlate(a.mask, b.squares), floor)
    r = correlate(a.values, b.values) / np.sqrt(power)
    z = np.arctanh(np.clip(r, -0.99, 0.99)) * np.sqrt(count / area)
    return np.where(enough, z, -np.inf)


def _correlation_area(a: Array, b: Array) -> float:
    """Return how many samples make one independent pair (Bartlett 1946)."""
    shape = tuple(
        fft.next_fast_len(2 * max(m, n), real=True) for m, n in zip(a.shape, b.shape, strict=True)
    )
    product = np.ones(shape)
    for image in (a, b):
        values = np.where(np.isfinite(image), image, 0.0)
        own = fft.irfft2(np.abs(fft.rfft2(values, shape)) ** 2, shape)
        if not own[0, 0] > 0:
            return 1.0
        product *= own / own[0, 0]
    return max(1.0, float(product.sum()))


def _turned(coarse_map: CoarseMap, angle_deg: float) -> tuple[Array, Array]:
    """Turn a map counter-clockwise about its axes' origin; return layers, and their corner x, y."""
    rows, columns = coarse_map.layers.shape[1:]
    spacing = coarse_map.spacing_mm
    angle = np.deg2rad(angle_deg)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    right, bottom = (columns - 1) * spacing, -(rows - 1) * spacing
    corner = np.array([coarse_map.left_mm, coarse_map.top_mm])
    corners = (corner + np.array([[0, 0], [right, 0], [0, bottom], [right, bottom]])) @ turn.T
    left, top = corners[:, 0].min(), corners[:, 1].max()
    size = np.ceil(np.ptp(corners, axis=0) / spacing).astype(int) + 1
    y, x = np.meshgrid(
        top - np.arange(size[1]) * spacing, left + np.arange(size[0]) * spacing, indexing="ij"
    )
    back = np.stack([x, y], axis=-1) @ turn - corner
    position = (-back[..., 1] / spacing, back[..., 0] / spacing)
    layers = [
        ndimage.map_coordinates(layer, position, order=1, cval=np.nan)
        for layer in coarse_map.layers
    ]
    return np.stack(layers), np.array([left, top])
