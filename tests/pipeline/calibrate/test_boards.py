"""Boards found in images: corners to a fraction of a pixel, and honest absence."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from pipeline.calibrate.boards import board_points, find_corners
from pipeline.calibrate.projector_corners import projector_corners
from pipeline.formats.capture import Charuco, Chessboard
from pipeline.structured_light.coordinates import ProjectorCoordinates

BOARD = Chessboard(type="chessboard", inner_corners=(7, 5), square_mm=10.0)
MATRIX = np.array([[2.1, 0.25, 60.0], [-0.2, 2.3, 50.0], [2e-4, 1e-4, 1.0]])


def warp(points: np.ndarray) -> np.ndarray:
    homogeneous = np.concatenate([points[:, :2], np.ones((len(points), 1))], axis=1) @ MATRIX.T
    return homogeneous[:, :2] / homogeneous[:, 2:]


def drawn(noise: float = 0.0, level: float = 1.0) -> np.ndarray:
    """Draw the board through a homography, 16 x supersampled, blurred by half a pixel."""
    fine = 8
    y, x = (np.mgrid[0 : 260 * fine, 0 : 320 * fine] + 0.5) / fine - 0.5
    inverse = np.linalg.inv(MATRIX)
    w = inverse[2, 0] * x + inverse[2, 1] * y + inverse[2, 2]
    u = (inverse[0, 0] * x + inverse[0, 1] * y + inverse[0, 2]) / w / 10
    v = (inverse[1, 0] * x + inverse[1, 1] * y + inverse[1, 2]) / w / 10
    inside = (u > -1) & (u < 7) & (v > -1) & (v < 5)
    dark = inside & ((np.floor(u) + np.floor(v)) % 2 == 0)
    image = np.where(dark, 0.06, 0.8).astype(np.float32)
    image = cv2.GaussianBlur(image, (0, 0), 0.5 * fine)
    image = cv2.resize(image, (320, 260), interpolation=cv2.INTER_AREA) * level
    rng = np.random.default_rng(0)
    return (image + rng.normal(0, noise, image.shape)).astype(np.float32)


@pytest.mark.parametrize("level", [1.0, 0.02])
def test_corners_are_found_to_a_few_hundredths_of_a_pixel(level: float) -> None:
    found = find_corners(drawn(noise=0.003 * level, level=level), BOARD)
    assert found is not None
    truth = warp(board_points(BOARD))
    distance = np.linalg.norm(found.pixels[:, None] - truth[None], axis=2)
    assert np.sqrt(np.mean(distance.min(axis=1) ** 2)) < 0.04
    # The board looks the same turned by half a turn, so the order may be reversed, no more.
    assert len(set(distance.argmin(axis=1))) == 35


@pytest.mark.parametrize(
    "image", [np.zeros((120, 160), np.float32), np.full((120, 160), 0.5, np.float32)]
)
def test_a_board_that_is_not_there_is_not_found(image: np.ndarray) -> None:
    assert find_corners(image, BOARD) is None


def test_a_charuco_board_is_found_in_part() -> None:
    board = Charuco(
        type="charuco", squares=(7, 5), square_mm=20.0, marker_mm=14.0, dictionary="DICT_5X5_100"
    )
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    pattern = cv2.aruco.CharucoBoard((7, 5), 20.0, 14.0, dictionary)
    image = pattern.generateImage((700, 500)).astype(np.float32) / 255
    image = cv2.GaussianBlur(image, (0, 0), 0.8)
    image[:, :130] = 0.5  # a hand hides the first column, and a marker of each corner of the second
    found = find_corners(image, board)
    assert found is not None
    assert len(found.points) == 16
    np.testing.assert_allclose(found.pixels, found.points[:, :2] * 5 + 99.5, atol=0.15)


def test_projector_corners_are_interpolated_from_decoded_pixels() -> None:
    y, x = np.mgrid[0:200, 0:240].astype(np.float64)
    coordinate = 100 + 2.1 * x + 0.2 * y + 4e-4 * x * y
    noisy = (coordinate + np.random.default_rng(1).normal(0, 0.05, x.shape)).astype(np.float32)
    noisy[60:70, 80:90] = np.nan
    noisy[100, 100] += 30  # a wrong pixel must not matter
    sigma = np.full(x.shape, 0.05, np.float32)
    decoded = ProjectorCoordinates(noisy, noisy, sigma, sigma, sigma, "white", {})
    pixels = np.array([[50.3, 60.8], [85.2, 75.1], [101.0, 101.5], [120.0, 90.0], [2000.0, 5.0]])
    values, deviations = projector_corners(decoded, pixels)
    truth = 100 + 2.1 * pixels[:, 0] + 0.2 * pixels[:, 1] + 4e-4 * pixels[:, 0] * pixels[:, 1]
    np.testing.assert_allclose(values[:4, 0], truth[:4], atol=0.03)
    assert (np.abs(values[:4, 0] - truth[:4]) < 4 * deviations[:4, 0]).all()
    assert np.isnan(values[4]).all()
