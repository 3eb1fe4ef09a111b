from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from pipeline.structured_light.footprint import (
    edge_shift,
    local_slope,
    log_gradient,
    spread_variance,
)

SPREAD = 0.5


def watched(albedo_fine, slope=1.3, fine=12):
    """The light and the coordinate that pixels of Gaussian spread gather from a fine albedo."""
    rows, columns = albedo_fine.shape
    x = slope * (np.arange(columns) - (fine - 1) / 2) / fine
    weight = gaussian_filter(albedo_fine, SPREAD * fine, mode="nearest")
    moment = gaussian_filter(albedo_fine * x[None, :], SPREAD * fine, mode="nearest")
    pick = slice(fine // 2, None, fine)
    true = np.broadcast_to(slope * np.arange(columns // fine), (rows // fine, columns // fine))
    at = 0.5 / fine * slope  # the sample nearest to a pixel's centre lies half a fine step off
    return weight[pick, pick], (moment / weight)[pick, pick] - at, true


@pytest.mark.parametrize(("ratio", "left"), [(1.5, 0.25), (4.0, 0.5)])
def test_the_shift_at_albedo_edges_is_mostly_removed(ratio, left):
    fine = 12
    v, u = np.mgrid[0 : 24 * fine, 0 : 40 * fine] / fine
    albedo = np.where(u + 0.3 * v > 22, ratio, 1.0)
    light, coordinate, true = watched(albedo)
    shift = edge_shift(coordinate.astype(np.float32), log_gradient(light.astype(np.float32)))
    inside = np.s_[3:-3, 3:-3]
    before = (coordinate - true)[inside]
    after = (coordinate - SPREAD**2 * shift.expected - true)[inside]
    assert np.sqrt(np.mean(after**2)) < left * np.sqrt(np.mean(before**2))


def test_the_spread_is_found_from_the_residual():
    rng = np.random.default_rng(1)
    expected = rng.standard_normal((100, 100))
    across = 0.3 * expected + 0.05 * rng.standard_normal((100, 100))
    across[::7, ::5] += 5.0
    assert spread_variance(across, expected) == pytest.approx(0.3, abs=0.02)
    assert spread_variance(np.full((100, 100), np.nan), expected) is None
    assert spread_variance(across, 0.01 * expected) is None
    assert spread_variance(-across, expected) == 0.0


def test_slopes_of_a_plane_with_holes():
    v, u = np.mgrid[0:30, 0:40].astype(np.float32)
    image = 1000 + 0.7 * u - 0.2 * v
    image[10:13, 10:20] = np.nan
    along_x, along_y = local_slope(image)
    assert np.allclose(along_x, 0.7, atol=1e-3)
    assert np.allclose(along_y, -0.2, atol=1e-3)


def test_light_that_is_not_known_shifts_nothing():
    light = np.full((20, 20), np.nan, np.float32)
    gradient = log_gradient(light)
    assert not np.any(gradient)
    u = np.tile(np.arange(20, dtype=np.float32), (20, 1))
    assert not np.any(edge_shift(u, gradient).expected)
    dark = log_gradient(np.zeros((20, 20), np.float32))
    assert np.isfinite(dark).all()
