"""The lobe's fit: known lobes, matte texels, noise, outliers, degenerate samples."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from pipeline.fit.lobe import fit_lobes

Array = NDArray[np.float64]


def directions(count: int, seed: int, steepest: float = 0.25) -> Array:
    """Draw unit vectors over the hemisphere, none flatter than ``steepest``."""
    rng = np.random.default_rng(seed)
    z = rng.uniform(steepest, 1.0, count)
    angle = rng.uniform(0, 2 * np.pi, count)
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=-1)


def near_mirror(view: Array, seed: int, spread: float) -> Array:
    """Draw lights about the mirror direction of each view, so that highlights are seen."""
    rng = np.random.default_rng(seed)
    light = view * (-1, -1, 1) + rng.normal(0, spread, view.shape)
    light[:, 2] = np.abs(light[:, 2]) + 0.05
    return light / np.linalg.norm(light, axis=1, keepdims=True)


def lafortune(view: Array, light: Array, rho_d: Array, rho_s: Array, c: tuple[float, ...]) -> Array:
    along = view[:, 2] * light[:, 2]
    across = view[:, 0] * light[:, 0] + view[:, 1] * light[:, 1]
    base = np.maximum(c[0] * across + c[1] * along, 0)
    return rho_d + rho_s * base[:, None] ** c[2]


def fit(values: Array, view: Array, light: Array, distance_mm: float = 900.0) -> Array:
    """Fit one texel at the origin that faces up; returns its nine parameters."""
    parameters, _, _, _ = fit_lobes(
        values.reshape(len(values), 1, 1, 3).astype(np.float32),
        np.zeros((1, 1, 3)),
        np.array([[[0, 0, 1]]], np.float32),
        view * distance_mm,
        light * distance_mm,
    )
    return parameters[0, 0].astype(np.float64)


def scene(seed: int = 3, count: int = 60, spread: float = 0.35) -> tuple[Array, Array]:
    view = directions(count, seed)
    light = np.where(
        (np.arange(count) % 2)[:, None] == 0,
        near_mirror(view, seed + 1, spread),
        directions(count, seed + 2),
    )
    return view, light


RHO_D = np.array([0.05, 0.1, 0.2])
RHO_S = np.array([0.3, 0.25, 0.2])


@pytest.mark.parametrize(
    ("p", "k"),
    [(-1.0, k) for k in (2.0, 8.0, 30.0, 80.0, 150.0)]
    # Off-mirror lobes have their peak at normal (-0.8) or grazing (-1.2) directions only; narrower
    # ones would not be observed by these samples.
    + [(-0.8, k) for k in (2.0, 8.0, 30.0)]
    + [(-1.2, k) for k in (2.0, 8.0, 30.0, 80.0)],
)
def test_a_noise_free_lobe_is_found_exactly(p: float, k: float) -> None:
    view, light = scene(count=120, spread=0.12)
    peak = max(1.0, abs(p))
    c = (p / peak, 1.0 / peak, k)
    found = fit(lafortune(view, light, RHO_D, RHO_S, c), view, light)
    np.testing.assert_allclose(found[:3], RHO_D, rtol=2e-3)
    np.testing.assert_allclose(found[3:6], RHO_S, rtol=5e-3)
    np.testing.assert_allclose(found[6:], c, rtol=5e-3)


def test_a_lobe_that_throws_light_back_is_found() -> None:
    view = directions(80, 5)
    light = np.where((np.arange(80) % 2)[:, None] == 0, view, directions(80, 6))
    found = fit(lafortune(view, light, RHO_D, RHO_S, (1.0, 0.9, 12.0)), view, light)
    np.testing.assert_allclose(found[6:], (1.0, 0.9, 12.0), rtol=0.02)


def test_noise_leaves_the_residual_at_its_floor() -> None:
    view, light = scene(count=200)
    clean = lafortune(view, light, RHO_D, RHO_S, (-1.0, 1.0, 25.0))
    noisy = clean * np.random.default_rng(9).normal(1, 0.01, clean.shape)
    found = fit(noisy, view, light)
    model = lafortune(view, light, found[:3], found[3:6], tuple(found[6:]))
    assert np.sqrt(np.mean((model - clean) ** 2)) < 0.35 * np.sqrt(np.mean((noisy - clean) ** 2))


def test_a_matte_texel_has_no_lobe() -> None:
    view, light = scene()
    noise = np.random.default_rng(2).normal(1, 0.01, (60, 1))
    found = fit(RHO_D * noise, view, light)
    assert found[3:].tolist() == [0, 0, 0, 0, 0, 1]
    np.testing.assert_allclose(found[:3], RHO_D, rtol=5e-3)


def test_outliers_do_not_move_the_lobe() -> None:
    view, light = scene(count=100)
    values = lafortune(view, light, RHO_D, RHO_S, (-1.0, 1.0, 20.0))
    values *= np.random.default_rng(4).normal(1, 0.005, values.shape)
    values[::12] *= 0.05  # cast shadows that were not found
    found = fit(values, view, light)
    np.testing.assert_allclose(found[:3], RHO_D, rtol=0.02)
    np.testing.assert_allclose(found[8], 20.0, rtol=0.1)


def test_a_highlight_that_nobody_saw_is_not_invented() -> None:
    view = directions(60, 1, steepest=0.8)
    light = directions(60, 2, steepest=0.8)
    far = np.linalg.norm(view * (-1, -1, 1) - light, axis=1) > 0.45
    values = lafortune(view[far], light[far], RHO_D, RHO_S, (-1.0, 1.0, 150.0))
    found = fit(values, view[far], light[far])
    assert found[3:6].max() == 0
    np.testing.assert_allclose(found[:3], RHO_D, rtol=0.02)


def test_a_dead_channel_stays_zero() -> None:
    view, light = scene()
    values = lafortune(view, light, RHO_D * (1, 0, 1), RHO_S * (1, 0, 1), (-1.0, 1.0, 15.0))
    found = fit(values, view, light)
    assert found[1] == pytest.approx(0, abs=1e-5)
    assert found[4] == pytest.approx(0, abs=1e-5)


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_the_scale_of_the_values_does_not_matter(scale: float) -> None:
    view, light = scene()
    values = lafortune(view, light, RHO_D, RHO_S, (-1.0, 1.0, 15.0))
    plain, scaled = fit(values, view, light), fit(values * scale, view, light)
    np.testing.assert_allclose(scaled[:6], plain[:6] * scale, rtol=1e-3)
    np.testing.assert_allclose(scaled[6:], plain[6:], rtol=1e-3)


def test_texels_without_samples_are_nan_and_few_samples_are_matte() -> None:
    view, light = scene(count=4)
    values = np.full((4, 1, 1, 3), np.nan, np.float32)
    geometry = (np.zeros((1, 1, 3)), np.array([[[0, 0, 1]]], np.float32), view, light)
    parameters, residual, count, observed = fit_lobes(values, *geometry)
    assert np.isnan(parameters).all()
    assert np.isnan(residual[0, 0])
    assert (count[0, 0], observed[0, 0]) == (0, False)
    values[:2] = 0.25
    parameters, _, count, _ = fit_lobes(values, *geometry)
    np.testing.assert_allclose(parameters[0, 0], [0.25] * 3 + [0] * 5 + [1], rtol=1e-6)
    assert count[0, 0] == 2


def test_samples_that_are_all_at_one_angle_give_a_matte_texel() -> None:
    view = np.tile([[0.3, 0.0, np.sqrt(0.91)]], (20, 1))
    found = fit(np.full((20, 3), 0.2), view, view)
    np.testing.assert_allclose(found[:6], [0.2] * 3 + [0] * 3, atol=1e-6)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 1000),
    count=st.integers(0, 40),
    size=st.sampled_from([0.0, 1e-8, 1.0, 1e8]),
    missing=st.floats(0, 1),
)
def test_whatever_the_samples_no_nan_leaves_the_fit(
    seed: int, count: int, size: float, missing: float
) -> None:
    rng = np.random.default_rng(seed)
    values = (rng.exponential(1.0, (count, 1, 1, 3)) * size).astype(np.float32)
    values[rng.random(count) < missing] = np.nan
    parameters, residual, used, _ = fit_lobes(
        values,
        np.zeros((1, 1, 3)),
        np.array([[[0, 0, 1]]], np.float32),
        directions(count, seed) * 700,
        directions(count, seed + 1) * 800,
    )
    if used[0, 0]:
        assert np.isfinite(parameters).all()
        assert np.isfinite(residual).all()
        assert (parameters[0, 0, :6] >= 0).all()
        assert 0.5 - 1e-6 <= parameters[0, 0, 8] <= 1000.5
        assert max(abs(parameters[0, 0, 6]), parameters[0, 0, 7]) <= 1 + 1e-6
    else:
        assert np.isnan(parameters).all()
