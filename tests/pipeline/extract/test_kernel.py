"""The kernel's width follows from noise and relief."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.extract.kernel import widest_kernel
from pipeline.extract.resample import Grid, grid_around, resample


def scattered(noise_mm, wavelength_mm, amplitude_mm=0.5, seed=1):
    """Points 1 mm apart over a relief of one wavelength."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:90, :110] + rng.uniform(-0.3, 0.3, (2, 90, 110))
    height = amplitude_mm * np.sin(2 * np.pi * (x + 0.4 * y) / wavelength_mm)
    points = np.stack([x, y, height + noise_mm * rng.normal(size=x.shape)], axis=-1)
    return points.reshape(-1, 3), np.full(x.size, noise_mm), height


@pytest.mark.parametrize(
    ("noise", "wavelength", "wider"),
    [(0.3, 60.0, 2.0), (0.01, 6.0, 1.0), (0.02, 10.0, 1.0), (0.3, 6.0, 1.0), (0.05, 200.0, 2.0)],
)
def test_noise_widens_and_relief_holds(noise, wavelength, wider):
    points, sigma, _ = scattered(noise, wavelength)
    grid = grid_around(points[:, :2], 1.0)
    assert widest_kernel(points, sigma, grid, 0.75) == pytest.approx(0.75 * wider)


@pytest.mark.parametrize("wavelength", [8.0, 14.0, 25.0, 60.0])
@pytest.mark.parametrize("noise", [0.02, 0.1, 0.4])
def test_it_never_costs_accuracy(noise, wavelength):
    points, sigma, _ = scattered(noise, wavelength)
    grid = Grid(8.0, 80.0, 71, 91, 1.0)
    x, y = np.meshgrid(8.0 + np.arange(91), 80.0 - np.arange(71))
    true = 0.5 * np.sin(2 * np.pi * (x + 0.4 * y) / wavelength)
    errors = [
        np.sqrt(np.mean((resample(points, sigma, grid, kernel)[0] - true) ** 2))
        for kernel in (0.75, widest_kernel(points, sigma, grid, 0.75))
    ]
    assert errors[1] <= 1.05 * errors[0]


def test_too_few_samples_stay_with_what_is_given():
    points, sigma, _ = scattered(0.3, 60.0)
    assert widest_kernel(points, sigma, Grid(20.0, 40.0, 9, 9, 1.0), 0.75) == 0.75
