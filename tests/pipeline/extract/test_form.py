from __future__ import annotations

import numpy as np
import pytest

from pipeline.extract.form import find_form

SPACING = 0.5


def grid(rows=300, columns=400):
    """Give x, y of a canvas of 200 x 150 mm around its middle."""
    x = (np.arange(columns) - (columns - 1) / 2) * SPACING
    y = -(np.arange(rows) - (rows - 1) / 2) * SPACING
    return np.meshgrid(x, y)


def strokes(x, y, height=0.8):
    """Paint on a sixth of the canvas: straight ridges, all of them up."""
    return height * ((np.sin(x / 3 + np.sin(y / 11)) > 0.87) * 1.0)


FORMS = {
    "bulge": lambda x, y: 4 - 4 * (x / 100) ** 2 - 3 * (y / 75) ** 2,
    "twist": lambda x, y: 3 * x * y / 7500,
    "wave": lambda x, y: 2.5 * (x / 100) ** 3 - 2 * (x / 100) * (y / 75) ** 2,
    "pillow": lambda x, y: 5 * (1 - (x / 100) ** 2) * (1 - (y / 75) ** 2),
}


@pytest.mark.parametrize("name", FORMS)
def test_a_form_is_recovered_to_micrometres_under_noise(name):
    x, y = grid()
    true = FORMS[name](x, y)
    noise = np.random.default_rng(0).normal(0, 0.03, x.shape)
    found = find_form((true + noise).astype(np.float32), SPACING, 1.0)
    error = found.heights_mm - true
    assert np.abs(error).max() < 0.003
    assert 0.3 < np.sqrt(np.mean(error**2)) / found.sigma_mm < 3
    assert found.form.range_mm == pytest.approx(np.ptp(true), rel=0.01)


@pytest.mark.parametrize("name", FORMS)
def test_paint_on_one_side_does_not_bend_it(name):
    """A plain least-squares fit would rise by 0.13 mm, the mean of the paint."""
    x, y = grid()
    true, paint = FORMS[name](x, y), strokes(x, y)
    assert paint.mean() > 0.12
    noise = np.random.default_rng(1).normal(0, 0.02, x.shape)
    found = find_form((true + paint + noise).astype(np.float32), SPACING, 1.0)
    assert np.abs(found.heights_mm - true).max() < 0.02


def test_holes_and_a_ragged_edge_are_no_matter():
    x, y = grid()
    true = FORMS["bulge"](x, y)
    heights = np.where((np.hypot(x, y) < 70) & (np.hypot(x - 20, y) > 15), true, np.nan)
    found = find_form(heights.astype(np.float32), SPACING, 1.0)
    known = np.isfinite(heights)
    assert np.array_equal(np.isfinite(found.heights_mm), known)
    assert np.abs(found.heights_mm - true)[known].max() < 1e-4


def test_the_degree_is_as_low_as_will_do():
    x, y = grid()
    noise = np.random.default_rng(2).normal(0, 0.02, x.shape)
    degrees = {
        name: find_form((form(x, y) + noise).astype(np.float32), SPACING, 1.0).form.degree
        for name, form in FORMS.items()
    }
    assert degrees == {"bulge": 2, "twist": 2, "wave": 3, "pillow": 4}


def test_what_is_flat_or_relief_is_left_alone():
    x, y = grid()
    rng = np.random.default_rng(3)
    noise = rng.normal(0, 0.05, x.shape)
    assert "flat" in find_form(noise, SPACING, 1.0)
    assert "flat" in find_form(0.02 * (x**2 / 4000) + noise, SPACING, 1.0)
    assert "less than" in find_form(0.7 * (x / 100) ** 2 + strokes(x, y) + noise, SPACING, 1.0)
    assert "relief" in find_form(1.5 * (x / 100) ** 2 + 3 * np.sin(x / 6), SPACING, 1.0)
    assert "no stretched canvas" in find_form(
        30 * np.exp(-(x**2 + y**2) / 2500) + 12 * (x / 100) ** 2, SPACING, 1.0
    )
    assert isinstance(find_form(np.full((9, 9), np.nan), SPACING, 1.0), str)
    assert isinstance(find_form(np.array([[0.0, 5.0, 1.0]]), SPACING, 1.0), str)


def test_units_do_not_matter():
    x, y = grid(120, 160)
    true = 0.5 * FORMS["pillow"](2 * x, 2 * y)
    plain = find_form(true, SPACING, 1.0)
    for factor in (1e-3, 1e3):
        scaled = find_form(true * factor, SPACING * factor, factor)
        assert scaled.heights_mm / factor == pytest.approx(plain.heights_mm, rel=1e-5, abs=1e-5)
