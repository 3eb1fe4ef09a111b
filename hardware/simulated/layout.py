"""Where everything of the simulated rig stands, in the rig's frame: z up, origin on the axis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.simulated.subjects import Chessboard
from pipeline.geometry.camera import Camera, Lens
from pipeline.geometry.rigid import RigidTransform, rotation_about_axis

Array = NDArray[np.float64]

BOARD = Chessboard((9, 6), 12.0)
SCAN_CAMERA = "C0"
_CENTRE_MM = np.array([4.0, -3.0, 14.0])
_STATIONS = ((-90.0, 70.0), (15.0, 56.0), (150.0, 62.0), (-60.0, 42.0))
"""Azimuth and elevation of the photo camera, degrees."""

_STATION_MM, _ARC_MM = 520.0, 600.0
_STOPS_DEG = (34.0, 50.0, 68.0, 98.0, 138.0)
"""Of the lamp along its arc, from the horizon on one side to that on the other."""


@dataclass(frozen=True)
class Layout:
    """Poses and lenses: the truth that calibration is to find.

    Parameters
    ----------
    cameras
        ``C0`` scans; ``C1``... are stations of the photo camera, one lens for all.
    projector
        An inverse camera.
    stops
        Position of the lamp at each stop, mm.
    rig_from_canvas
        With the table at 0.
    boards
        Rig from board, by the sequence's name.
    """

    cameras: dict[str, Camera]
    projector: Camera
    stops: dict[str, Array]
    rig_from_canvas: RigidTransform
    boards: dict[str, RigidTransform]

    def turned(self, angle_deg: float) -> RigidTransform:
        """Return rig from canvas with the table at an angle."""
        return turn_z(angle_deg) @ self.rig_from_canvas


def lay_out(
    scan_px: tuple[int, int],
    photo_px: tuple[int, int],
    projector_px: tuple[int, int],
    boards: int,
    stations: int = len(_STATIONS),
) -> Layout:
    """Stand the devices around the table."""
    scan_lens = _lens(scan_px, 22.6, (-0.11, 0.13, 0.0005, -0.0004, 0.0))
    photo_lens = _lens(photo_px, 31.8, (-0.07, 0.06, -0.0005, 0.0003, 0.0))
    projector_lens = _lens(projector_px, 24.2, (0.05, -0.04, 0.0003, 0.0002, 0.0))
    cameras = {SCAN_CAMERA: _standing_at(np.array([20.0, -26.0, 520.0]), _CENTRE_MM, scan_lens)}
    for number, (azimuth, elevation) in enumerate(_STATIONS[:stations], start=1):
        place = _CENTRE_MM + _STATION_MM * direction(azimuth, elevation)
        cameras[f"C{number}"] = _standing_at(place, _CENTRE_MM, photo_lens)
    stops = {}
    for number, elevation in enumerate(_STOPS_DEG):
        along = direction(90.0, elevation) + np.array([0.12, 0.0, 0.0])
        stops[f"L{number}"] = _ARC_MM * along / np.linalg.norm(along)
    tilt = rotation_about_axis(np.zeros(3), np.array([0.8, -0.5, 0.0]), 1.1)
    return Layout(
        cameras,
        _standing_at(np.array([-188.0, 44.0, 505.0]), _CENTRE_MM, projector_lens),
        stops,
        RigidTransform(np.eye(3), _CENTRE_MM) @ tilt @ turn_z(2.6),
        {f"board-{number}": _board_pose(number) for number in range(boards)},
    )


def direction(azimuth_deg: float, elevation_deg: float) -> Array:
    """Return a unit vector; azimuth counter-clockwise from x, elevation above the table."""
    azimuth, elevation = np.deg2rad(azimuth_deg), np.deg2rad(elevation_deg)
    flat = np.cos(elevation)
    return np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])


def look_from(position_mm: Array, lens: Lens) -> Camera:
    """Stand a camera somewhere, looking at the middle of the painting."""
    return _standing_at(position_mm, _CENTRE_MM, lens)


def turn_z(angle_deg: float) -> RigidTransform:
    """Turn about the table's axis."""
    return rotation_about_axis(np.zeros(3), np.array([0.0, 0.0, 1.0]), angle_deg)


def _board_pose(number: int) -> RigidTransform:
    """Hold the board over the table, each time elsewhere and tilted otherwise."""
    columns, rows = BOARD.inner_corners
    to_middle = RigidTransform(
        np.eye(3), -BOARD.square_mm / 2 * np.array([columns - 1, rows - 1, 0.0])
    )
    around = 2.4 * number
    axis = np.array([np.cos(around), np.sin(around), 0.0])
    tilted = rotation_about_axis(np.zeros(3), axis, (8.0, 30.0, 38.0, 34.0)[number % 4])
    spun = turn_z(9.0 * np.sin(2.0 * number)) @ turn_z(180.0 * (number % 2))
    place = np.array([14 * np.cos(3 * around), 4 * np.sin(2 * around), 54.0 + 9.0 * (number % 3)])
    face_up = rotation_about_axis(np.zeros(3), np.array([1.0, 0.0, 0.0]), 180.0)
    return RigidTransform(np.eye(3), place) @ tilted @ spun @ face_up @ to_middle


def _lens(size_px: tuple[int, int], field_deg: float, distortion: tuple[float, ...]) -> Lens:
    """Return a lens of a horizontal field of view, its centre a little off."""
    width, height = size_px
    focal = width / (2 * np.tan(np.deg2rad(field_deg) / 2))
    centre = 0.508 * width - 0.5, 0.491 * height - 0.5
    K = np.array([[focal, 0, centre[0]], [0, focal * 1.0007, centre[1]], [0, 0, 1.0]])
    return Lens(size_px, K, np.array(distortion))


def _standing_at(position_mm: Array, towards_mm: Array, lens: Lens) -> Camera:
    """Stand a camera somewhere, looking at a point, the rig's +y up in the picture."""
    forward = (towards_mm - position_mm) / np.linalg.norm(towards_mm - position_mm)
    right = np.cross(forward, np.array([0.0, 1.0, 0.0]))
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    return Camera(lens, RigidTransform(rotation, -rotation @ position_mm))
