from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.errors import ImpastoError
from pipeline.formats.form import Form
from pipeline.formats.height_field import HEIGHT, HeightField, Placement
from pipeline.geometry.rigid import RigidTransform, rotation_about_axis


@pytest.fixture
def field() -> HeightField:
    rng = np.random.default_rng(0)
    heights = rng.normal(size=(12, 20)).astype(np.float32)
    heights[0, :4] = np.nan
    turn = rotation_about_axis(np.array([1.0, 2, 3]), np.array([1.0, -1, 2]), 50)
    filled = np.zeros(heights.shape, bool)
    filled[3, 4] = True
    move = RigidTransform(np.eye(3), np.array([10.0, 20, 500])) @ turn
    return HeightField(heights, np.abs(heights), filled, 0.35, move)


@pytest.fixture
def workspace(field: HeightField, tmp_path: Path) -> Path:
    (tmp_path / "extract").mkdir()
    HEIGHT.save(tmp_path, field)
    return tmp_path


def test_round_trip_to_the_bit(field: HeightField, workspace: Path) -> None:
    read = HEIGHT.load(workspace)
    assert read.heights_mm.tobytes() == field.heights_mm.tobytes()
    assert read.sigma_mm.tobytes() == field.sigma_mm.tobytes()
    assert np.array_equal(read.filled, field.filled)
    assert read.filled.dtype == bool
    assert read.spacing_mm == field.spacing_mm
    assert np.array_equal(read.scan_from_canvas.matrix, field.scan_from_canvas.matrix)
    before = {p: (workspace / p).read_bytes() for p in HEIGHT.files}
    HEIGHT.save(workspace, read)
    assert before == {p: (workspace / p).read_bytes() for p in HEIGHT.files}


def test_the_frame_is_plain_to_others(field: HeightField, workspace: Path) -> None:
    """A reader with nothing but the document puts a sample where it lies."""
    frame = json.loads((workspace / "extract/frame.json").read_text())
    row, column = 5, 7
    canvas = frame["spacing_mm"] * (
        column * np.array(frame["column_direction"]) + row * np.array(frame["row_direction"])
    )
    canvas = canvas + np.array([0, 0, float(field.heights_mm[row, column])])
    scan = np.array(frame["canvas_to_scan"]) @ [*canvas, 1]
    expected = field.scan_from_canvas.apply(field.canvas_points()[row, column])
    assert scan[:3] == pytest.approx(expected)
    assert (frame["rows"], frame["columns"]) == (12, 20)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("rows", 13, "20 x 12"),
        ("columns", 10**9, "20 x 12"),
        ("spacing_mm", -1.0, "spacing_mm"),
        ("canvas_to_scan", [[1, 0], [0, 1]], "canvas_to_scan"),
        ("canvas_to_scan", (2 * np.eye(4)).tolist(), "rigid"),
        ("canvas_to_scan", np.diag([1.0, 1, -1, 1]).tolist(), "rigid"),
        ("row_direction", [0, 1, 0], "row_direction"),
    ],
)
def test_a_wrong_document_is_refused(workspace: Path, key, value, message) -> None:
    path = workspace / "extract/frame.json"
    document = json.loads(path.read_text()) | {key: value}
    path.write_text(json.dumps(document))
    with pytest.raises(ImpastoError, match=message):
        HEIGHT.load(workspace)


def test_form_and_placements_come_back(field: HeightField, workspace: Path) -> None:
    known = np.isfinite(field.heights_mm)
    form = Form(2, (0.5, 0.0, 0.1, 2.0, -1.0, 0.3), (3.0, -2.0), 4.0, 3.2)
    heights = form.heights(12, 20, field.spacing_mm, known)
    whole = replace(
        field,
        form=form,
        form_mm=heights,
        placements=(Placement("front", field.scan_from_canvas), Placement("b", RigidTransform())),
    )
    HEIGHT.save(workspace, whole)
    read = HEIGHT.load(workspace)
    assert read.form == form
    assert read.form_mm is not None
    assert read.form_mm.tobytes() == heights.tobytes()
    assert [p.name for p in read.placements] == ["front", "b"]
    matrix = read.placements[0].scan_from_canvas.matrix
    assert np.array_equal(matrix, field.scan_from_canvas.matrix)
    x, y, z = whole.canvas_points()[5, 7]
    u, v = (x - 3) / 4, (y + 2) / 4
    bulge = 0.5 + 0.1 * v + 2 * u * u - u * v + 0.3 * v * v
    assert z == pytest.approx(field.heights_mm[5, 7] + bulge, abs=1e-5)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("form", {"degree": 9}),
        (
            "form",
            {
                "degree": 1,
                "coefficients_mm": [1],
                "centre_mm": [0, 0],
                "scale_mm": 1,
                "range_mm": 1,
            },
        ),
        ("placements", [{"name": "a", "canvas_to_scan": (2 * np.eye(4)).tolist()}]),
    ],
)
def test_a_wrong_form_or_placement_is_refused(workspace: Path, key, value) -> None:
    path = workspace / "extract/frame.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {key: value}))
    with pytest.raises(ImpastoError, match=key):
        HEIGHT.load(workspace)
