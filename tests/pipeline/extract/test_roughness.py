"""The variance that unresolved relief adds, against relief that is known more finely."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.extract.roughness import unresolved_variance

SHAPE = (120, 90)


def test_a_smooth_surface_adds_nothing():
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]] * 1.0
    heights = 0.01 * x - 0.02 * y + 1e-4 * x * y + np.sin(x / 12)
    found = unresolved_variance(heights, np.full(SHAPE, 0.002))
    assert np.sqrt(found).max() < 0.002


@pytest.mark.parametrize("sigma", [0.01, 1.0])
def test_noise_alone_adds_little(sigma):
    noise = np.random.default_rng(3).normal(0, sigma, SHAPE)
    found = unresolved_variance(noise, np.full(SHAPE, sigma))
    assert np.median(found) < 0.25 * sigma**2
    assert found.min() >= 0


def rough(fine: int, seed: int = 2) -> np.ndarray:
    """Relief whose power falls with the square of the frequency, ``fine`` points to a sample."""
    rng = np.random.default_rng(seed)
    size = 96 * fine
    f = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.rfftfreq(size)[None]) * fine
    power = 1 / (f**2 + 0.05**2) ** 0.75  # 1 / f^2 along any line
    return np.fft.irfft2(np.fft.rfft2(rng.normal(size=(size, size))) * power, (size, size))


def test_of_rough_relief_it_is_about_what_a_pixel_averages_away():
    fine = 8
    dense = rough(fine)
    means = dense.reshape(96, fine, 96, fine).mean(axis=(1, 3))
    half = fine // 2
    centres = (dense[half::fine, half::fine] + dense[half - 1 :: fine, half - 1 :: fine]) / 2
    error = np.sqrt(np.mean((means - centres) ** 2))
    stated = np.sqrt(np.mean(unresolved_variance(means, np.zeros(means.shape))))
    assert 0.7 * error < stated < 2.5 * error


def test_it_is_large_where_relief_is_rough_and_only_there():
    heights = np.zeros(SHAPE)
    heights[30:60] = np.random.default_rng(1).normal(0, 0.1, (30, SHAPE[1]))
    found = np.sqrt(unresolved_variance(heights, np.full(SHAPE, 0.001)))
    assert found[38:52].mean() > 0.08
    assert found[80:].max() < 1e-3


def test_holes_and_edges_are_no_relief():
    heights = np.full(SHAPE, 5.0)
    heights[40:60, 30:50] = np.nan
    found = unresolved_variance(heights, np.full(SHAPE, 0.01))
    assert np.isfinite(found).all()
    assert found.max() == 0


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1), (2, 2)])
def test_tiny_fields(shape):
    found = unresolved_variance(np.ones(shape), np.ones(shape))
    assert found.shape == shape
    assert (found == 0).all()
    assert (unresolved_variance(np.full(shape, np.nan), np.ones(shape)) == 0).all()
