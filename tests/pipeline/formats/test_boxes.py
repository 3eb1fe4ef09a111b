from __future__ import annotations

import io
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.errors import ImpastoError
from pipeline.formats.boxes import BOXES, Boxes, Relief, read_boxes, write_boxes

BOX = Boxes(
    d0_mm=0.25,
    top_mm=2.5,
    cell=8,
    position=np.array([[0, 0], [8, 16]], np.int32),
    size=np.array([[8, 8], [4, 8]], np.int32),
    highest_mm=np.array([1, 2.5], np.float32),
    highest_at=np.array([[8, 8], [10, 20]], np.int32),
)


def arrays() -> dict[str, np.ndarray]:
    found = {name: np.asarray(value) for name, value in vars(BOX).items()}
    return found | {"cell": np.asarray(BOX.cell, np.int32)}


def write_members(path: Path, members: dict[str, bytes], compress: int = zipfile.ZIP_STORED):
    with zipfile.ZipFile(path, "w", compress) as archive:
        for name, data in members.items():
            archive.writestr(name, data)


def npy(array: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, array)
    return buffer.getvalue()


def test_round_trip_and_numpy_reads_it(tmp_path: Path) -> None:
    path = tmp_path / "boxes.npz"
    write_boxes(path, BOX)
    first = path.read_bytes()
    write_boxes(path, BOX)
    assert path.read_bytes() == first
    read = read_boxes(path, (25, 30))
    for name, value in vars(BOX).items():
        assert np.array_equal(getattr(read, name), value)
    with np.load(path, allow_pickle=False) as file:
        assert file["position"].dtype == np.int32
        assert file["d0_mm"].shape == ()


def test_relief_round_trip(tmp_path: Path) -> None:
    (tmp_path / "classify").mkdir()
    relief = Relief(BOX, {"d0_mm": 0.25, "rule": "share", "boxes": 2})
    BOXES.save(tmp_path, relief)
    read = BOXES.load(tmp_path)
    assert read.statistics == relief.statistics
    assert len(read.boxes) == 2


def test_no_boxes(tmp_path: Path) -> None:
    pairs = np.zeros((0, 2), np.int32)
    empty = Boxes(1.0, 0.5, 4, pairs, pairs, np.zeros(0, np.float32), pairs)
    write_boxes(tmp_path / "b.npz", empty)
    assert len(read_boxes(tmp_path / "b.npz", (5, 5))) == 0


@pytest.mark.parametrize(
    "changes",
    [
        {"position": np.array([[0, 0], [-1, 0]], np.int32)},
        {"position": np.array([[0, 0], [2**31 - 3, 0]], np.int32)},
        {"size": np.array([[8, 8], [0, 8]], np.int32)},
        {"highest_at": np.array([[8, 8], [20, 20]], np.int32)},
        {"highest_mm": np.array([1, np.nan], np.float32)},
        {"highest_mm": np.array([1], np.float32)},
        {"d0_mm": np.inf},
        {"cell": 0},
    ],
    ids=lambda c: next(iter(c)),
)
def test_contradictions_are_refused(tmp_path: Path, changes) -> None:
    write_boxes(tmp_path / "b.npz", replace(BOX, **changes))
    with pytest.raises(ImpastoError, match="contradict"):
        read_boxes(tmp_path / "b.npz", (25, 30))


def test_boxes_outside_the_grid_are_refused(tmp_path: Path) -> None:
    write_boxes(tmp_path / "b.npz", BOX)
    with pytest.raises(ImpastoError, match="contradict"):
        read_boxes(tmp_path / "b.npz", (24, 30))


def test_a_pickle_is_not_opened(tmp_path: Path) -> None:
    members = {f"{n}.npy": npy(a) for n, a in arrays().items()}
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, np.array([{}], dtype=object), allow_pickle=True)
    members["position.npy"] = buffer.getvalue()
    write_members(tmp_path / "b.npz", members)
    with pytest.raises(ImpastoError, match="position"):
        read_boxes(tmp_path / "b.npz")


def test_a_huge_declared_array_is_refused_before_memory_is_taken(tmp_path: Path) -> None:
    members = {f"{n}.npy": npy(a) for n, a in arrays().items()}
    buffer = io.BytesIO()
    header = {"descr": "<i4", "fortran_order": False, "shape": (1 << 60, 2)}
    np.lib.format.write_array_header_1_0(buffer, header)
    members["position.npy"] = buffer.getvalue()
    write_members(tmp_path / "b.npz", members)
    with pytest.raises(ImpastoError, match="position"):
        read_boxes(tmp_path / "b.npz")


@pytest.mark.parametrize(
    "name_and_array",
    [
        ("position", np.zeros((2, 3), np.int32)),
        ("position", np.zeros((2, 2), np.int64)),
        ("position", np.asfortranarray(np.zeros((2, 2), np.int32))),
        ("d0_mm", np.zeros(1)),
        ("highest_mm", np.zeros((2, 1), np.float32)),
    ],
    ids=str,
)
def test_other_types_and_shapes_are_refused(tmp_path: Path, name_and_array) -> None:
    name, array = name_and_array
    members = {f"{n}.npy": npy(a) for n, a in arrays().items()} | {f"{name}.npy": npy(array)}
    write_members(tmp_path / "b.npz", members)
    with pytest.raises(ImpastoError, match=name):
        read_boxes(tmp_path / "b.npz")


def test_compressed_missing_and_broken_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "b.npz"
    members = {f"{n}.npy": npy(a) for n, a in arrays().items()}
    write_members(path, members, zipfile.ZIP_DEFLATED)
    with pytest.raises(ImpastoError, match="compressed"):
        read_boxes(path)
    del members["cell.npy"]
    write_members(path, members)
    with pytest.raises(ImpastoError, match="missing"):
        read_boxes(path)
    write_boxes(path, BOX)
    data = bytearray(path.read_bytes())
    data[60] ^= 0xFF
    path.write_bytes(data)
    with pytest.raises(ImpastoError):
        read_boxes(path)
    path.write_bytes(b"not a zip")
    with pytest.raises(ImpastoError, match="sound"):
        read_boxes(path)
    with pytest.raises(ImpastoError, match="read"):
        read_boxes(tmp_path / "absent.npz")
