"""The parts of registration: derivatives, starts, refinement, the axis."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.geometry.camera import Lens
from pipeline.geometry.rigid import RigidTransform, rotation_about_axis
from pipeline.reflectance.axis_motion import axis_motion, moved_axis
from pipeline.reflectance.pnp import start_poses
from pipeline.reflectance.pose_refinement import refine
from pipeline.reflectance.projection import LENS, changed, lens_derivative, point_derivative
from pipeline.reflectance.reprojection import Known, State, View
from pipeline.reflectance.single_pose import DoesNotFitError, best_fit

CAMERA = Lens(
    (400, 300),
    np.array([[800.0, 0, 210], [0, 805, 140], [0, 0, 1]]),
    np.array([-0.1, 0.08, 1e-3, -5e-4, 0.02]),
)
POSE = RigidTransform(
    rotation_about_axis(np.zeros(3), np.array([1.0, 0.2, 0]), 150.0).rotation,
    np.array([5.0, -10.0, 900.0]),
)


def grid(relief_mm: float = 0.0, half_mm: float = 100.0, count: int = 20) -> np.ndarray:
    x, y = (a.ravel() for a in np.meshgrid(*2 * [np.linspace(-half_mm, half_mm, count)]))
    return np.stack([x, y, relief_mm * np.sin(x / 9) * np.cos(y / 7)], axis=1)


def seen(points: np.ndarray, noise_px: float = 0.0, pose: RigidTransform = POSE) -> np.ndarray:
    pixels = CAMERA.project(pose.apply(points))
    return pixels + np.random.default_rng(0).normal(0, noise_px, pixels.shape)


def test_the_derivative_by_the_point_is_that_of_the_projection() -> None:
    points = POSE.apply(grid(3.0))
    derivative = point_derivative(CAMERA, points)
    for axis in range(3):
        step = 1e-3 * np.eye(3)[axis]
        numeric = (CAMERA.project(points + step) - CAMERA.project(points - step)) / 2e-3
        np.testing.assert_allclose(derivative[..., axis], numeric, atol=1e-7)


def test_the_derivative_by_the_lens_is_that_of_the_projection() -> None:
    points = POSE.apply(grid(3.0))
    derivative = lens_derivative(CAMERA, points)
    for index in range(len(LENS)):
        step = 1e-4 * np.eye(len(LENS))[index]
        numeric = changed(CAMERA, step).project(points) - changed(CAMERA, -step).project(points)
        np.testing.assert_allclose(derivative[..., index], numeric / 2e-4, atol=1e-6)


@pytest.mark.parametrize("relief_mm", [0.0, 2.0])
@pytest.mark.parametrize("share_wrong", [0.0, 0.3, 0.5])
def test_a_start_is_near_the_pose_whatever_share_is_wrong(
    relief_mm: float, share_wrong: float
) -> None:
    points = grid(relief_mm)
    pixels = seen(points, 0.3)
    rng = np.random.default_rng(1)
    wrong = rng.random(len(pixels)) < share_wrong
    pixels[wrong] = rng.uniform(0, 300, (int(wrong.sum()), 2))
    starts = start_poses(points, pixels, CAMERA)
    nearest = min(np.linalg.norm(p.translation_mm - POSE.translation_mm) for p in starts)
    assert nearest < 15


def test_both_poses_of_a_plane_are_tried() -> None:
    starts = start_poses(grid(), seen(grid(), 0.1), CAMERA)
    normals = np.array([pose.rotation[:, 2] for pose in starts])
    assert (normals @ POSE.rotation[:, 2]).max() > 0.9999
    assert (normals @ POSE.rotation[:, 2]).min() < 0.99


@pytest.mark.parametrize(
    "points",
    [np.zeros((0, 3)), grid(count=4), np.full((50, 3), np.nan), np.zeros((50, 3))],
    ids=["none", "few", "nan", "one place"],
)
def test_degenerate_points_give_no_start_or_no_nan(points: np.ndarray) -> None:
    for pose in start_poses(points, np.full((len(points), 2), 150.0), CAMERA):
        assert np.isfinite(pose.matrix).all()


def test_points_on_one_line_do_not_fail() -> None:
    points = np.stack([np.linspace(-90, 90, 200), np.zeros(200), np.zeros(200)], axis=1)
    for pose in start_poses(points, seen(points, 0.1), CAMERA):
        assert np.isfinite(pose.matrix).all()


@settings(max_examples=15, deadline=None)
@given(
    turn=st.tuples(*[st.floats(-0.1, 0.1)] * 3),
    shift=st.tuples(*[st.floats(-30, 30)] * 3),
    scale=st.sampled_from([1e-3, 1.0, 1e3]),
)
def test_refinement_comes_back_from_a_wrong_start_in_any_unit(
    turn: tuple[float, float, float], shift: tuple[float, float, float], scale: float
) -> None:
    points = scale * grid(2.0)
    true = RigidTransform(POSE.rotation, scale * POSE.translation_mm)
    angle = np.degrees(np.linalg.norm(turn))
    off = rotation_about_axis(np.zeros(3), np.add(turn, (0, 0, 1e-12)), angle).rotation
    start = RigidTransform(off @ true.rotation, true.translation_mm + scale * np.array(shift))
    view = View("C", points, seen(points, 0, true), np.full(len(points), 0.1))
    fit = refine([view], State((start,), {"C": CAMERA}))
    found = fit.state.poses[0]
    assert np.linalg.norm(found.translation_mm - true.translation_mm) < 1e-4 * scale
    assert np.isfinite(fit.covariance).all()


def test_stated_deviations_are_those_of_repeated_noise() -> None:
    points = grid(2.0)
    clean, sigma = seen(points), np.full(len(points), 1.0)
    rng = np.random.default_rng(5)
    errors, stated = [], []
    for _ in range(40):
        pixels = clean + rng.normal(0, 0.1, clean.shape)
        fit = refine([View("C", points, pixels, sigma)], State((POSE,), {"C": CAMERA}))
        errors.append(fit.state.poses[0].translation_mm - POSE.translation_mm)
        stated.append(np.diag(fit.covariance)[3:])
    # The camera's shift is that of the translation, its turn being small: sigma_z above all.
    ratio = np.std([e[2] for e in errors]) / np.sqrt(np.mean([s[2] for s in stated]))
    assert 0.7 < ratio < 1.4
    assert fit.widths[0] == pytest.approx(0.1, rel=0.15)


def test_what_is_known_of_a_lens_holds_it_where_the_views_say_nothing() -> None:
    points = grid(half_mm=4.0)  # a few pixels wide
    view = View("C", points, seen(points, 0.05), np.full(len(points), 0.05))
    sigma = np.array([0.5, 0.5, 1.0, 1.0, 0.01, 0.1, 1e-3, 1e-3])
    fit = refine([view], State((POSE,), {"C": CAMERA}), Known({"C": sigma}))
    lens = fit.state.lenses["C"]
    assert np.abs(lens.K - CAMERA.K).max() < 0.5
    assert np.abs(lens.distortion - CAMERA.distortion).max() < 0.02


def test_points_behind_the_camera_do_not_count() -> None:
    points = np.concatenate([grid(2.0), POSE.inverse().apply(np.array([[0.0, 0, -50]]))])
    pixels = np.concatenate([seen(grid(2.0)), [[200.0, 150.0]]])
    view = View("C", points, pixels, np.full(len(points), 0.1))
    fit = refine([view], State((POSE,), {"C": CAMERA}))
    np.testing.assert_allclose(fit.state.poses[0].matrix, POSE.matrix, atol=1e-6)
    assert fit.weights[0][-1] < 1e-6


def test_two_poses_that_fit_alike_are_refused() -> None:
    points = grid(half_mm=2.0)  # so small that perspective shows nothing
    pixels = seen(points, 0.3)
    view = View("C", points, pixels, np.full(len(points), 0.3))
    with pytest.raises(DoesNotFitError, match="two poses"):
        best_fit(view, CAMERA, start_poses(points, pixels, CAMERA))


def test_a_plane_seen_with_perspective_has_one_pose() -> None:
    pixels = seen(grid(), 0.1)
    view = View("C", grid(), pixels, np.full(len(pixels), 0.1))
    fit = best_fit(view, CAMERA, start_poses(grid(), pixels, CAMERA))
    assert np.linalg.norm(fit.state.poses[0].translation_mm - POSE.translation_mm) < 0.5


def test_no_start_is_a_reason() -> None:
    view = View("C", grid(), seen(grid()), np.ones(400))
    with pytest.raises(DoesNotFitError, match="no pose"):
        best_fit(view, CAMERA, [])


def test_points_move_with_the_axis_along_their_rays() -> None:
    """A plane turned about an axis: where a ray meets it before and after the axis moves."""
    point, direction, angle = np.array([10.0, 0, 0]), np.array([0.05, 0.02, 1.0]), 40.0
    origin = np.array([[-300.0, 50, 800]])
    rays = np.array([[0.3, 0, -0.8], [0.4, 0.1, -0.9], [0.2, -0.2, -0.7]])

    def meet(axis_point: np.ndarray, axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        table = rotation_about_axis(axis_point, axis, angle)
        normal = table.rotate(np.array([0.1, 0.0, 1.0]))
        anchor = table.apply(np.array([0.0, 0, 5]))
        t = (anchor - origin) @ normal / (rays @ normal)
        return origin + t[:, None] * rays, np.broadcast_to(normal, rays.shape)

    points, normal = meet(point, direction)
    motion = axis_motion(points, normal, rays, point, direction, angle)
    for index in range(4):
        step = 1e-4 * np.eye(4)[index]
        numeric = (meet(*moved_axis(point, direction, step))[0] - points) / 1e-4
        np.testing.assert_allclose(motion[..., index], numeric, atol=2e-2, rtol=1e-3)
