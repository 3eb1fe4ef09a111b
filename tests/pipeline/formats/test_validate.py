from __future__ import annotations

import math
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.errors import ImpastoError
from pipeline.formats.bundle import open_bundle
from pipeline.formats.exr import write_exr
from pipeline.formats.images import write_png

Document = dict[str, Any]
Write = Callable[[Any], Path]
REMOVE = object()
TURN = [[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]
GRAY = {"type": "gray", "axis": "x", "bit": 0, "bits": 4}
PHASE = {"type": "phase", "axis": "y", "period_px": 6.0, "step": 0, "steps": 3}
C0, C2 = ("cameras", "C0"), ("cameras", "C2")
FRONT = ("sequences", 1)
FRAME = (*FRONT, "frames", 3)
CHARUCO = ("boards", "charuco")


def change(document: Document, path: tuple[str | int, ...], value: Any) -> None:
    """Set or remove one value of a document."""
    target: Any = document
    for part in path[:-1]:
        target = target[part]
    if value is REMOVE:
        del target[path[-1]]
    else:
        target[path[-1]] = value


def refuse(folder: Path, *texts: str) -> ImpastoError:
    with pytest.raises(ImpastoError) as info:
        open_bundle(folder)
    message = str(info.value)
    assert info.value.exit_status == 1
    assert "\n" not in message
    assert message.startswith("capture.json: ")
    for text in texts:
        assert text in message
    return info.value


def test_the_bundle_as_it_is_opens(bundle_folder: Path) -> None:
    assert open_bundle(bundle_folder).capture.name == "small"


# Where to change the document, to what, the key that the error must name, and what it must say.
SCHEMA = [
    (("format",), "other", "format", "impasto-capture"),
    (("format",), REMOVE, "format", "missing"),
    (("version",), 2, "version", "1"),
    (("version",), "1", "version", "1"),
    (("version",), 1.5, "version", "1"),
    (("name",), REMOVE, "name", "missing"),
    (("name",), "", "name", "at least 1"),
    (("name",), " ", "name", "empty"),
    (("name",), "a/b", "name", "path"),
    (("name",), "..", "name", "path"),
    (("name",), "a\nb", "name", "control"),
    (("encoding",), "gamma", "encoding", "linear"),
    (("encoding",), REMOVE, "encoding", "missing"),
    (("cameras",), [], "cameras", "[]"),
    ((*C0, "size_px"), REMOVE, "cameras.C0.size_px", "missing"),
    ((*C0, "size_px"), [0, 6], "cameras.C0.size_px[0]", "greater"),
    ((*C0, "size_px"), [8, 6.5], "cameras.C0.size_px[1]", "6.5"),
    ((*C0, "size_px"), [8, 6, 3], "cameras.C0.size_px", "2 items"),
    ((*C0, "size_px"), [8, 10**9], "cameras.C0.size_px[1]", "65536"),
    ((*C0, "size_px"), [65536, 65536], "cameras.C0.size_px", "too large"),
    (("projector", "size_px"), [65536, 65536], "projector.size_px", "too large"),
    ((*C0, "K"), [[1, 0, 0], [0, 1, 0]], "cameras.C0.K[2]", "missing"),
    ((*C0, "K", 0, 0), math.nan, "cameras.C0.K[0][0]", "nan"),
    ((*C0, "distortion", 1), math.inf, "cameras.C0.distortion[1]", "inf"),
    ((*C0, "distortion"), [0, 0, 0, 0], "cameras.C0.distortion[4]", "missing"),
    ((*C2, "responsivity_per_s"), 0, "cameras.C2.responsivity_per_s", "greater than 0"),
    ((*C2, "full_well_e"), -1, "cameras.C2.full_well_e", "greater than 0"),
    ((*C2, "read_noise_e"), -1, "cameras.C2.read_noise_e", "greater than or equal"),
    (("cameras", "C9", "bits"), 0, "cameras.C9.bits", "greater"),
    (("projector", "camera"), REMOVE, "projector.camera", "missing"),
    (("boards", "main", "type"), "dots", "boards.main", "chessboard"),
    (("boards", "main", "type"), REMOVE, "boards.main", "type"),
    (("boards", "main", "square_mm"), 0, "boards.main.square_mm", "greater than 0"),
    (("boards", "main", "inner_corners"), [2, 7], "boards.main.inner_corners[0]", "greater"),
    (("boards", "main", "scale_known"), "no", "boards.main.scale_known", "boolean"),
    ((*CHARUCO, "squares"), [1, 6], "boards.charuco.squares[0]", "greater"),
    ((*CHARUCO, "dictionary"), REMOVE, "boards.charuco.dictionary", "missing"),
    ((*FRONT, "purpose"), "fun", "sequences[1].purpose", "scan"),
    ((*FRONT, "frames"), [], "sequences[1].frames", "at least 1"),
    ((*FRONT, "frames"), REMOVE, "sequences[1].frames", "missing"),
    ((*FRONT, "camera"), REMOVE, "sequences[1].camera", "missing"),
    ((*FRONT, "turntable_deg"), math.nan, "sequences[1].turntable_deg", "nan"),
    ((*FRONT, "turntable_deg"), "0", "sequences[1].turntable_deg", "number"),
    ((*FRAME, "file"), REMOVE, "sequences[1].frames[3].file", "missing"),
    ((*FRAME, "file"), 3, "sequences[1].frames[3].file", "string"),
    ((*FRAME, "exposure_s"), 0, "sequences[1].frames[3].exposure_s", "greater than 0"),
    ((*FRAME, "exposure_s"), -0.1, "sequences[1].frames[3].exposure_s", "greater than 0"),
    ((*FRAME, "pattern"), {"type": "stripes"}, "sequences[1].frames[3].pattern", "gray"),
    ((*FRAME, "pattern"), "white", "sequences[1].frames[3].pattern", "white"),
    ((*FRAME, "pattern"), REMOVE, "sequences[1].frames[3].pattern", "missing"),
    ((*FRAME, "pattern", "axis"), "z", "sequences[1].frames[3].pattern.axis", "'x' or 'y'"),
    ((*FRAME, "pattern", "period_px"), 0, "sequences[1].frames[3].pattern.period_px", "greater"),
    ((*FRAME, "pattern", "sign"), 0, "sequences[1].frames[3].pattern.sign", "1 or -1"),
    ((*FRAME, "pattern", "steps"), REMOVE, "sequences[1].frames[3].pattern.steps", "missing"),
    ((*FRAME, "pattern", "step"), -1, "sequences[1].frames[3].pattern.step", "greater"),
    (
        (*FRAME, "pattern"),
        {"type": "product", "of": [GRAY]},
        "sequences[1].frames[3].pattern.of[1]",
        "missing",
    ),
    (
        (*FRAME, "pattern"),
        {"type": "product", "of": [GRAY, {**PHASE, "axis": 3}]},
        "sequences[1].frames[3].pattern.of[1].axis",
        "'x' or 'y'",
    ),
    (("photos", 0, "exposure_s"), math.nan, "photos[0].exposure_s", "nan"),
    (("photos", 0, "exposure_s"), 0, "photos[0].exposure_s", "greater than 0"),
    (("photos", 0, "camera"), REMOVE, "photos[0].camera", "missing"),
    (("lights", "L3", "intensity"), 0, "lights.L3.intensity", "greater than 0"),
    (("lights", "L3", "position_mm"), [0, 1], "lights.L3.position_mm[2]", "missing"),
    (("turntable", "axis_point_mm"), REMOVE, "turntable.axis_point_mm", "missing"),
    (("turntable", "axis_direction", 2), math.nan, "turntable.axis_direction[2]", "nan"),
    (("darks", 0, "file"), REMOVE, "darks[0].file", "missing"),
    (("colour_target", "target"), REMOVE, "colour_target.target", "missing"),
    (("operator", "note"), math.nan, "operator.note", "nan"),
]
CONTRADICTIONS = [
    ((*C0, "K", 0, 0), -10, "cameras.C0.K", "focal"),
    ((*C0, "K", 1, 1), 0, "cameras.C0.K", "focal"),
    ((*C0, "K", 1, 0), 0.1, "cameras.C0.K", "camera matrix"),
    ((*C0, "K", 2), [0, 0, 2], "cameras.C0.K", "camera matrix"),
    ((*C0, "K"), REMOVE, "cameras.C0.distortion", "without K"),
    (("projector", "distortion"), [0] * 5, None, None),
    (("projector", "K"), [[0, 0, 0], [0, 0, 0], [0, 0, 0]], "projector.K", "camera matrix"),
    (("cameras", "C9", "t_mm"), REMOVE, "cameras.C9.t_mm", "R is given"),
    (("cameras", "C9", "R"), REMOVE, "cameras.C9.R", "t_mm is given"),
    (("cameras", "C9", "R"), TURN, None, None),
    (("cameras", "C9", "R", 0, 0), 1.01, "cameras.C9.R", "not a rotation"),
    (("cameras", "C9", "R", 0, 0), 1e300, "cameras.C9.R", "not a rotation"),
    (("cameras", "C9", "R", 0, 0), -1, "cameras.C9.R", "reflection"),
    (("projector", "R", 1, 2), 0.5, "projector.R", "not a rotation"),
    (("projector", "t_mm"), REMOVE, "projector.t_mm", "R is given"),
    (("projector", "camera"), "C7", "projector.camera", "unknown camera"),
    (("projector",), REMOVE, "sequences[1].purpose", "projector"),
    ((*C2, "lens_of"), "C7", "cameras.C2.lens_of", "unknown camera"),
    ((*C2, "lens_of"), "C2", "cameras.C2.lens_of", "lens of its own"),
    ((*C0, "lens_of"), "C2", "cameras.C0.lens_of", "lens of its own"),
    (("cameras", "C9", "lens_of"), "C2", "cameras.C9.lens_of", "lens of its own"),
    ((*C2, "K"), [[9, 0, 3], [0, 9, 2], [0, 0, 1]], "cameras.C2.K", "the lens is that of 'C0'"),
    ((*C2, "size_px"), [16, 12], "cameras.C2.size_px", "8 x 6"),
    ((*CHARUCO, "marker_mm"), 10, "boards.charuco.marker_mm", "square_mm"),
    ((*CHARUCO, "dictionary"), "DICT_9X9", "boards.charuco.dictionary", "unknown"),
    ((*CHARUCO, "squares"), [30, 30], "boards.charuco.squares", "450 markers"),
    (("turntable", "axis_direction"), [0, 0, 0], "turntable.axis_direction", "length"),
    ((*FRONT, "name"), "board-0", "sequences[1].name", "sequences[0]"),
    ((*FRONT, "name"), "", "sequences[1].name", "at least 1"),
    ((*FRONT, "camera"), "C7", "sequences[1].camera", "unknown camera"),
    ((*FRONT, "board"), "other", "sequences[1].board", "unknown board"),
    ((*FRONT, "light"), "L7", "sequences[1].light", "unknown light"),
    ((*FRONT, "on_turntable"), True, None, None),
    (("sequences", 0, "board"), REMOVE, "sequences[0].board", "no board"),
    (("sequences", 0, "board"), "other", "sequences[0].board", "unknown board"),
    (("sequences", 0, "turntable_deg"), REMOVE, "sequences[0].turntable_deg", "on_turntable"),
    (("sequences", 3, "light"), REMOVE, "sequences[3].light", "no light"),
    (("sequences", 3, "light"), "L7", "sequences[3].light", "unknown light"),
    ((*FRONT, "frames", 2, "pattern", "bit"), 4, "sequences[1].frames[2].pattern.bit", "4"),
    ((*FRAME, "pattern", "step"), 3, "sequences[1].frames[3].pattern.step", "less than 3"),
    (
        (*FRONT, "frames", 4, "pattern", "steps"),
        4,
        "sequences[1].frames[4].pattern.steps",
        "contradicts frames[3]",
    ),
    (
        (*FRONT, "frames", 6, "pattern", "of", 1, "steps"),
        4,
        "sequences[1].frames[6].pattern.of[1].steps",
        "contradicts frames[3]",
    ),
    ((*FRAME, "file"), "scan/000.png", "sequences[1].frames[3].file", "frames[0] too"),
    ((*FRAME, "file"), "./scan/000.png", "sequences[1].frames[3].file", "frames[0] too"),
    (("photos", 1, "camera"), "C7", "photos[1].camera", "unknown camera"),
    (("photos", 1, "light"), "L7", "photos[1].light", "unknown light"),
    (("photos", 0, "pose"), "pose-C7", "photos[0].pose", "unknown sequence"),
    (("photos", 0, "pose"), "front", "photos[0].pose", "a scan sequence"),
    (("photos", 0, "camera"), "C9", "photos[0].pose", "camera 'C2'"),
    (("darks", 0, "camera"), "C7", "darks[0].camera", "unknown camera"),
    (("flats", 0, "camera"), "C7", "flats[0].camera", "unknown camera"),
    (("colour_target", "camera"), "C7", "colour_target.camera", "unknown camera"),
    (("colour_target", "light"), "L7", "colour_target.light", "unknown light"),
    (("lights",), {}, "sequences[3].light", "unknown light"),
    (("cameras", ""), {"size_px": [8, 6]}, "cameras", "at least 1"),
    (("lights", "a\tb"), {}, "lights", "control"),
]


def name_of(case: tuple[Any, ...]) -> str:
    return f"{'.'.join(map(str, case[0]))}={'removed' if case[1] is REMOVE else case[1]}"[:80]


@pytest.mark.parametrize("case", SCHEMA + CONTRADICTIONS, ids=name_of)
def test_each_breach_names_its_key(document: Document, write_document: Write, case: Any) -> None:
    path, value, key, text = case
    change(document, path, value)
    folder = write_document(document)
    if key is None:
        open_bundle(folder)
    else:
        assert refuse(folder, text).where == f"capture.json: {key}"


ABSENT = [
    ("projector", "K"),
    (*C0, "distortion"),
    ("boards", "charuco"),
    ("turntable",),
    (*FRAME, "exposure_s"),
    (*FRONT, "turntable_deg"),
    ("photos", 0, "light"),
    ("photos", 0, "pose"),
    ("photos", 0, "turntable_deg"),
    ("lights", "L3", "intensity"),
    ("lights", "L3", "position_mm"),
    (*C2, "responsivity_per_s"),
    ("darks",),
    ("flats",),
    ("colour_target",),
    ("photos",),
]


@pytest.mark.parametrize("path", ABSENT, ids=lambda p: ".".join(map(str, p)))
def test_what_may_be_left_out_may(
    document: Document, write_document: Write, path: tuple[str | int, ...]
) -> None:
    change(document, path, REMOVE)
    open_bundle(write_document(document))


def test_photographs_alone_need_no_projector(document: Document, write_document: Write) -> None:
    for key in ("projector", "boards", "sequences"):
        del document[key]
    del document["photos"][0]["pose"]
    assert open_bundle(write_document(document)).files("scan") == ()


def test_one_pattern_may_be_shown_at_several_exposures(
    document: Document, write_document: Write, bundle_folder: Path
) -> None:
    shutil.copy(bundle_folder / "scan/000.png", bundle_folder / "scan/long.png")
    frames = document["sequences"][1]["frames"]
    frames.append({**frames[0], "file": "scan/long.png", "exposure_s": 0.08})
    open_bundle(write_document(document))


def test_unknown_keys_are_kept(bundle_folder: Path) -> None:
    extra = open_bundle(bundle_folder).capture.model_extra
    assert extra == {"operator": {"kept": True}}


IMAGE_KEYS = {
    "sequences[1].frames[3].file": (*FRAME, "file"),
    "photos[1].file": ("photos", 1, "file"),
    "darks[0].file": ("darks", 0, "file"),
    "flats[0].file": ("flats", 0, "file"),
    "colour_target.file": ("colour_target", "file"),
}
FILES = {
    "": "empty",
    "/etc/passwd.png": "absolute",
    "../a.png": "leads out",
    "scan/../../a.png": "leads out",
    "C:\\a.png": "absolute",
    "a\\b.png": "backslash",
    "absent.png": "missing",
    "scan": "not a regular file",
    "fifo.png": "not a regular file",
    "link.png": "link",
    "linked/000.png": "link",
    "large.png": "8 x 7 px; expected 8 x 6 px (cameras.",
    "text.png": "not a PNG",
    "empty.png": "not a PNG",
    "cut.png": "truncated",
    "bomb.png": "declares 100000 x 100000 px",
    "palette.png": "colour type 3",
    "alpha.png": "colour type 6",
    "photo.jpg": "unsupported format '.jpg'",
    "scan.exr": "channels H",
}


@pytest.fixture
def bad_files(bundle_folder: Path) -> None:
    good = (bundle_folder / "scan/000.png").read_bytes()
    (bundle_folder / "link.png").symlink_to(bundle_folder / "scan/000.png")
    (bundle_folder / "linked").symlink_to(bundle_folder / "scan")
    os.mkfifo(bundle_folder / "fifo.png")
    write_png(bundle_folder / "large.png", np.zeros((7, 8), np.uint8))
    write_exr(bundle_folder / "scan.exr", {"H": np.zeros((6, 8), np.float32)})
    for name, data in {
        "text.png": b"not an image, but long enough to hold a header",
        "empty.png": b"",
        "cut.png": good[:20],
        "bomb.png": good[:16] + (100_000).to_bytes(4) + (100_000).to_bytes(4) + good[24:],
        "palette.png": good[:25] + b"\x03" + good[26:],
        "alpha.png": good[:25] + b"\x06" + good[26:],
        "photo.jpg": b"\xff\xd8\xff\xe0 and so on",
    }.items():
        (bundle_folder / name).write_bytes(data)


@pytest.mark.usefixtures("bad_files")
@pytest.mark.parametrize("file", FILES, ids=lambda f: f or "empty name")
@pytest.mark.parametrize("key", IMAGE_KEYS)
def test_each_bad_file_is_named_with_its_key(
    document: Document, write_document: Write, file: str, key: str
) -> None:
    change(document, IMAGE_KEYS[key], file)
    error = refuse(write_document(document), repr(file), FILES[file])
    assert error.where == f"capture.json: {key}"


def test_mixed_depths_within_a_sequence_are_refused(
    bundle_folder: Path, document: Document
) -> None:
    file = document["sequences"][1]["frames"][3]["file"]
    write_png(bundle_folder / file, np.zeros((6, 8), np.uint16))
    refuse(bundle_folder, "sequences[1].frames[3].file", file, "uint16", "uint8 as 'scan/000.png'")


def test_depths_may_differ_between_sequences(bundle_folder: Path, document: Document) -> None:
    write_png(bundle_folder / "board/0.png", np.zeros((6, 8), np.uint16))
    open_bundle(bundle_folder)
