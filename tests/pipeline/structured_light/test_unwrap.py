from __future__ import annotations

import numpy as np
import pytest

from pipeline.structured_light.unwrap import (
    refine,
    repair_jumps,
    unwrap_by_cells,
    unwrap_by_periods,
    wrapped_coordinate,
)


def wrapped(x, period):
    phase = np.angle(np.exp(2j * np.pi * (x + 0.5) / period))
    return wrapped_coordinate(phase.astype(np.float32), period)


X = np.linspace(0, 255, 1000).reshape(10, 100)


@pytest.mark.parametrize(("cell", "period"), [(8, 16), (16, 16), (10, 24), (30, 60), (8, 256)])
def test_cells_choose_the_period(cell, period):
    index = np.floor((X + 0.5) / cell).astype(np.int32)
    sure = np.ones_like(X, dtype=np.float32)
    found, away = unwrap_by_cells(wrapped(X, period), period, index, sure, index, cell, 256)
    inside = np.abs(X - (index * cell + (cell - 1) / 2)) < cell / 2 - 1e-3
    assert np.allclose(found[inside], X[inside], atol=1e-4)
    assert away[inside].max() <= cell / 2


def test_a_wrong_cell_at_its_own_border_is_mended_by_the_doubt():
    cell, period = 16, 16
    x = np.array([[31.6, 31.2, 47.45]])
    right = np.floor((x + 0.5) / cell).astype(np.int32)
    wrong = right + np.array([[-1, 1, 1]], np.int32)
    found, _ = unwrap_by_cells(
        wrapped(x, period), period, wrong, np.full(x.shape, 0.1, np.float32), right, cell, 256
    )
    assert np.allclose(found, x, atol=1e-4)


@pytest.mark.parametrize("periods", [(17.0, 19.0, 23.0), (16.0, 64.0, 256.0), (13.7, 200.3, 300.0)])
def test_periods_together_tell_the_coordinate(periods):
    rng = np.random.default_rng(2)
    spread = np.array([0.002 * p for p in periods])
    stack = np.stack([wrapped(X + s * rng.standard_normal(X.shape), p)
                      for p, s in zip(periods, spread, strict=True)])  # fmt: skip
    sigma = np.broadcast_to(spread[:, None, None], stack.shape).astype(np.float32).copy()
    found, error = unwrap_by_periods(stack, sigma, np.array(periods), 256)
    known = np.isfinite(found)
    assert known.mean() > 0.97
    normalised = ((found - X) / error)[known]
    assert np.abs(normalised).max() < 6
    assert 0.85 < np.mean(normalised**2) < 1.15


def test_periods_that_contradict_each_other_are_left_out():
    noise = np.random.default_rng(3).uniform(0, 23, (3, 10, 100)).astype(np.float32)
    sigma = np.full(noise.shape, 0.1, np.float32)
    found, _ = unwrap_by_periods(noise, sigma, np.array([17.0, 19.0, 23.0]), 256)
    assert np.isnan(found).mean() > 0.8
    noise[1] = np.nan
    found, _ = unwrap_by_periods(noise, sigma, np.array([17.0, 19.0, 23.0]), 256)
    assert np.isnan(found).all()


def test_a_shorter_period_refines_a_longer_one():
    rng = np.random.default_rng(4)
    coarse = (X + 0.3 * rng.standard_normal(X.shape)).astype(np.float32)
    fine = wrapped(X + 0.05 * rng.standard_normal(X.shape), 10.0)
    found, sigma = refine(coarse, np.full(X.shape, 0.3, np.float32), fine,
                          np.full(X.shape, 0.05, np.float32), 10.0)  # fmt: skip
    assert np.std(found - X) == pytest.approx(0.05, rel=0.1)
    assert np.allclose(sigma, 1 / np.hypot(1 / 0.3, 1 / 0.05), rtol=1e-3)
    unsure = np.full(X.shape, 3.0, np.float32)
    kept, sigma = refine(coarse, unsure, fine, np.full(X.shape, 0.05, np.float32), 10.0)
    assert np.array_equal(kept, coarse)
    assert np.array_equal(sigma, unsure)


def test_lone_jumps_are_repaired_and_counted_whatever_the_slope():
    v, u = np.mgrid[0:40, 0:50].astype(np.float32)
    surface = 3.1 * u + 0.4 * v
    broken = surface.copy()
    broken[10, 20] += 16
    broken[30, 5] -= 32
    broken[0, 25] += 3.0  # no whole period: left as it is
    repaired, count = repair_jumps(broken, 16.0)
    assert count == 2
    surface[0, 25] += 3.0
    assert np.allclose(repaired, surface)


def test_a_step_of_the_surface_is_no_jump():
    surface = np.zeros((40, 40), np.float32)
    surface[:, 20:] = 16.0
    surface[5, 5] = np.nan
    repaired, count = repair_jumps(surface, 16.0)
    assert count == 0
    assert np.array_equal(repaired, surface, equal_nan=True)
