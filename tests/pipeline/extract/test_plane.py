from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.errors import ImpastoError
from pipeline.extract.plane import canvas_axes, facing, fit_plane
from pipeline.geometry.camera import Camera, Lens
from pipeline.geometry.rigid import RigidTransform, rotation_about_axis

CAMERA = Camera(Lens((100, 80), np.array([[90.0, 0, 50], [0, 90, 40], [0, 0, 1]])))


def slab(rng: np.random.Generator, normal: np.ndarray, noise: float) -> np.ndarray:
    basis = np.linalg.svd(normal[None])[2][1:]
    xy = rng.uniform(-50, 50, (4000, 2))
    return xy @ basis + noise * rng.standard_normal((4000, 1)) * normal + [0, 0, 500.0]


def test_a_plane_is_found_exactly() -> None:
    normal = np.array([0.2, -0.3, -0.9])
    normal /= np.linalg.norm(normal)
    points = slab(np.random.default_rng(0), normal, 0.0)
    plane = fit_plane(points, np.ones(len(points)))
    assert abs(plane.normal @ normal) == pytest.approx(1, abs=1e-12)
    assert plane.heights(points) == pytest.approx(0, abs=1e-9)


def test_high_relief_on_a_fifth_pulls_little() -> None:
    points = slab(np.random.default_rng(1), np.array([0, 0, -1.0]), 0.02)
    raised = (points[:, 0] > 0) & (np.abs(points[:, 1]) < 20)
    points[raised, 2] -= 3.0  # out of the paint, on one side
    plane = fit_plane(points, np.ones(len(points)))
    least_squares = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][2]
    assert np.degrees(np.arccos(abs(plane.normal[2]))) < 0.1
    assert np.degrees(np.arccos(abs(least_squares[2]))) > 0.3  # so the test can fail


@given(
    st.floats(-180, 180),
    st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda a: np.linalg.norm(a) > 0.1),
    st.tuples(*[st.floats(-1e4, 1e4)] * 3),
)
def test_turning_the_scene_turns_the_frame(
    angle: float, axis: tuple[float, float, float], shift: tuple[float, float, float]
) -> None:
    points = slab(np.random.default_rng(2), np.array([0.3, 0.2, -0.93]), 0.1)
    weights = np.ones(len(points))
    move = RigidTransform(np.eye(3), np.array(shift)) @ rotation_about_axis(
        np.zeros(3), np.array(axis), angle
    )
    moved = Camera(CAMERA.lens, CAMERA.pose @ move.inverse())
    first = canvas_axes(facing(fit_plane(points, weights), CAMERA.centre_mm), CAMERA)
    plane = facing(fit_plane(move.apply(points), weights), moved.centre_mm)
    second = canvas_axes(plane, moved)
    assert second.rotation == pytest.approx((move @ first).rotation, abs=1e-6)
    assert second.translation_mm == pytest.approx((move @ first).translation_mm, abs=1e-4)


def test_axes_face_the_camera_with_the_pictures_up() -> None:
    points = slab(np.random.default_rng(3), np.array([0, 0, 1.0]), 0.1)
    frame = canvas_axes(facing(fit_plane(points, np.ones(len(points))), np.zeros(3)), CAMERA)
    assert frame.rotation == pytest.approx(np.diag([1.0, -1, -1]), abs=2e-3)
    assert np.linalg.det(frame.rotation) == pytest.approx(1)


def test_a_plane_seen_edge_on_still_has_axes() -> None:
    points = slab(np.random.default_rng(4), np.array([0, 1.0, 0]), 0.0)
    frame = canvas_axes(fit_plane(points, np.ones(len(points))), CAMERA)
    assert frame.rotation @ frame.rotation.T == pytest.approx(np.eye(3), abs=1e-12)


@pytest.mark.parametrize(
    "points", [np.zeros((2, 3)), np.outer(np.arange(50.0), [1, 2, 3]), np.zeros((9, 3))]
)
def test_too_little_to_fit_is_said(points: np.ndarray) -> None:
    with pytest.raises(ImpastoError, match="points"):
        fit_plane(points, np.ones(len(points)))
