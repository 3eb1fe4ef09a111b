from __future__ import annotations

import numpy as np
import pytest

from hardware.simulated.painting import Painting
from hardware.simulated.subjects import (
    BOARD,
    BOARD_BLACK,
    BOARD_WHITE,
    CANVAS,
    FRAME,
    TABLE,
    BoardInAir,
    Chessboard,
    PaintedCanvas,
    PaintingOnTable,
)
from pipeline.geometry.rigid import RigidTransform, rotation_about_axis

LIFTED = RigidTransform(np.eye(3), np.array([0.0, 0.0, 10.0]))


def make_painting(heights: np.ndarray, spacing: float = 1.0) -> Painting:
    """Return a painting of the given heights, its grid centred on the origin."""
    rows, columns = heights.shape
    heights = heights.astype(np.float32)
    down, right = np.gradient(heights, spacing)
    normals = np.stack([-right, down, np.ones_like(heights)], axis=-1)
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    column = np.broadcast_to(np.arange(columns, dtype=np.float32) / columns, heights.shape)
    diffuse = np.stack([column, 0.1 + 0 * column, 0.2 + 0 * column], axis=-1).astype(np.float32)
    lobe = np.broadcast_to(np.array([-1, 1, 20], np.float32), (rows, columns, 3))
    return Painting(
        spacing,
        -(columns - 1) / 2 * spacing,
        (rows - 1) / 2 * spacing,
        heights,
        normals.astype(np.float32),
        diffuse,
        np.zeros_like(diffuse),
        np.ascontiguousarray(lobe),
        np.arange(columns) < columns // 2 + np.zeros((rows, 1), int),
    )


def down_at(x: float, y: float, z: float = 100.0) -> tuple[np.ndarray, np.ndarray]:
    return np.array([x, y, z]), np.array([[0.0, 0.0, -1.0]])


def test_rays_meet_the_canvas_at_its_height() -> None:
    random = np.random.default_rng(0)
    painting = make_painting(random.uniform(0, 2, (21, 31)))
    pose = LIFTED @ rotation_about_axis(np.zeros(3), np.array([0.2, 0.1, 1.0]), 20.0)
    subject = PaintingOnTable(PaintedCanvas(painting), pose)
    # A ray along the canvas's normal, over grid sample (row 7, column 12).
    x, y = painting.x_mm[12], painting.y_mm[7]
    origin = pose.apply(np.array([x, y, 50.0]))
    hits = subject.trace(origin, pose.rotate(np.array([[0.0, 0.0, -1.0]])))
    height = float(painting.heights_mm[7, 12])
    np.testing.assert_allclose(hits.points_mm[0], pose.apply(np.array([x, y, height])), atol=1e-6)
    np.testing.assert_allclose(
        hits.material[0, :3], pose.rotate(painting.normals[7, 12]), atol=1e-6
    )
    np.testing.assert_allclose(hits.material[0, 3:6], painting.diffuse[7, 12], atol=1e-6)
    assert hits.kind[0] == CANVAS


def test_materials_are_interpolated() -> None:
    painting = make_painting(np.zeros((5, 11)))
    subject = PaintingOnTable(PaintedCanvas(painting), LIFTED)
    hits = subject.trace(*down_at(0.25, 0.0))
    assert hits.material[0, 3] == pytest.approx((5.25) / 11, rel=1e-5)
    assert hits.kind[0] == FRAME


def test_beside_the_painting_lies_the_table() -> None:
    painting = make_painting(np.zeros((5, 11)))
    subject = PaintingOnTable(PaintedCanvas(painting), LIFTED)
    hits = subject.trace(*down_at(40.0, 0.0))
    np.testing.assert_allclose(hits.points_mm, [[40.0, 0.0, 0.0]])
    assert hits.kind[0] == TABLE
    np.testing.assert_allclose(hits.material[0, :3], [0, 0, 1])


def test_the_table_hides_what_is_below_it() -> None:
    heights = np.zeros((9, 21))
    heights[:, -4:] = -30.0  # the wall goes through the table
    subject = PaintingOnTable(PaintedCanvas(make_painting(heights)), LIFTED)
    hits = subject.trace(*down_at(9.0, 0.0))
    assert hits.kind[0] == TABLE
    assert hits.points_mm[0, 2] == pytest.approx(0.0)


def test_rays_to_the_sky_meet_nothing() -> None:
    subject = PaintingOnTable(PaintedCanvas(make_painting(np.zeros((5, 11)))), LIFTED)
    hits = subject.trace(np.array([0, 0, 50.0]), np.array([[0.0, 0.1, 1.0]]))
    assert np.isnan(hits.points_mm).all()
    assert hits.kind[0] == 0


