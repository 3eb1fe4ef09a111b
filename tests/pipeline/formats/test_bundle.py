from __future__ import annotations

import contextlib
import json
import shutil
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pipeline.errors import ImpastoError
from pipeline.formats.bundle import Bundle, open_bundle
from pipeline.formats.exr import write_exr
from pipeline.formats.images import srgb_to_linear, write_png

Write = Callable[[Any], Path]


def test_sequences_and_files_by_purpose(bundle_folder: Path) -> None:
    bundle = open_bundle(bundle_folder)
    assert [s.name for s in bundle.sequences("scan")] == ["front"]
    assert bundle.files("scan") == tuple(f"scan/{i:03d}.png" for i in range(7))
    assert bundle.files("pose", "light") == ("lamp/0.png", "pose/0.png")
    photos = ("dark.png", "flat.png", "photos/1.png", "photos/2.png", "target.png")
    assert bundle.files("photos") == photos
    assert bundle.files() == ()
    with pytest.raises(ValueError, match="darks"):
        bundle.files("darks")


def test_integers_are_read_as_parts_of_full_scale(bundle_folder: Path) -> None:
    bundle = open_bundle(bundle_folder)
    grey, colour = bundle.read("scan/001.png"), bundle.read("photos/1.png")
    assert (grey.shape, grey.dtype, bundle.full_scale("scan/001.png")) == ((6, 8), np.float32, 255)
    np.testing.assert_allclose(grey, 20 / 255, rtol=1e-6)
    assert (colour.shape, bundle.full_scale("photos/1.png")) == ((6, 8, 3), 65535)
    stored = bundle.read_stored("photos/1.png")
    assert stored.dtype == np.uint16
    np.testing.assert_array_equal(stored.ravel(), np.arange(144) * 400)
    np.testing.assert_allclose(colour, stored / 65535, rtol=1e-6)


def test_full_scale_is_exactly_one(bundle_folder: Path) -> None:
    for dtype in (np.uint8, np.uint16):
        write_png(bundle_folder / "dark.png", np.full((6, 8), np.iinfo(dtype).max, dtype))
        assert np.all(open_bundle(bundle_folder).read("dark.png") == 1.0)


def test_srgb_is_decoded_but_exr_is_always_linear(
    bundle_folder: Path, document: dict[str, Any], write_document: Write
) -> None:
    document["encoding"] = "srgb"
    document["photos"][1]["file"] = "photo.exr"
    half = np.full((6, 8), 0.5, np.float32)
    write_exr(bundle_folder / "photo.exr", dict.fromkeys("RGB", half))
    bundle = open_bundle(write_document(document))
    np.testing.assert_array_equal(bundle.read("photo.exr"), 0.5)
    assert bundle.full_scale("photo.exr") == 1.0
    for file in ("scan/001.png", "photos/1.png"):
        expected = srgb_to_linear(bundle.read_stored(file) / bundle.full_scale(file))
        read = bundle.read(file)
        assert read.dtype == np.float32
        np.testing.assert_allclose(read, expected, rtol=1e-6)


def test_a_read_image_belongs_to_the_reader(bundle_folder: Path) -> None:
    bundle = open_bundle(bundle_folder)
    bundle.read("dark.png")[:] = 7
    assert bundle.read("dark.png").max() <= 1


def test_errors_of_an_image_name_the_file_and_the_key(bundle_folder: Path) -> None:
    bundle = open_bundle(bundle_folder)
    path = bundle_folder / "photos/1.png"
    data = path.read_bytes()
    assert bundle.where("photos/1.png") == "capture.json: photos[0].file"
    path.write_bytes(data[:-20])
    open_bundle(bundle_folder)  # the header is whole
    with pytest.raises(ImpastoError) as info:
        bundle.read("photos/1.png")
    assert str(info.value).startswith(
        "capture.json: photos[0].file: 'photos/1.png' is truncated or corrupt"
    )
    write_png(path, np.zeros((6, 9, 3), np.uint16))
    with pytest.raises(ImpastoError, match=r"photos\[0\].file: 'photos/1.png' has changed"):
        bundle.read("photos/1.png")
    path.unlink()
    path.symlink_to(bundle_folder / "dark.png")
    with pytest.raises(ImpastoError, match=r"photos\[0\].file: 'photos/1.png' .* link"):
        bundle.read_stored("photos/1.png")


