"""The CPU's shading function: known values of the lobe, symmetry, and agreement of the frames."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from renderers.shading import reflectance, unit_normals

DIFFUSE, SPECULAR = np.array([0.1, 0.2, 0.3]), np.array([0.5, 0.4, 0.0])
MIRROR = np.array([-1.0, 1.0, 30.0])  # C_xy, C_z, k: peaks where the eye sees the lamp's mirror
UP = np.array([0.0, 0.0, 1.0])

angles = st.floats(0, 1.5)
turns = st.floats(-np.pi, np.pi)


def towards(polar: float, azimuth: float) -> np.ndarray:
    sine = np.sin(polar)
    return np.array([sine * np.cos(azimuth), sine * np.sin(azimuth), np.cos(polar)])


@pytest.mark.parametrize("polar", [0.0, 0.4, 1.2, 1.57])
def test_lobe_peaks_with_rho_s_in_the_mirror_direction(polar):
    to_light, to_eye = towards(polar, 0.7), towards(polar, 0.7 + np.pi)
    f = reflectance(DIFFUSE, SPECULAR, MIRROR, UP, to_eye, to_light)
    np.testing.assert_allclose(f, DIFFUSE + SPECULAR, rtol=1e-12)


@pytest.mark.parametrize("off", [0.05, 0.2, 0.5])
def test_off_the_mirror_direction_the_lobe_is_cosine_to_the_k(off):
    to_light, to_eye = towards(0.3, 0.0), towards(0.3 + off, np.pi)
    f = reflectance(DIFFUSE, SPECULAR, MIRROR, UP, to_eye, to_light)
    np.testing.assert_allclose(f, DIFFUSE + SPECULAR * np.cos(off) ** 30, rtol=1e-12)


def test_behind_the_lobe_only_the_diffuse_part_is_left():
    to_light = to_eye = towards(1.2, 0.0)  # the base is cos^2 - sin^2 < 0: no power of it
    f = reflectance(DIFFUSE, SPECULAR, np.array([-1.0, 1.0, 2.5]), UP, to_eye, to_light)
    np.testing.assert_array_equal(f, DIFFUSE)


def test_a_lobe_of_zeros_outside_the_canvas_is_dark():
    f = reflectance(np.zeros(3), np.zeros(3), np.zeros(3), UP, UP, UP)
    np.testing.assert_array_equal(f, 0)


@given(angles, turns, angles, turns)
def test_reciprocal_and_never_darker_than_diffuse(a, b, c, d):
    v, l = towards(a, b), towards(c, d)  # noqa: E741
    there = reflectance(DIFFUSE, SPECULAR, np.array([-0.8, 1.1, 7.0]), UP, v, l)
    back = reflectance(DIFFUSE, SPECULAR, np.array([-0.8, 1.1, 7.0]), UP, l, v)
    np.testing.assert_allclose(there, back, rtol=1e-9)
    assert (there >= DIFFUSE).all()


@given(angles, turns, angles, turns, st.floats(0, 1.4), turns)
def test_turning_everything_together_changes_nothing(a, b, c, d, tilt, turn):
    ca, sa, cb, sb = np.cos(tilt), np.sin(tilt), np.cos(turn), np.sin(turn)
    R = np.array([[cb, -sb, 0], [sb, cb, 0], [0, 0, 1]]) @ np.array(
        [[ca, 0, sa], [0, 1, 0], [-sa, 0, ca]]
    )
    v, l = towards(a, b), towards(c, d)  # noqa: E741
    lobe = np.array([-0.8, 1.1, 7.0])
    upright = reflectance(DIFFUSE, SPECULAR, lobe, UP, v, l)
    turned = reflectance(DIFFUSE, SPECULAR, lobe, R @ UP, R @ v, R @ l)
    np.testing.assert_allclose(turned, upright, rtol=1e-9)


def test_arrays_are_shaded_texel_by_texel():
    rng = np.random.default_rng(0)
    n, v, l = (unit_normals(rng.uniform(-0.5, 0.5, (4, 5, 2))) for _ in range(3))  # noqa: E741
    d, s = rng.uniform(0, 1, (2, 4, 5, 3))
    lobe = np.broadcast_to(MIRROR, (4, 5, 3))
    f = reflectance(d, s, lobe, n, v, l)
    one = reflectance(d[2, 3], s[2, 3], MIRROR, n[2, 3], v[2, 3], l[2, 3])
    assert f.shape == (4, 5, 3)
    np.testing.assert_allclose(f[2, 3], one, rtol=1e-12)


def test_unit_normals_are_rebuilt():
    normals = unit_normals(np.array([[0.0, 0.0], [0.6, 0.0], [0.0, -0.8]], np.float32))
    np.testing.assert_allclose(normals, [[0, 0, 1], [0.6, 0, 0.8], [0, -0.8, 0.6]], atol=1e-7)
    assert normals.dtype == np.float64


def test_normals_too_long_by_rounding_stay_unit_and_upward():
    normals = unit_normals(np.array([[1.0, 0.01], [0.9, 0.9]]))
    np.testing.assert_allclose(np.linalg.norm(normals, axis=-1), 1, rtol=1e-12)
    assert (normals[:, 2] > 0).all()
