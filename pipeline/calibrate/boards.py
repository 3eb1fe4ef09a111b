"""Calibration boards: their points, and finding them in an image to a fraction of a pixel."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.corner_fit import SMALLEST_RADIUS, fit_corners
from pipeline.formats.capture import Board, Charuco, Chessboard

FEWEST_CORNERS = 6
REACH = 0.7
"""Radius of the window around a corner, in distances to the next one."""

SMALLEST_WINDOW = 2
"""Half side of the gradient method's window, px."""

Found = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Board points (N, 3) and pixels (N, 2)."""


@dataclass(frozen=True)
class Corners:
    """Corners of one board in one image: (N, 3) board points (mm), (N, 2) pixels."""

    points: NDArray[np.float64]
    pixels: NDArray[np.float64]


def find_corners(image: NDArray[np.float32], board: Board) -> Corners | None:
    """Find a board in a linear image; None if it is not (wholly, for a chessboard) to be seen.

    The corners are refined by :mod:`pipeline.calibrate.corner_fit`, in the largest window that
    holds no other corner; where squares are too small for that, by the gradient's orthogonality
    (Foerstner and Guelch 1987).
    """
    # The detector wants 8 bits; a square root keeps the dark squares of a dim picture apart.
    peak = float(np.percentile(image, 99.5)) or 1.0
    level = np.clip(image / peak, 0, 1).astype(np.float32)
    bytes_ = np.rint(255 * np.sqrt(level)).astype(np.uint8)
    match board:
        case Chessboard():
            found = _chessboard(bytes_, board)
        case Charuco():
            found = _charuco(bytes_, board)
    if found is None:
        return None
    points, pixels = found
    pixels = _refined(level, pixels)
    kept = np.isfinite(pixels).all(axis=1)
    return Corners(points[kept], pixels[kept]) if kept.sum() >= FEWEST_CORNERS else None


def board_points(board: Board) -> NDArray[np.float64]:
    """Return the (N, 3) inner corners of a board, row by row, mm, z = 0."""
    if isinstance(board, Chessboard):
        columns, rows = board.inner_corners
    else:
        columns, rows = board.squares[0] - 1, board.squares[1] - 1
    x, y = np.meshgrid(np.arange(columns), np.arange(rows))
    flat = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    return np.asarray(flat * board.square_mm, dtype=np.float64)


def _chessboard(image: NDArray[np.uint8], board: Chessboard) -> Found | None:
    found, pixels = cv2.findChessboardCornersSB(
        image, board.inner_corners, flags=cv2.CALIB_CB_EXHAUSTIVE
    )
    if not found:
        found, pixels = cv2.findChessboardCorners(image, board.inner_corners)
    if not found:
        return None
    return board_points(board), pixels.reshape(-1, 2).astype(np.float64)


def _charuco(image: NDArray[np.uint8], board: Charuco) -> Found | None:
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    pattern = cv2.aruco.CharucoBoard(board.squares, board.square_mm, board.marker_mm, dictionary)
    pixels, ids, _, _ = cv2.aruco.CharucoDetector(pattern).detectBoard(image)
    if ids is None or len(ids) < FEWEST_CORNERS:
        return None
    return board_points(board)[ids.ravel()], pixels.reshape(-1, 2).astype(np.float64)


def _refined(level: NDArray[np.float32], pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    """Refine corners (N, 2) px; NaN where an image of a corner is not what it should be."""
    apart = np.linalg.norm(pixels[:, None] - pixels[None], axis=2)
    np.fill_diagonal(apart, np.inf)
    nearest = float(apart.min())
    if REACH * nearest >= SMALLEST_RADIUS:
        return fit_corners(level, pixels, REACH * nearest).pixels
    window = max(int(0.4 * nearest), SMALLEST_WINDOW)
    smooth = cv2.GaussianBlur(level, (0, 0), 0.7)
    refined = cv2.cornerSubPix(
        smooth,
        pixels.astype(np.float32).reshape(-1, 1, 2),
        (window, window),
        (-1, -1),
        (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-4),
    )
    refined = refined.reshape(-1, 2).astype(np.float64)
    moved = np.linalg.norm(refined - pixels, axis=1)
    return np.where(moved[:, None] < window, refined, np.nan)
