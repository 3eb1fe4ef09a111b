"""The table's axis from boards that turned with it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.calibrate.turntable import turntable_axis
from pipeline.geometry.rigid import RigidTransform, rotation_about_axis

POINT = np.array([20.0, -35.0, 880.0])
DIRECTION = np.array([0.1, -0.7, -0.7]) / np.linalg.norm([0.1, -0.7, -0.7])
BOARD = rotation_about_axis(np.array([3.0, 4.0, 900.0]), np.array([1.0, 0.2, 0.3]), 50.0)


def turned(*angles: float) -> dict[float, RigidTransform]:
    return {angle: rotation_about_axis(POINT, DIRECTION, angle) @ BOARD for angle in angles}


@given(st.lists(st.integers(-17, 17).map(lambda n: n * 10.0), min_size=3, max_size=6, unique=True))
def test_the_axis_is_found_from_any_angles(angles: list[float]) -> None:
    table = turntable_axis(turned(*angles))
    assert table is not None
    np.testing.assert_allclose(table.axis_direction, DIRECTION, atol=1e-6)
    distance = np.linalg.norm(np.cross(table.axis_point_mm - POINT, DIRECTION))
    assert distance < 1e-4
    # The point is the axis's nearest to the origin.
    assert abs(table.axis_point_mm @ DIRECTION) < 1e-4


@pytest.mark.parametrize("angles", [(), (0.0,), (0.0, 90.0)])
def test_fewer_than_three_angles_give_no_axis(angles: tuple[float, ...]) -> None:
    assert turntable_axis(turned(*angles)) is None


def test_a_board_that_did_not_turn_gives_no_axis() -> None:
    assert turntable_axis({0.0: BOARD, 30.0: BOARD, 60.0: BOARD}) is None
