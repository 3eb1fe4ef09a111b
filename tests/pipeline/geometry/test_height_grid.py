"""Normals of surfaces with known normals; sampling of functions that are bilinear."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.geometry.height_grid import normals, sample_bilinear


def grid(rows, columns, spacing):
    """Return x, y of the samples, mm; y goes up."""
    return np.meshgrid(np.arange(columns) * spacing, -np.arange(rows) * spacing)


@settings(deadline=None)  # the first call compiles
@given(st.floats(-3, 3), st.floats(-3, 3), st.sampled_from([0.01, 0.35, 20.0]))
def test_a_plane_has_its_own_normal_everywhere(slope_x, slope_y, spacing):
    x, y = grid(6, 5, spacing)
    n = normals(slope_x * x + slope_y * y + 2, spacing)
    expected = np.array([-slope_x, -slope_y, 1]) / np.sqrt(1 + slope_x**2 + slope_y**2)
    np.testing.assert_allclose(n, np.broadcast_to(expected, n.shape), atol=3e-6)
    assert n.dtype == np.float32


def test_a_sphere_has_radial_normals():
    spacing, radius = 0.1, 30.0
    x, y = grid(81, 121, spacing)
    x, y = x - x.mean(), y - y.mean()
    z = np.sqrt(radius**2 - x**2 - y**2)
    inner = np.s_[1:-1, 1:-1]
    expected = np.stack([x, y, z], axis=-1)[inner] / radius
    np.testing.assert_allclose(normals(z, spacing)[inner], expected, atol=2e-6)


def test_missing_heights_have_no_normal_and_do_not_tilt_their_neighbours():
    x, y = grid(7, 7, 0.5)
    heights = 0.3 * x - 0.2 * y
    heights[3, 3] = np.nan
    heights[0, :] = np.nan
    n = normals(heights, 0.5)
    assert np.isnan(n[3, 3]).all()
    assert np.isnan(n[0]).all()
    expected = np.array([-0.3, 0.2, 1]) / np.sqrt(1.13)
    known = np.isfinite(heights)
    np.testing.assert_allclose(n[known], np.tile(expected, (known.sum(), 1)), atol=1e-6)


@pytest.mark.parametrize("shape", [(1, 1), (1, 6), (6, 1), (2, 2)])
def test_small_fields_have_normals(shape):
    np.testing.assert_array_equal(normals(np.full(shape, 4.0), 0.5)[..., 2], 1.0)


def test_a_row_slopes_along_itself_only():
    n = normals(np.array([[0.0, 1.0, 2.0]]), 1.0)
    np.testing.assert_allclose(n[0], np.tile([-np.sqrt(0.5), 0, np.sqrt(0.5)], (3, 1)), atol=1e-6)


def test_a_lonely_sample_is_level():
    heights = np.full((3, 3), np.nan)
    heights[1, 1] = 7.0
    np.testing.assert_array_equal(normals(heights, 1.0)[1, 1], [0, 0, 1])


@settings(deadline=None)  # the first call compiles
@given(st.floats(0, 6), st.floats(0, 4))
def test_sampling_reproduces_bilinear_functions(column, row):
    rows, columns = np.mgrid[:5, :7].astype(float)
    image = 1 + 2 * columns - 3 * rows + 0.5 * rows * columns
    got = sample_bilinear(image, np.array([column]), np.array([row]))
    assert got[0] == pytest.approx(1 + 2 * column - 3 * row + 0.5 * row * column, abs=1e-12)


def test_sampling_keeps_channels_and_precision():
    image = np.random.default_rng(0).random((4, 5, 3)).astype(np.float32)
    places = np.array([[0.0, 2.0], [4.0, 1.5]]), np.array([[0.0, 3.0], [3.0, 0.5]])
    got = sample_bilinear(image, *places)
    assert got.shape == (2, 2, 3)
    assert got.dtype == np.float32
    np.testing.assert_array_equal(got[0, 0], image[0, 0])
    np.testing.assert_array_equal(got[1, 0], image[3, 4])


@pytest.mark.parametrize("place", [(-1e-9, 0), (0, -0.1), (4.001, 0), (0, 3.5), (np.nan, 0)])
def test_outside_is_nan(place):
    image = np.ones((4, 5))
    assert np.isnan(sample_bilinear(image, np.array([place[0]]), np.array([place[1]]))[0])


def test_nan_spreads_as_far_as_its_weight():
    image = np.ones((4, 4))
    image[1, 1] = np.nan
    columns, rows = np.array([2.0, 1.5, 0.0, 0.5, 1.0]), np.array([1.0, 1.0, 1.5, 0.0, 2.0])
    missing = np.isnan(sample_bilinear(image, columns, rows))
    np.testing.assert_array_equal(missing, [False, True, False, False, False])
