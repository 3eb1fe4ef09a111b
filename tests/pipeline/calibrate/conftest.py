"""Synthetic boards seen by a camera and a projector with known parameters."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from pipeline.calibrate.boards import board_points
from pipeline.calibrate.bundle_adjustment import BoardView
from pipeline.formats.capture import Chessboard
from pipeline.geometry.camera import Camera, Lens
from pipeline.geometry.rigid import RigidTransform, rotation_about_axis

BOARD = Chessboard(type="chessboard", inner_corners=(9, 6), square_mm=18.0)
CAMERA = Lens(
    (640, 480),
    np.array([[1500.0, 0, 322], [0, 1503, 236], [0, 0, 1]]),
    np.array([-0.1, 0.08, 0.0005, -0.0003, 0.0]),
)
PROJECTOR = Camera(
    Lens(
        (1024, 768),
        np.array([[2600.0, 0, 515], [0, 2603, 540], [0, 0, 1]]),
        np.array([0.04, -0.03, 0.0002, 0.0003, 0.0]),
    ),
    rotation_about_axis(np.zeros(3), np.array([0.1, 1.0, 0.0]), 18.0)
    @ RigidTransform(np.eye(3), np.array([310.0, 40.0, 30.0])),
)


def pose(tilt_deg: float, around: float, number: int, distance_mm: float = 950.0) -> RigidTransform:
    """Hold the board before the camera, tilted about an axis in its plane."""
    middle = RigidTransform(np.eye(3), -board_points(BOARD).mean(axis=0))
    axis = np.array([np.cos(around), np.sin(around), 0.0])
    turned = rotation_about_axis(np.zeros(3), axis, tilt_deg)
    spun = rotation_about_axis(np.zeros(3), np.array([0.0, 0.0, 1.0]), 15.0 * number)
    place = np.array(
        [25 * np.cos(number), 18 * np.sin(2 * number), distance_mm + 20 * (number % 3)]
    )
    return RigidTransform(np.eye(3), place) @ turned @ spun @ middle


@pytest.fixture
def make_views() -> Callable[..., tuple[list[BoardView], list[RigidTransform]]]:
    """Give a factory of board views with noise."""

    def make(
        count: int = 8,
        *,
        noise_px: float = 0.05,
        seed: int = 0,
        tilt_deg: float = 28.0,
        with_projector: bool = True,
    ) -> tuple[list[BoardView], list[RigidTransform]]:
        rng = np.random.default_rng(seed)
        points = board_points(BOARD)
        views, poses = [], []
        for number in range(count):
            where = pose(tilt_deg, 2.4 * number, number)
            placed = where.apply(points)
            seen = CAMERA.project(placed) + rng.normal(0, noise_px, (len(points), 2))
            lit = PROJECTOR.project(placed) + rng.normal(0, noise_px, (len(points), 2))
            views.append(
                BoardView(f"board-{number}", points, seen, lit if with_projector else None)
            )
            poses.append(where)
        return views, poses

    return make
