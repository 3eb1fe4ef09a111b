"""The camera model against OpenCV's, and its own inverse."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pipeline.geometry.camera import Camera, Lens, distort, undistort
from pipeline.geometry.rigid import RigidTransform

K = np.array([[1200.0, 0, 650.2], [0, 1190.0, 500.7], [0, 0, 1]])
DISTORTION = np.array([-0.21, 0.11, 8e-4, -1.1e-3, -0.03])
ROTATION_VECTOR = np.array([0.2, -0.4, 1.1])
TRANSLATION = np.array([10.0, -25.0, 700.0])


@pytest.fixture(scope="module")
def camera() -> Camera:
    pose = RigidTransform(Rotation.from_rotvec(ROTATION_VECTOR).as_matrix(), TRANSLATION)
    return Camera(Lens((1280, 1024), K, DISTORTION), pose)


def test_projection_agrees_with_opencv(camera):
    points = np.random.default_rng(0).uniform(-150, 150, (200, 3))
    expected, _ = cv2.projectPoints(points, ROTATION_VECTOR, TRANSLATION, K, DISTORTION)
    np.testing.assert_allclose(camera.project(points), expected[:, 0], atol=1e-9)


def test_undistortion_agrees_with_opencv(camera):
    pixels = np.random.default_rng(1).uniform([0, 0], [1279, 1023], (200, 2))
    precise = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 200, 1e-14)
    expected = cv2.undistortPoints(pixels[:, None], K, DISTORTION, criteria=precise)[:, 0]
    directions = camera.lens.directions(pixels)
    np.testing.assert_allclose(directions[:, :2], expected, atol=1e-9)
    np.testing.assert_array_equal(directions[:, 2], 1.0)


@given(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(-0.25, 0.25), st.floats(-2e-3, 2e-3))
def test_undistortion_undoes_distortion(x, y, k1, p1):
    coefficients = np.array([k1, 0.05, p1, -p1 / 2, 0.01])
    point = np.array([x, y])
    np.testing.assert_allclose(
        undistort(distort(point, coefficients), coefficients), point, atol=1e-9
    )


def test_pixels_go_out_and_come_back(camera):
    pixels = camera.lens.pixel_grid()[::100, ::90]
    origin, directions = camera.rays(pixels)
    for depth in (0.5, 300.0, 1e5):
        points = origin + depth * directions
        np.testing.assert_allclose(camera.project(points), pixels, atol=1e-7)
        np.testing.assert_allclose(camera.depth(points), depth, rtol=1e-9)


def test_where_the_lens_cannot_see_there_is_no_direction():
    lens = Lens((100, 100), np.diag([100.0, 100, 1]), np.array([-0.5, 0, 0, 0, 0]))
    # r (1 - r^2 / 2) never exceeds 0.5443: no point of the world lies farther out.
    directions = lens.directions(np.array([[54.0, 0], [56.0, 0], [0, 500.0]]))
    assert np.isfinite(directions[0]).all()
    assert np.isnan(directions[1:, :2]).all()


def test_a_lens_without_distortion_is_a_pinhole():
    lens = Lens((640, 480), K)
    np.testing.assert_allclose(lens.project(np.array([0.1, 0.2, 2.0])), K[:2] @ [0.05, 0.1, 1])
    np.testing.assert_allclose(lens.directions(K[:2, 2]), [0, 0, 1], atol=1e-15)


def test_skew_is_kept_both_ways():
    skewed = K.copy()
    skewed[0, 1] = 3.5
    lens = Lens((640, 480), skewed, DISTORTION)
    point = np.array([0.2, -0.3, 1.0])
    np.testing.assert_allclose(lens.directions(lens.project(point)), point, atol=1e-9)


def test_the_centre_projects_from_nowhere(camera):
    np.testing.assert_allclose(camera.pose.apply(camera.centre_mm), 0, atol=1e-9)
    origin, _ = camera.rays(np.array([3.0, 4.0]))
    np.testing.assert_array_equal(origin, camera.centre_mm)


def test_the_pixel_grid_is_of_centres_and_row_major():
    grid = Lens((3, 2), np.eye(3)).pixel_grid()
    assert grid.shape == (2, 3, 2)
    np.testing.assert_array_equal(grid[1, 2], [2, 1])
