"""Covariance of linear problems, where everything is known."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.calibrate.covariance import correlation, jackknife_variance, joint_covariance


def test_covariance_is_the_inverse_of_the_normal_matrix():
    jacobian = np.random.default_rng(1).normal(size=(40, 5)) * np.array([1, 1e-6, 1e6, 3, 0.1])
    covariance, condition = joint_covariance(jacobian)
    scale = np.linalg.norm(jacobian, axis=0)
    expected = np.linalg.inv((jacobian / scale).T @ (jacobian / scale))
    np.testing.assert_allclose(covariance * np.outer(scale, scale), expected, rtol=1e-9)
    assert 1 <= condition < 5


def test_what_changes_nothing_or_the_same_is_told_by_the_condition():
    jacobian = np.random.default_rng(1).normal(size=(40, 3))
    assert joint_covariance(np.column_stack([jacobian, np.zeros(40)]))[1] == np.inf
    assert joint_covariance(np.column_stack([jacobian, 2 * jacobian[:, 0]]))[1] > 1e12
    assert joint_covariance(np.ones((4, 2)))[1] > 1e12


def blocks(rng, common, views=200):
    """Views of 20 rows: one shared parameter, one of each view's own, errors alike in a view."""
    made = []
    for _ in range(views):
        shared, own = rng.normal(size=(20, 1)), np.ones((20, 1))
        error = rng.normal(size=20) + common * rng.normal() * shared[:, 0]
        made.append((shared, own, error))
    return made


@pytest.mark.parametrize("common", [0.0, 3.0])
def test_jackknife_knows_that_a_view_errs_as_one(common):
    rng = np.random.default_rng(2)
    made = blocks(rng, common)
    reduced = [s[:, 0] - s[:, 0].mean() for s, _, _ in made]
    information = sum(r @ r for r in reduced)
    # Each view's estimate varies by 1/info + common^2.
    expected = sum((r @ r) ** 2 * (1 / (r @ r) + common**2) for r in reduced) / information**2
    found = jackknife_variance(made)
    assert found.shape == (1,)
    assert found[0] == pytest.approx(expected, rel=0.35)


def test_jackknife_of_too_few_views_says_nothing():
    made = blocks(np.random.default_rng(3), 0.0, views=2)
    assert jackknife_variance(made).tolist() == [0.0]
    assert jackknife_variance([]).shape == (0,)


def test_correlations_are_bounded():
    found = correlation(np.array([[4.0, -3.0], [-3.0, 9.0]]))
    np.testing.assert_allclose(found, [[1, -0.5], [-0.5, 1]])
