"""Calibration: number and noise of boards against error, beside OpenCV on the same corners."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.results import Result, Row, timed
from pipeline.calibrate.boards import board_points
from pipeline.calibrate.bundle_adjustment import BoardView, Start, adjust
from pipeline.calibrate.initial import board_pose, start_lens, start_projector
from pipeline.formats.capture import Chessboard
from pipeline.geometry.camera import Camera, Lens
from pipeline.geometry.rigid import RigidTransform, rotation_about_axis

Array = NDArray[np.float64]

BOARD = Chessboard(type="chessboard", inner_corners=(9, 6), square_mm=18.0)
CAMERA = Lens(
    (1280, 1024),
    np.array([[3050.0, 0, 652], [0, 3055, 498], [0, 0, 1]]),
    np.array([-0.11, 0.09, 0.0006, -0.0004, 0.0]),
)
PROJECTOR = Camera(
    Lens(
        (1280, 800),
        np.array([[2650.0, 0, 633], [0, 2652, 412], [0, 0, 1]]),
        np.array([0.05, -0.03, 0.0003, 0.0002, 0.0]),
    ),
    rotation_about_axis(np.zeros(3), np.array([0.05, 1.0, 0.0]), 17.0)
    @ RigidTransform(np.eye(3), np.array([290.0, 20.0, 30.0])),
)
REPEATS = 12


@dataclass(frozen=True)
class Rig:
    """What a method found."""

    camera: Lens
    projector: Camera
    camera_rms_px: float
    projector_rms_px: float


def measure(*, quick: bool = False) -> Result:
    """Vary boards and noise; median over several draws."""
    cases = (
        [(8, 0.03), (16, 0.03)]
        if quick
        else [(4, 0.03), (6, 0.03), (8, 0.03), (16, 0.03), (8, 0.1)]
    )
    rows = []
    for count, noise in cases:
        for name, method in (("joint adjustment", ours), ("OpenCV", opencv)):
            errors = [one(method, count, noise, seed) for seed in range(3 if quick else REPEATS)]
            seconds, _ = timed(lambda m=method, c=count, n=noise: m(views(c, n, 0)))
            figures = {key: float(np.median([error[key] for error in errors])) for key in errors[0]}
            place = figures.pop("3-D error um")
            rows.append(
                Row(
                    f"{name}, {count} boards, {noise} px",
                    seconds,
                    place,
                    default=name != "OpenCV" and (count, noise) == (8, 0.03),
                    peer=name == "OpenCV",
                    figures=figures,
                )
            )
    notes = [
        "3-D error: RMS distance of triangulated corners of unseen boards from the truth, after",
        "the motion that fits best; flatness: RMS of the same corners from their own plane",
    ]
    return Result("calibrate", "calibration from chessboards", "3-D error, um", rows, notes)


def pose(number: int, rng: np.random.Generator) -> RigidTransform:
    """Hold the board before the camera, tilted, now nearer, now farther."""
    middle = RigidTransform(np.eye(3), -board_points(BOARD).mean(axis=0))
    around = 2.4 * number + rng.uniform(-0.3, 0.3)
    axis = np.array([np.cos(around), np.sin(around), 0.0])
    tilted = rotation_about_axis(np.zeros(3), axis, (10.0, 25.0, 35.0)[number % 3])
    place = np.array([40 * np.cos(3 * number), 25 * np.sin(2 * number), 900 + 60 * (number % 4)])
    return RigidTransform(np.eye(3), place) @ tilted @ middle


def views(count: int, noise_px: float, seed: int) -> list[BoardView]:
    """See boards with noise in the camera and, twice as much, in the decoded projector."""
    rng = np.random.default_rng(seed)
    points, made = board_points(BOARD), []
    for number in range(count):
        placed = pose(number, rng).apply(points)
        seen = CAMERA.project(placed) + rng.normal(0, noise_px, (len(points), 2))
        lit = PROJECTOR.project(placed) + rng.normal(0, 2 * noise_px, (len(points), 2))
        made.append(BoardView(str(number), points, seen, lit))
    return made


def ours(boards: list[BoardView]) -> Rig:
    """Adjust camera, projector and boards together, as the stage does."""
    lens = start_lens(
        [v.points for v in boards], [v.camera_px for v in boards], CAMERA.size_px, "C0"
    )
    poses = tuple(board_pose(lens, view.points, view.camera_px) for view in boards)
    projector = start_projector(boards, poses, None, PROJECTOR.lens.size_px)
    found = adjust(boards, Start(lens, projector, poses))
    assert found.projector is not None
    assert found.projector_rms_px is not None
    return Rig(found.camera, found.projector, found.camera_rms_px, found.projector_rms_px)


def opencv(boards: list[BoardView]) -> Rig:
    """Calibrate both alone, then the pose between them: calibrateCamera, stereoCalibrate."""
    points = [view.points.astype(np.float32) for view in boards]
    seen = [view.camera_px.astype(np.float32) for view in boards]
    lit = [view.projector_px.astype(np.float32) for view in boards if view.projector_px is not None]
    rms1, K1, bend1, *_ = cv2.calibrateCamera(
        points, seen, CAMERA.size_px, None, None, flags=cv2.CALIB_FIX_K3
    )
    rms2, K2, bend2, *_ = cv2.calibrateCamera(
        points, lit, PROJECTOR.lens.size_px, None, None, flags=cv2.CALIB_FIX_K3
    )
    _, K1, bend1, K2, bend2, R, t, *_ = cv2.stereoCalibrate(
        points, seen, lit, K1, bend1, K2, bend2, CAMERA.size_px, flags=cv2.CALIB_FIX_INTRINSIC
    )
    camera = Lens(CAMERA.size_px, K1, bend1.ravel()[:5])
    projector = Camera(
        Lens(PROJECTOR.lens.size_px, K2, bend2.ravel()[:5]), RigidTransform(R, t.ravel())
    )
    return Rig(camera, projector, rms1, rms2)


def one(method, count: int, noise_px: float, seed: int) -> dict[str, float]:  # type: ignore[no-untyped-def]
    """Return the errors of one draw on boards that were not seen."""
    found = method(views(count, noise_px, seed))
    rng = np.random.default_rng(1000 + seed)
    away, bent = [], []
    for number in range(5):
        true = pose(number, rng).apply(board_points(BOARD))
        got = triangulated(found, CAMERA.project(true), PROJECTOR.project(true))
        away.append((got, true))
        bent.append(from_plane(got))
    got, true = (np.concatenate(part) for part in zip(*away, strict=True))
    return {
        "3-D error um": 1000 * after_motion(got, true),
        "flatness um": 1000 * float(np.sqrt(np.mean(np.square(bent)))),
        "focal length, px": abs(found.camera.K[0, 0] - CAMERA.K[0, 0]),
        "camera RMS px": found.camera_rms_px,
        "projector RMS px": found.projector_rms_px,
    }


def triangulated(found: Rig, seen: Array, lit: Array) -> Array:
    """Meet the rays half-way, (N, 3)."""
    first = found.camera.directions(seen)
    centre, second = found.projector.rays(lit)
    lengths = []
    for a, b in zip(first, second, strict=True):
        lengths.append(np.linalg.lstsq(np.stack([a, -b], axis=1), centre, rcond=None)[0])
    along = np.array(lengths)
    return (first * along[:, :1] + centre + second * along[:, 1:]) / 2


def from_plane(points: Array) -> float:
    """Return the RMS distance from the plane that fits best."""
    return float(np.linalg.svd(points - points.mean(axis=0))[1][2] / np.sqrt(len(points)))


def after_motion(got: Array, true: Array) -> float:
    """Return the RMS distance after the rigid motion that fits best (Kabsch 1976)."""
    a, b = got - got.mean(axis=0), true - true.mean(axis=0)
    u, _, v = np.linalg.svd(a.T @ b)
    turn = (u * np.array([1, 1, np.sign(np.linalg.det(u @ v))])) @ v
    return float(np.sqrt(np.mean(np.sum((a @ turn - b) ** 2, axis=1))))
