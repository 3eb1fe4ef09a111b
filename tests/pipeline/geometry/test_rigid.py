"""Rigid transforms: the group, rotations about an axis, alignment."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pipeline.geometry.rigid import RigidTransform, align_rigidly, rotation_about_axis

vectors = st.tuples(*[st.floats(-1e3, 1e3)] * 3).map(np.array)
rotation_vectors = st.tuples(*[st.floats(-3, 3)] * 3).map(np.array)
transforms = st.builds(
    lambda turn, move: RigidTransform(Rotation.from_rotvec(turn).as_matrix(), move),
    rotation_vectors,
    vectors,
)


def test_the_default_is_the_identity():
    point = np.array([1.0, 2.0, 3.0])
    np.testing.assert_array_equal(RigidTransform().apply(point), point)
    np.testing.assert_array_equal(RigidTransform().matrix, np.eye(4))


@given(transforms, vectors)
def test_inverse_undoes(transform, point):
    np.testing.assert_allclose(transform.inverse().apply(transform.apply(point)), point, atol=1e-9)


@given(transforms, transforms, vectors)
def test_composition_applies_the_right_one_first(a, b, point):
    np.testing.assert_allclose((a @ b).apply(point), a.apply(b.apply(point)), atol=1e-9)
    np.testing.assert_allclose((a @ b).matrix, a.matrix @ b.matrix, atol=1e-9)


@given(transforms, vectors)
def test_the_matrix_says_the_same(transform, point):
    again = RigidTransform.from_matrix(transform.matrix)
    np.testing.assert_array_equal(again.rotation, transform.rotation)
    homogeneous = transform.matrix @ np.append(point, 1)
    np.testing.assert_allclose(homogeneous[:3], transform.apply(point), atol=1e-9)


@given(transforms, vectors)
def test_directions_turn_but_do_not_move(transform, way):
    turned = transform.rotate(way)
    np.testing.assert_allclose(turned, transform.apply(way) - transform.apply(0 * way), atol=1e-9)
    assert np.linalg.norm(turned) == pytest.approx(np.linalg.norm(way), abs=1e-9)


def test_any_leading_shape_is_kept():
    points = np.random.default_rng(0).random((2, 5, 3))
    transform = RigidTransform(Rotation.from_rotvec([0.1, 0.2, 0.3]).as_matrix(), np.ones(3))
    assert transform.apply(points).shape == (2, 5, 3)
    np.testing.assert_allclose(transform.apply(points)[1, 2], transform.apply(points[1, 2]))


def test_a_turn_is_counter_clockwise_about_its_axis():
    turn = rotation_about_axis(np.array([10.0, 0, 0]), np.array([0, 0, 2.0]), 90)
    np.testing.assert_allclose(turn.apply(np.array([11.0, 0, 5])), [10, 1, 5], atol=1e-12)
    np.testing.assert_allclose(turn.apply(np.array([10.0, 0, -7])), [10, 0, -7], atol=1e-12)


@given(vectors.filter(lambda v: np.linalg.norm(v) > 1e-3), st.floats(-720, 720))
def test_turns_agree_with_opencv(axis, degrees):
    turn = rotation_about_axis(np.zeros(3), axis, degrees)
    expected, _ = cv2.Rodrigues(axis / np.linalg.norm(axis) * np.deg2rad(degrees))
    np.testing.assert_allclose(turn.rotation, expected, atol=1e-9)


@given(transforms, st.integers(0, 1000))
def test_alignment_recovers_an_exact_motion(transform, seed):
    points = np.random.default_rng(seed).normal(size=(6, 3)) * 50
    found = align_rigidly(points, transform.apply(points))
    np.testing.assert_allclose(found.rotation, transform.rotation, atol=1e-9)
    np.testing.assert_allclose(found.apply(points), transform.apply(points), atol=1e-8)


def test_alignment_never_mirrors():
    points = np.random.default_rng(1).normal(size=(8, 3))
    found = align_rigidly(points, points * [1, 1, -1])
    assert np.linalg.det(found.rotation) == pytest.approx(1)


def test_alignment_of_a_flat_cloud_is_still_a_rotation():
    flat = np.random.default_rng(2).normal(size=(8, 3)) * [1, 1, 0]
    transform = rotation_about_axis(np.array([1.0, 2, 3]), np.array([1.0, 1, 0]), 70)
    found = align_rigidly(flat, transform.apply(flat))
    np.testing.assert_allclose(found.rotation, transform.rotation, atol=1e-9)


def test_alignment_ignores_what_has_no_weight():
    random = np.random.default_rng(3)
    points = random.normal(size=(10, 3))
    transform = rotation_about_axis(np.ones(3), np.array([0.0, 1, 1]), 40)
    target = transform.apply(points)
    target[7:] += 100
    weights = np.where(np.arange(10) < 7, 2.0, 0.0)
    found = align_rigidly(points, target, weights)
    np.testing.assert_allclose(found.rotation, transform.rotation, atol=1e-12)


def test_alignment_is_the_least_squares_optimum():
    random = np.random.default_rng(4)
    source, target = random.normal(size=(2, 12, 3))
    found = align_rigidly(source, target)
    least = ((found.apply(source) - target) ** 2).sum()
    for turn, move in random.normal(scale=1e-2, size=(20, 2, 3)):
        nearby = RigidTransform(Rotation.from_rotvec(turn).as_matrix(), move) @ found
        assert ((nearby.apply(source) - target) ** 2).sum() > least