def test_names_outside_the_document_cannot_lead_out(bundle_folder: Path) -> None:
    shutil.copy(bundle_folder / "dark.png", bundle_folder.parent / "outside.png")
    bundle = open_bundle(bundle_folder)
    with pytest.raises(ImpastoError, match="leads out"):
        bundle.read("../outside.png")


def test_a_bundle_made_by_hand_reads_its_headers_when_needed(bundle_folder: Path) -> None:
    capture = open_bundle(bundle_folder).capture
    assert Bundle(bundle_folder, capture).full_scale("dark.png") == 65535


def test_frames_have_labels(bundle_folder: Path) -> None:
    bundle = open_bundle(bundle_folder)
    label = bundle.frame_label(bundle.sequences("scan")[0], 2)
    assert label == "scan/002.png (gray x bit 0 of 4, frame 2 of front)"


def test_what_is_no_bundle_is_said(tmp_path: Path, bundle_folder: Path) -> None:
    (tmp_path / "file").write_text("x")
    (tmp_path / "linked").mkdir()
    (tmp_path / "linked" / "capture.json").symlink_to(bundle_folder / "capture.json")
    (tmp_path / "empty").mkdir()
    for name, message in {
        "absent": "absent: the folder does not exist; expected a capture bundle",
        "file": "file: is not a folder",
        "empty": "capture.json: is missing; expected a capture bundle",
        "linked": "capture.json: is reached through the link",
    }.items():
        with pytest.raises(ImpastoError, match=message) as info:
            open_bundle(tmp_path / name)
        assert info.value.exit_status == 1
        assert "\n" not in str(info.value)


@pytest.mark.parametrize(
    "content", [b"", b"{", b"[]", b"\xff\xfe{}", b'{"a":' * 9999, b"\x89PNG\r\n", b"{}", b"null"]
)
def test_a_document_that_is_none_is_refused(write_document: Write, content: bytes) -> None:
    folder = write_document(content)
    with pytest.raises(ImpastoError, match=r"^capture\.json: ") as info:
        open_bundle(folder)
    assert "\n" not in str(info.value)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(
    changes=st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 255)), min_size=1, max_size=5)
)
def test_a_damaged_document_opens_or_is_refused(
    document: dict[str, Any], write_document: Write, changes: list[tuple[int, int]]
) -> None:
    data = bytearray(json.dumps(document).encode())
    for at, value in changes:
        data[at % len(data)] = value
    folder = write_document(bytes(data))
    with contextlib.suppress(ImpastoError):
        open_bundle(folder)


values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=2)
    ),
    max_leaves=4,
)


def places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    inner: Iterable[tuple[Any, Any]] = ()
    if isinstance(value, dict):
        inner = value.items()
    elif isinstance(value, list):
        inner = enumerate(value)
    return [path] * bool(path) + [p for k, v in inner for p in places(v, (*path, k))]


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(data=st.data())
def test_any_value_anywhere_opens_or_is_refused_in_one_line(
    document: dict[str, Any], write_document: Write, data: st.DataObject
) -> None:
    changed = json.loads(json.dumps(document))
    path = data.draw(st.sampled_from(places(changed)))
    target = changed
    for part in path[:-1]:
        target = target[part]
    target[path[-1]] = data.draw(values)
    try:
        open_bundle(write_document(json.dumps(changed)))
    except ImpastoError as error:
        message = str(error)
        assert message.startswith("capture.json: ")
        assert "\n" not in message


def test_five_hundred_headers_are_quick(
    bundle_folder: Path, document: dict[str, Any], write_document: Write
) -> None:
    for i in range(500):
        file = f"photos/many-{i}.png"
        shutil.copy(bundle_folder / "dark.png", bundle_folder / file)
        document["darks"].append({"file": file, "camera": "C2"})
    folder = write_document(document)
    open_bundle(folder)
    start = time.perf_counter()
    open_bundle(folder)
    assert time.perf_counter() - start < 0.5


@pytest.mark.shared_data
@pytest.mark.parametrize(("name", "scan", "photos"), [("eye", 18, 0), ("painting", 93, 33)])
def test_the_development_captures_open(
    shared_data: Callable[[str], Path], name: str, scan: int, photos: int
) -> None:
    bundle = open_bundle(shared_data(name))
    assert len(bundle.files("scan")) == scan
    assert len(bundle.files("photos")) == photos
    image = bundle.read(bundle.files("scan")[0])
    assert image.shape == bundle.capture.cameras["C0"].size_px[::-1]
