"""Cameras and lamps found through the canvas against a capture's truth.

    python benchmarks/stations.py WORKSPACE TRUTH

All in the canvas's frame, the found canvas laid over the true one by its relief: the scan camera's
own calibration shifts the whole rig. Ends with status 1 if a target is missed: cameras within
0.5 mm, lamps within 0.6 mm, the axis within 0.05 mm where it passes through the canvas.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from pipeline.formats.calibration import CALIBRATION
from pipeline.formats.height_field import HEIGHT, HeightField
from pipeline.formats.reflectance_maps import SAMPLES, FoundCamera
from pipeline.geometry.rigid import RigidTransform
from pipeline.report.alignment import TrueSurface, align

CAMERA_MM, LAMP_MM, AXIS_MM = 0.5, 0.6, 0.05
MOST_POINTS = 60_000
AXIS = ("axis_point_mm", "axis_direction")


def main(workspace: Path, truth: Path) -> int:
    """Print the table; return 1 if a target is missed."""
    document = json.loads((truth / "truth.json").read_text())
    field = HEIGHT.load(workspace)
    rig = RigidTransform.from_matrix(np.array(document["rig_from_canvas"]))
    to_true = canvas_alignment(field, truth, rig, document)
    missed = 0
    print(f"{'sequence':12} {'centre':>9} {'turn':>9} {'stated':>9} {'RMS':>9} {'points':>7}")
    for found in SAMPLES.load(workspace).cameras:
        centre, turn, limit = errors(found, to_true, rig, document)
        missed += centre > limit
        print(
            f"{found.sequence:12} {centre:6.3f} mm {turn:5.3f} deg {found.sigma_mm:6.3f} mm "
            f"{found.rms_px:6.3f} px {found.points:7d}"
        )
    shift = axis_error(workspace, field, to_true, rig, document)
    print(f"{'axis':12} {shift:6.3f} mm in the canvas's plane")
    missed += shift > AXIS_MM
    print(f"targets missed: {missed}")
    return int(missed > 0)


def canvas_alignment(
    field: HeightField, truth: Path, rig: RigidTransform, document: dict[str, dict[str, object]]
) -> RigidTransform:
    """Return the motion from the found canvas's frame to the true one's."""
    with np.load(truth / "surface.npz") as arrays:
        heights = np.where(arrays["mask"], arrays["height_mm"].astype(np.float64), np.nan)
        surface = TrueSurface(arrays["x_mm"].astype(float), arrays["y_mm"].astype(float), heights)
    start = rig.inverse()
    scan = _pose(document["cameras"]["C0"]) @ rig
    points = field.canvas_points()[np.isfinite(field.heights_mm)]
    in_scan = field.scan_from_canvas.apply(points)
    in_rig = np.abs(start.apply(in_scan)[:, 2]).mean() < 25
    start = start if in_rig else scan.inverse()
    points = points[:: max(1, len(points) // MOST_POINTS)]
    return align(points, surface, start @ field.scan_from_canvas)


def errors(
    found: FoundCamera,
    to_true: RigidTransform,
    rig: RigidTransform,
    document: dict[str, dict[str, object]],
) -> tuple[float, float, float]:
    """Return error of centre, mm, and orientation, degrees, and the centre's limit."""
    centre = to_true.apply(found.camera.centre_mm)
    if found.light is None:
        true = _pose(document["cameras"][found.name]) @ rig
        turn = (found.camera.pose @ to_true.inverse()).rotation @ true.rotation.T
        angle = float(np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))))
        return float(np.linalg.norm(centre - true.inverse().translation_mm)), angle, CAMERA_MM
    lamp = np.array(document["lamps"][found.light]["position_mm"])
    return float(np.linalg.norm(centre - rig.inverse().apply(lamp))), float("nan"), LAMP_MM


def axis_error(
    workspace: Path,
    field: HeightField,
    to_true: RigidTransform,
    rig: RigidTransform,
    document: dict[str, dict[str, object]],
) -> float:
    """Return how far apart the found and the true axis pass through the canvas's plane, mm."""
    table = CALIBRATION.load(workspace).turntable
    if table is None:
        return float("inf")
    frame, back = to_true @ field.scan_from_canvas.inverse(), rig.inverse()
    found = frame.apply(table.axis_point_mm), frame.rotate(table.axis_direction)
    true = [np.array(document["turntable"][key], float) for key in AXIS]
    expected = back.apply(true[0]), back.rotate(true[1])
    at = [point - point[2] / direction[2] * direction for point, direction in (found, expected)]
    return float(np.linalg.norm(at[0] - at[1]))


def _pose(entry: object) -> RigidTransform:
    assert isinstance(entry, dict)
    return RigidTransform(np.array(entry["R"]), np.array(entry["t_mm"]))


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("usage: stations.py WORKSPACE TRUTH")
    sys.exit(main(Path(sys.argv[1]), Path(sys.argv[2])))