def test_a_wall_casts_its_shadow() -> None:
    heights = np.zeros((21, 61))
    heights[:, 30] = 5.0  # at x = 0
    subject = PaintingOnTable(PaintedCanvas(make_painting(heights)), LIFTED)
    x = np.array([-20.0, -6.0, -4.0, 4.0, 6.0])
    points = np.stack([x, 0 * x, 0 * x + 10.0], axis=1)
    # At 45 degrees from the right: 5 mm of shadow to the left of the wall.
    lit = subject.lit(points, np.array([1000.0, 0.0, 1010.0]))
    assert lit.tolist() == [True, True, False, True, True]


def test_the_painting_shades_the_table() -> None:
    heights = np.full((21, 61), 0.0)
    heights[[0, -1]] = heights[:, [0, -1]] = -30.0
    subject = PaintingOnTable(PaintedCanvas(make_painting(heights)), LIFTED)
    points = np.array([[-35.0, 0.0, 0.0], [-50.0, 0.0, 0.0]])
    assert subject.lit(points, np.array([970.0, 0.0, 1010.0])).tolist() == [False, True]


def test_nothing_is_lit_where_nothing_is() -> None:
    subject = PaintingOnTable(PaintedCanvas(make_painting(np.zeros((5, 11)))), LIFTED)
    assert not subject.lit(np.full((2, 3), np.nan), np.array([0, 0, 100.0])).any()


def shades(board: Chessboard, places: np.ndarray, grain: float = 1e-3) -> np.ndarray:
    subject = BoardInAir(board, LIFTED, grain)
    origin = np.array([0.0, 0.0, 500.0])
    points = np.concatenate([places, np.full((len(places), 1), 10.0)], axis=1)
    hits = subject.trace(origin, points - origin)
    assert (hits.kind == BOARD).all()
    np.testing.assert_allclose(hits.points_mm, points, atol=1e-9)
    return hits.material[:, 3] * np.pi


def test_board_squares_alternate_around_the_first_corner() -> None:
    board = Chessboard((3, 2), 10.0)
    centres = np.array([[5.0, 5.0], [-5.0, -5.0], [5.0, -5.0], [-5.0, 5.0], [15.0, -5.0]])
    assert shades(board, centres) == pytest.approx(
        [BOARD_BLACK, BOARD_BLACK, BOARD_WHITE, BOARD_WHITE, BOARD_BLACK], rel=1e-5
    )
    border = np.array([[-14.0, -14.0], [34.0, 24.0], [25.0, 25.0]])
    assert shades(board, border) == pytest.approx([BOARD_WHITE] * 3, rel=1e-5)


def test_board_edges_are_averaged_over_the_grain() -> None:
    board = Chessboard((3, 2), 10.0)
    grey = (BOARD_BLACK + BOARD_WHITE) / 2
    # On an edge half of each; at a corner the two blacks make half; a quarter over the edge.
    places = np.array([[0.0, 5.0], [0.0, 0.0], [0.25, 5.0], [30.0, 5.0], [30.0, -5.0]])
    quarter = BOARD_BLACK + 0.25 * (BOARD_WHITE - BOARD_BLACK)
    expected = [grey, grey, quarter, grey, BOARD_WHITE]
    assert shades(board, places, grain=1.0) == pytest.approx(expected, rel=1e-4)


def test_the_mean_of_a_board_does_not_depend_on_the_grain() -> None:
    board = Chessboard((5, 4), 10.0)
    axis = np.linspace(-18, 58, 400)
    places = np.stack(np.meshgrid(axis, np.linspace(-18, 48, 300)), axis=-1).reshape(-1, 2)
    inside = (np.abs(places - [20, 15]) < [35, 30]).all(axis=1)
    fine, coarse = (shades(board, places[inside], grain).mean() for grain in (1e-3, 1.5))
    assert fine == pytest.approx(coarse, rel=2e-3)


def test_a_board_shades_the_table_and_not_itself() -> None:
    subject = BoardInAir(Chessboard((3, 2), 10.0), LIFTED, 0.1)
    points = np.array([[5.0, 5.0, 0.0], [5.0, 5.0, 10.0], [300.0, 5.0, 0.0]])
    assert subject.lit(points, np.array([5.0, 5.0, 500.0])).tolist() == [False, True, True]


def test_a_board_s_normal_faces_the_viewer() -> None:
    turned = LIFTED @ rotation_about_axis(np.zeros(3), np.array([1.0, 0, 0]), 180.0)
    subject = BoardInAir(Chessboard((3, 2), 10.0), turned, 0.1)
    hits = subject.trace(*down_at(5.0, -5.0))
    np.testing.assert_allclose(hits.material[0, :3], [0, 0, 1], atol=1e-12)
