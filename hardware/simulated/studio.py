"""A whole simulated capture: the rig is set up, boards, scan and photographs are recorded."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware.acquisition import Acquisition, PatternPlan
from hardware.simulated.optics import BoardSolid, PaintingSolid
from hardware.simulated.painting import paint
from hardware.simulated.rig import (
    LAMP_INTENSITY,
    Bench,
    SimulatedCamera,
    SimulatedLampArc,
    SimulatedProjector,
    SimulatedTurntable,
    standing_at,
)
from hardware.simulated.truth import write_truth
from pipeline.formats.bundle_writer import BundleWriter
from pipeline.geometry.camera import Camera, Lens
from pipeline.geometry.rigid import RigidTransform, rotation_about_axis

Array = NDArray[np.float64]

CORNERS, SQUARE_MM = (9, 6), 13.0
LAMP_RADIUS_MM = 700.0


@dataclass(frozen=True)
class Setting:
    """How large and how long a capture is."""

    seed: int = 1
    scan_px: tuple[int, int] = (640, 480)
    photo_px: tuple[int, int] = (384, 288)
    projector_px: tuple[int, int] = (1024, 768)
    spacing_mm: float = 0.25
    boards: int = 6
    photos: int = 30
    exposures_s: tuple[float, ...] = (0.012, 0.05)
    steps: int = 5
    stored_bits: int = 16


def lens(size_px: tuple[int, int], field_deg: float, distortion: tuple[float, ...]) -> Lens:
    """Return a lens of a horizontal field of view, its centre a little off."""
    width, height = size_px
    focal = width / (2 * np.tan(np.deg2rad(field_deg) / 2))
    K = np.array(
        [[focal, 0, 0.507 * (width - 1)], [0, focal * 1.001, 0.492 * (height - 1)], [0, 0, 1.0]]
    )
    return Lens(size_px, K, np.array(distortion))


def make_bench(setting: Setting) -> Bench:
    """Stand the devices around the table."""
    centre = np.array([0.0, 0.0, 8.0])
    photo_lens = lens(setting.photo_px, 19.0, (-0.06, 0.05, 0.0003, -0.0004, 0.0))
    cameras = {
        "C0": standing_at(
            np.array([20.0, -30.0, 900.0]),
            centre,
            lens(setting.scan_px, 14.5, (-0.1, 0.12, 0.0004, -0.0003, 0.0)),
        )
    }
    places = ((150.0, -420.0, 640.0), (-330.0, -250.0, 660.0), (260.0, 120.0, 730.0))
    for number, place in enumerate(places, start=1):
        cameras[f"C{number}"] = standing_at(np.array(place), centre, photo_lens)
    projector = standing_at(
        np.array([-290.0, 40.0, 880.0]),
        centre,
        lens(setting.projector_px, 17.0, (0.04, -0.05, 0.0002, 0.0003, 0.0)),
    )
    lamps = {}
    for number, elevation in enumerate((18.0, 40.0, 62.0, 84.0, 125.0)):
        angle = np.deg2rad(elevation)
        direction = np.array([0.1, np.cos(angle), np.sin(angle)])
        lamps[f"L{number}"] = LAMP_RADIUS_MM * direction
    return Bench(cameras, projector, lamps, setting.seed)


def board_poses(count: int) -> list[RigidTransform]:
    """Hold the board in different places, tilted differently, above the table."""
    columns, rows = CORNERS
    to_middle = RigidTransform(np.eye(3), -SQUARE_MM / 2 * np.array([columns - 1, rows - 1, 0.0]))
    poses = []
    for number in range(count):
        around, tilt = 2.4 * number, (0.0, 22.0, 32.0, 27.0)[number % 4]
        axis = np.array([np.cos(around), np.sin(around), 0.0])
        turned = rotation_about_axis(np.zeros(3), axis, tilt)
        spun = rotation_about_axis(np.zeros(3), np.array([0.0, 0.0, 1.0]), 17.0 * number - 40)
        place = np.array(
            [18 * np.cos(3 * around), 14 * np.sin(2 * around), 20.0 + 12 * (number % 3)]
        )
        poses.append(RigidTransform(np.eye(3), place) @ turned @ spun @ to_middle)
    return poses


def record(
    setting: Setting,
    bundle_folder: Path,
    truth_folder: Path,
    progress: Callable[[str, int, int], None],
) -> None:
    """Record a painting into a new bundle, and its truth into a folder of its own."""
    bench, scene = make_bench(setting), paint(setting.seed, setting.spacing_mm)
    rig_from_object = RigidTransform(np.eye(3), np.array([3.0, -2.0, 0.0])) @ rotation_about_axis(
        np.zeros(3), np.array([0.0, 0.0, 1.0]), 1.5
    )
    solid = PaintingSolid(scene)
    writer = BundleWriter(bundle_folder)
    acquisition = Acquisition(
        writer, SimulatedProjector(bench), SimulatedTurntable(bench), SimulatedLampArc(bench)
    )
    _record_boards(setting, bench, acquisition, progress)
    bench.place(solid, rig_from_object)
    progress("scan", 0, 1)
    acquisition.sequence(
        SimulatedCamera(bench, "C0", colour=False, stored_bits=setting.stored_bits),
        pattern_plan(setting, period_px=16, inverted=True).patterns(),
        setting.exposures_s,
        name="front",
        purpose="scan",
        camera_name="C0",
    )
    stops = sorted(bench.lamps)
    for number in range(setting.photos):
        progress("photographs", number, setting.photos)
        name = f"C{1 + number % 3}"
        acquisition.photograph(
            SimulatedCamera(bench, name, colour=True, stored_bits=16, samples=1),
            camera_name=name,
            stop=stops[number % len(stops)],
            turntable_deg=round(360.0 * (number * 7 % max(setting.photos, 1)) / setting.photos, 3),
            exposure_s=0.064,
        )
    write_truth(truth_folder, bench, scene, solid, rig_from_object)
    writer.close(_document(setting, bench, acquisition))


def pattern_plan(setting: Setting, *, period_px: int, inverted: bool) -> PatternPlan:
    """Plan both axes: Gray code in cells of half a period, and phase."""
    cell = period_px // 2
    width, height = setting.projector_px
    return PatternPlan(
        periods_px={"x": period_px, "y": period_px},
        cells_px={"x": cell, "y": cell},
        bits={"x": int(np.ceil(np.log2(width / cell))), "y": int(np.ceil(np.log2(height / cell)))},
        steps=setting.steps,
        inverted=inverted,
    )


def _record_boards(
    setting: Setting,
    bench: Bench,
    acquisition: Acquisition,
    progress: Callable[[str, int, int], None],
) -> None:
    board = BoardSolid(CORNERS, SQUARE_MM)
    patterns = pattern_plan(setting, period_px=32, inverted=False).patterns()
    for number, pose in enumerate(board_poses(setting.boards)):
        progress("boards", number, setting.boards)
        bench.place(board, pose)
        acquisition.sequence(
            SimulatedCamera(bench, "C0", colour=False, stored_bits=8),
            patterns,
            setting.exposures_s[:1],
            name=f"board-{number}",
            purpose="calibrate",
            camera_name="C0",
            board="main",
        )


def _document(setting: Setting, bench: Bench, acquisition: Acquisition) -> dict[str, Any]:
    def entry(camera: Camera) -> dict[str, Any]:
        return {
            "size_px": list(camera.lens.size_px),
            "K": camera.lens.K.tolist(),
            "distortion": camera.lens.distortion.tolist(),
            "R": camera.pose.rotation.tolist(),
            "t_mm": camera.pose.translation_mm.tolist(),
            "responsivity_per_s": bench.sensor.responsivity_per_s,
            "full_well_e": bench.sensor.full_well_e,
            "read_noise_e": bench.sensor.read_noise_e,
            "bits": bench.sensor.bits,
        }

    return {
        "format": "impasto-capture",
        "version": 1,
        "name": f"simulated painting {setting.seed}",
        "encoding": "linear",
        "cameras": {name: entry(camera) for name, camera in bench.cameras.items()},
        "projector": {"size_px": list(setting.projector_px), "camera": "C0"},
        "boards": {
            "main": {"type": "chessboard", "inner_corners": list(CORNERS), "square_mm": SQUARE_MM}
        },
        "sequences": acquisition.sequences,
        "photos": acquisition.photos,
        "lights": {
            name: {"position_mm": place.tolist(), "intensity": LAMP_INTENSITY}
            for name, place in bench.lamps.items()
        },
        "turntable": {"axis_point_mm": [0.0, 0.0, 0.0], "axis_direction": [0.0, 0.0, 1.0]},
    }
