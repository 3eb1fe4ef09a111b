from __future__ import annotations

import numpy as np
import pytest

from pipeline.formats.capture import CameraEntry
from pipeline.structured_light.noise import excess, fit_noise, median_of_chi2, noise_model


def test_the_median_of_chi_square():
    rng = np.random.default_rng(0)
    for freedom in (1, 3, 9):
        drawn = rng.chisquare(freedom, 200_000) / freedom
        assert median_of_chi2(freedom) == pytest.approx(np.median(drawn), rel=0.04)


@pytest.mark.parametrize(("shot", "floor"), [(5e-5, 1e-7), (1e-4, 0.0), (0.0, 3e-6)])
def test_noise_is_found_from_residuals(shot, floor):
    rng = np.random.default_rng(1)
    level = np.exp(rng.uniform(np.log(0.005), np.log(0.9), 60_000))
    variance = (shot * level + floor) * rng.chisquare(5, level.size) / 5
    variance[::50] = 1.0  # what moved
    found = fit_noise(level, variance, 5)
    for v in (0.01, 0.1, 0.8):
        assert found.shot * v + found.floor == pytest.approx(shot * v + floor, rel=0.1)


def test_too_little_to_tell():
    assert fit_noise(np.full(10, 0.5), np.full(10, 1e-4), 3) is None
    assert fit_noise(np.full(5000, 0.5), np.zeros(5000), 3) is None
    assert excess(np.full(5, np.nan), 3) == 1.0


def test_the_bundle_says_what_the_sensor_is():
    given = noise_model(CameraEntry(size_px=(4, 4), full_well_e=10000, read_noise_e=5, bits=12), 16)
    assert given.given
    assert given.shot == pytest.approx(1e-4)
    assert given.floor == pytest.approx((5 / 10000) ** 2 + 1 / (12 * 4095**2))
    assert not noise_model(CameraEntry(size_px=(4, 4)), 8).given
