"""A whole simulated capture: boards, scan and photographs into a bundle, the truth beside it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hardware.acquisition import Coding, PhotoPlan, Progress, SequencePlan, acquire, coded
from hardware.simulated.layout import BOARD, SCAN_CAMERA, Layout, lay_out
from hardware.simulated.painting import paint
from hardware.simulated.rig import Bench, Physics
from hardware.simulated.subjects import (
    BoardInAir,
    PaintedCanvas,
    PaintingOnTable,
    Subject,
)
from hardware.simulated.truth import write_truth
from pipeline.formats.bundle_writer import BundleWriter
from pipeline.formats.patterns import Pattern
from pipeline.geometry.camera import Camera, Lens

VERSION = 1
"""Of everything that decides a capture's bytes, together with its setting."""

PAINTING = "painting"
ANGLES = 8


@dataclass(frozen=True)
class Setting:
    """How large and how long a capture is.

    Parameters
    ----------
    spacing_mm
        Of the painting's own grid.
    boards
        Board poses; with 0, cameras and projector are given instead of calibrated.
    patterns
        Of the scan.
    exposures
        Of the scan, relative to the metered one.
    tests
        Noise-free photographs from other places, among the truth.
    """

    seed: int = 1
    scan_px: tuple[int, int] = (640, 480)
    photo_px: tuple[int, int] = (560, 420)
    projector_px: tuple[int, int] = (1024, 768)
    spacing_mm: float = 0.2
    boards: int = 8
    photos: int = 32
    patterns: tuple[Pattern, ...] = coded(
        Coding("x", bits=7, cell_px=8, periods_px=(16,), steps=5),
        Coding("y", bits=7, cell_px=8, periods_px=(16,), steps=5),
    )
    exposures: tuple[float, ...] = (0.4, 2.4)
    stored_bits: int = 16
    tests: int = 3
    physics: Physics = field(default_factory=Physics)


def record(setting: Setting, bundle_folder: Path, truth_folder: Path, progress: Progress) -> None:
    """Record a painting into a new bundle, and its truth into a folder of its own.

    Raises
    ------
    ImpastoError
        The bundle's folder holds a bundle already, or cannot be written to.
    """
    writer = BundleWriter(bundle_folder)
    progress("painting", 0, 1)
    canvas = PaintedCanvas(paint(setting.seed, setting.spacing_mm))
    layout = lay_out(setting.scan_px, setting.photo_px, setting.projector_px, setting.boards)
    bench = Bench(layout, subjects(layout, canvas), setting.physics, setting.seed)
    taken = acquire(
        bench.rig(),
        writer,
        [*board_plans(setting), scan_plan(setting)],
        photo_plans(setting, layout),
        progress,
    )
    progress("truth", 0, 1)
    write_truth(truth_folder, layout, canvas, setting.physics, setting.seed, setting.tests)
    writer.close(describe(setting, layout) | taken)


def subjects(layout: Layout, canvas: PaintedCanvas) -> dict[str, Callable[[float], Subject]]:
    """Return what can be put before the cameras."""
    camera = layout.cameras[SCAN_CAMERA]

    def painting(angle_deg: float) -> Subject:
        return PaintingOnTable(canvas, layout.turned(angle_deg))

    def board(name: str, _: float) -> Subject:
        pose = layout.boards[name]
        # What one of 2 x 2 rays covers.
        grain = float(camera.depth(pose.translation_mm)) / camera.lens.K[0, 0] / 2
        return BoardInAir(BOARD, pose, grain)

    made: dict[str, Callable[[float], Subject]] = {PAINTING: painting}
    return made | {name: partial(board, name) for name in layout.boards}


def scan_plan(setting: Setting) -> SequencePlan:
    """Plan the scan."""
    return SequencePlan(
        "front",
        "scan",
        SCAN_CAMERA,
        setting.patterns,
        PAINTING,
        setting.exposures,
        8 if setting.stored_bits == 8 else 16,
    )


