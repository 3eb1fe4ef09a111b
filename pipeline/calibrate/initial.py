"""Where the adjustment starts: each device alone (Zhang 2000), then one pose between them."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.bundle_adjustment import BoardView
from pipeline.errors import ImpastoError
from pipeline.geometry.camera import Camera, Lens
from pipeline.geometry.rigid import RigidTransform

FEWEST_VIEWS = 3
_FEWEST_CORNERS = 8


def start_lens(
    points: Sequence[NDArray[np.float64]],
    pixels: Sequence[NDArray[np.float64]],
    size_px: tuple[int, int],
    what: str,
) -> Lens:
    """Calibrate one lens from boards, third radial term left at 0.

    Raises
    ------
    ImpastoError
        Fewer than FEWEST_VIEWS boards, or OpenCV finds no solution.
    """
    if len(points) < FEWEST_VIEWS:
        raise ImpastoError(
            f"{what} cannot be calibrated from {len(points)} board views",
            expected=f"{FEWEST_VIEWS} or more, tilted in different directions",
            fix="add calibrate sequences, or give K and distortion in capture.json",
        )
    threads = cv2.getNumThreads()
    # On several threads OpenCV adds the views up as they end, and the last bits vary.
    cv2.setNumThreads(1)
    try:
        _, K, distortion, _, _ = cv2.calibrateCamera(
            [p.astype(np.float32) for p in points],
            [p.astype(np.float32) for p in pixels],
            size_px,
            None,
            None,
            flags=cv2.CALIB_FIX_K3,
        )
    except cv2.error as error:
        raise ImpastoError(
            f"{what} cannot be calibrated: {error.err}",
            fix="record boards tilted in different directions",
        ) from error
    finally:
        cv2.setNumThreads(threads)
    return Lens(size_px, np.asarray(K, np.float64), np.asarray(distortion, np.float64).ravel()[:5])


def board_pose(
    lens: Lens, points: NDArray[np.float64], pixels: NDArray[np.float64]
) -> RigidTransform:
    """Find where a board stands from its corners (iterative PnP from a homography)."""
    directions = np.ascontiguousarray(lens.directions(pixels)[:, :2])
    found, rotation, translation = cv2.solvePnP(
        points, directions, np.eye(3), None, flags=cv2.SOLVEPNP_ITERATIVE
    )
    if not found:
        raise ImpastoError("a board's pose could not be found from its corners")
    return RigidTransform(cv2.Rodrigues(rotation)[0], translation.ravel())


def start_projector(
    views: Sequence[BoardView],
    boards: Sequence[RigidTransform],
    lens: Lens | None,
    size_px: tuple[int, int],
) -> Camera:
    """Calibrate the projector as an inverse camera, and place it by the view that agrees best.

    ``lens`` is taken as it is if given.
    """
    usable = [
        (view, board, np.isfinite(view.projector_px).all(axis=1))
        for view, board in zip(views, boards, strict=True)
        if view.projector_px is not None
    ]
    usable = [entry for entry in usable if entry[2].sum() >= _FEWEST_CORNERS]
    points = [view.points[known] for view, _, known in usable]
    pixels = [
        view.projector_px[known] for view, _, known in usable if view.projector_px is not None
    ]
    if lens is None:
        lens = start_lens(points, pixels, size_px, "the projector")
    if not usable:
        raise ImpastoError(
            "the projector's place is not known: no board shows both of its axes",
            expected="calibrate sequences with patterns along x and y",
        )
    candidates = [
        board_pose(lens, p, q) @ board.inverse()
        for p, q, (_, board, _) in zip(points, pixels, usable, strict=True)
    ]

    def disagreement(pose: RigidTransform) -> float:
        return sum(
            float(np.median(np.linalg.norm(lens.project((pose @ board).apply(p)) - q, axis=1)))
            for p, q, (_, board, _) in zip(points, pixels, usable, strict=True)
        )

    return Camera(lens, min(candidates, key=disagreement))
