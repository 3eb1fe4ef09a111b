"""A small bundle that uses every kind of entry of the bundle page."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.formats.images import write_png

Document = dict[str, Any]
IDENTITY = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
K = [[10.0, 0, 3.5], [0, 10.0, 2.5], [0, 0, 1]]


@pytest.fixture
def document() -> Document:
    """A valid capture.json whose images are 8 x 6 px."""
    gray = {"type": "gray", "axis": "x", "bit": 0, "bits": 4, "cell_px": 1, "inverted": False}
    phases = [
        {"type": "phase", "axis": "y", "period_px": 6.0, "step": k, "steps": 3} for k in range(3)
    ]
    product = {"type": "product", "of": [gray, phases[0]]}
    patterns = [{"type": "white"}, {"type": "black"}, gray, *phases, product]
    scan = [
        {"file": f"scan/{i:03d}.png", "pattern": p, "exposure_s": 0.02}
        for i, p in enumerate(patterns)
    ]
    white = {"type": "white"}
    entries = {
        "format": "impasto-capture",
        "version": 1,
        "name": "small",
        "encoding": "linear",
        "operator": {"kept": True},
        "cameras": {
            "C0": {"size_px": [8, 6], "K": K, "distortion": [0, 0, 0, 0, 0]},
            "C2": {"size_px": [8, 6], "lens_of": "C0", "responsivity_per_s": 100.0},
            "C9": {"size_px": [8, 6], "R": IDENTITY, "t_mm": [0, 0, 900.0], "bits": 12},
        },
        "projector": {
            "size_px": [16, 12], "K": K, "camera": "C0", "R": IDENTITY, "t_mm": [100.0, 0, 0],
        },
        "boards": {
            "main": {"type": "chessboard", "inner_corners": [9, 7], "square_mm": 10.0},
            "charuco": {
                "type": "charuco", "squares": [8, 6], "square_mm": 10.0, "marker_mm": 7.0,
                "dictionary": "DICT_5X5_100", "scale_known": False,
            },
        },
        "sequences": [
            {"name": "board-0", "purpose": "calibrate", "camera": "C0", "board": "main",
             "on_turntable": True, "turntable_deg": 40.0,
             "frames": [{"file": "board/0.png", "pattern": white}]},
            {"name": "front", "purpose": "scan", "camera": "C0", "turntable_deg": 0.0,
             "frames": scan},
            {"name": "pose-C2", "purpose": "pose", "camera": "C2", "turntable_deg": 45.0,
             "frames": [{"file": "pose/0.png", "pattern": gray}]},
            {"name": "lamp-L3", "purpose": "light", "camera": "C9", "light": "L3",
             "frames": [{"file": "lamp/0.png", "pattern": gray}]},
        ],
        "photos": [
            {"file": "photos/1.png", "camera": "C2", "pose": "pose-C2", "turntable_deg": 45.0,
             "light": "L3", "exposure_s": 0.02},
            {"file": "photos/2.png", "camera": "C9", "light": "L3"},
        ],
        "lights": {"L3": {"position_mm": [0, 0, 1000.0], "intensity": 1.0}},
        "turntable": {"axis_point_mm": [0, 0, 0], "axis_direction": [0, 0, 1]},
        "darks": [{"file": "dark.png", "camera": "C2", "exposure_s": 0.02}],
        "flats": [{"file": "flat.png", "camera": "C2", "exposure_s": 0.02}],
        "colour_target": {
            "file": "target.png", "camera": "C2", "light": "L3", "target": "ColorChecker 2005",
        },
    }  # fmt: skip
    return json.loads(json.dumps(entries))  # every value its own


def frame_files(document: Document) -> list[str]:
    """List the files of all sequences."""
    return [f["file"] for s in document["sequences"] for f in s["frames"]]


@pytest.fixture
def bundle_folder(tmp_path: Path, document: Document) -> Path:
    """The images of :func:`document`: 8-bit grey frames, 16-bit RGB photographs."""
    folder = tmp_path / "bundle"
    for i, file in enumerate(frame_files(document)):
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        write_png(folder / file, np.full((6, 8), 10 * i, np.uint8))
    (folder / "photos").mkdir()
    colour = np.arange(6 * 8 * 3, dtype=np.uint16).reshape(6, 8, 3) * 400
    for file in ("photos/1.png", "photos/2.png", "dark.png", "flat.png", "target.png"):
        write_png(folder / file, colour)
    (folder / "capture.json").write_text(json.dumps(document))
    return folder


@pytest.fixture
def write_document(bundle_folder: Path) -> Callable[[Any], Path]:
    """Write another capture.json (a document, a text or bytes) and return the folder."""

    def write(content: Any) -> Path:
        if not isinstance(content, str | bytes):
            content = json.dumps(content)
        data = content.encode() if isinstance(content, str) else content
        (bundle_folder / "capture.json").write_bytes(data)
        return bundle_folder

    return write