def board_plans(setting: Setting) -> list[SequencePlan]:
    """Plan the board poses: coarser patterns, and 8 bits are enough."""
    bits = [int(np.ceil(np.log2(size / 16))) for size in setting.projector_px]
    patterns = coded(
        Coding("x", bits=bits[0], cell_px=16, periods_px=(32,), steps=4),
        Coding("y", bits=bits[1], cell_px=16, periods_px=(32,), steps=4),
    )
    return [
        SequencePlan(
            f"board-{number}",
            "calibrate",
            SCAN_CAMERA,
            patterns,
            f"board-{number}",
            stored_bits=8,
            keys={"board": "main"},
        )
        for number in range(setting.boards)
    ]


def photo_plans(setting: Setting, layout: Layout) -> list[PhotoPlan]:
    """Plan the photographs: all pairs of station and stop in turn, at eight angles of the table."""
    stops = sorted(layout.stops)
    stations = sorted(name for name in layout.cameras if name != SCAN_CAMERA)
    plans = [
        PhotoPlan(
            stations[(i // len(stops) + i % len(stops)) % len(stations)],
            stops[i % len(stops)],
            360.0 / ANGLES * ((3 * i + i // ANGLES) % ANGLES),
            PAINTING,
        )
        for i in range(setting.photos)
    ]
    return sorted(plans, key=lambda plan: (plan.turntable_deg, plan.camera, plan.stop))


def describe(setting: Setting, layout: Layout) -> dict[str, Any]:
    """Return the document but for what was taken.

    The stations, the lamp's stops and the table are given, as a rig knows them that was measured
    once. Of the scan camera and the projector only the camera's pose is given where board
    sequences are there to calibrate them.
    """
    sensor = setting.physics.sensor
    body = {
        "responsivity_per_s": sensor.responsivity_per_s,
        "full_well_e": sensor.full_well_e,
        "read_noise_e": sensor.read_noise_e,
        "bits": sensor.bits,
    }
    cameras: dict[str, Any] = {}
    for name, camera in layout.cameras.items():
        entry: dict[str, Any] = {"size_px": list(camera.lens.size_px)}
        if name == "C1" or (name == SCAN_CAMERA and not setting.boards):
            entry |= lens_entry(camera.lens)
        elif name != SCAN_CAMERA:
            entry["lens_of"] = "C1"
        cameras[name] = entry | pose_entry(camera) | body
    projector: dict[str, Any] = {"size_px": list(setting.projector_px), "camera": SCAN_CAMERA}
    if not setting.boards:
        from_camera = layout.projector.pose @ layout.cameras[SCAN_CAMERA].pose.inverse()
        projector |= lens_entry(layout.projector.lens)
        projector |= pose_entry(replace(layout.projector, pose=from_camera))
    document: dict[str, Any] = {
        "format": "impasto-capture",
        "version": 1,
        "name": f"simulated-{setting.seed}",
        "encoding": "linear",
        "cameras": cameras,
        "projector": projector,
        "lights": {
            name: {"position_mm": place.tolist(), "intensity": setting.physics.lamp_intensity}
            for name, place in layout.stops.items()
        },
        "turntable": {"axis_point_mm": [0.0, 0.0, 0.0], "axis_direction": [0.0, 0.0, 1.0]},
    }
    if setting.boards:
        document["boards"] = {
            "main": {
                "type": "chessboard",
                "inner_corners": list(BOARD.inner_corners),
                "square_mm": BOARD.square_mm,
            }
        }
    return document


def lens_entry(lens: Lens) -> dict[str, Any]:
    """Return a lens as the document has it."""
    return {"K": lens.K.tolist(), "distortion": lens.distortion.tolist()}


def pose_entry(camera: Camera) -> dict[str, Any]:
    """Return a pose as the document has it."""
    return {
        "R": camera.pose.rotation.tolist(),
        "t_mm": camera.pose.translation_mm.tolist(),
    }
