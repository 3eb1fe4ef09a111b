from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.extract.outline import skew_angle


def rectangle(angle_deg: float, width: float = 120, height: float = 90) -> np.ndarray:
    x, y = np.meshgrid(np.arange(-width / 2, width / 2 + 1), np.arange(-height / 2, height / 2 + 1))
    points = np.stack([x.ravel(), y.ravel()], axis=1)
    a = np.deg2rad(angle_deg)
    return points @ np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]])


@given(st.floats(-44.5, 44.5))
def test_the_skew_of_a_rectangle_is_found(angle: float) -> None:
    points = rectangle(angle)
    assert np.rad2deg(skew_angle(points, len(points))) == pytest.approx(angle, abs=0.02)


def test_a_spike_on_the_edge_does_not_turn_it() -> None:
    points = np.concatenate([rectangle(3.0), [[20.0, 55.0], [21.0, 56.0]]])
    assert np.rad2deg(skew_angle(points, len(points))) == pytest.approx(3, abs=0.05)


def test_a_disc_has_no_edges() -> None:
    x, y = np.meshgrid(np.arange(-50, 51.0), np.arange(-50, 51.0))
    inside = np.hypot(x, y) < 50
    points = np.stack([x[inside], y[inside]], axis=1)
    assert skew_angle(points, len(points)) is None


@pytest.mark.parametrize(
    "points", [np.zeros((3, 2)), np.zeros((10, 2)), np.outer(np.arange(9.0), [1, 1])]
)
def test_degenerate_regions_have_no_edges(points: np.ndarray) -> None:
    assert skew_angle(points, 1.0) is None
