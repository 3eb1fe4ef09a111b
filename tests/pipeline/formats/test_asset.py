from __future__ import annotations

import json
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.errors import ImpastoError
from pipeline.formats.asset import ASSET, Asset, load_asset, save_asset
from pipeline.formats.boxes import Boxes
from pipeline.formats.exr import write_exr

ROWS, COLUMNS = 30, 44


def no_boxes(**changes) -> Boxes:
    pairs = np.zeros((0, 2), np.int32)
    return replace(Boxes(0.5, 2.0, 8, pairs, pairs, np.zeros(0, np.float32), pairs), **changes)


@pytest.fixture
def asset() -> Asset:
    rng = np.random.default_rng(0)
    mask = np.ones((ROWS, COLUMNS), bool)
    mask[:3] = False
    shape = (ROWS, COLUMNS, 3)
    tilt = rng.uniform(-0.6, 0.6, (ROWS, COLUMNS, 2))
    boxes = no_boxes(
        position=np.array([[0, 0], [8, 16]], np.int32),
        size=np.array([[8, 8], [8, 8]], np.int32),
        highest_mm=np.array([1, 2], np.float32),
        highest_at=np.array([[3, 4], [10, 20]], np.int32),
    )
    images = {
        "heights_mm": rng.uniform(-3, 3, shape[:2]),
        "normals": tilt,
        "diffuse": rng.uniform(0, 0.3, shape),
        "specular": rng.uniform(0, 2, shape),
        "lobe": rng.uniform(-1, 60, shape),
    }
    clipped = {
        name: np.where(mask if image.ndim == 2 else mask[..., None], image, 0).astype(np.float32)
        for name, image in images.items()
    }
    notes = {"reflectance": "fitted", "absolute": True, "factor": 1.5}
    return Asset(name="Übung", spacing_mm=0.35, mask=mask, boxes=boxes, notes=notes, **clipped)


def test_round_trip_within_half_precision(asset: Asset, tmp_path: Path) -> None:
    save_asset(tmp_path, asset)
    read = load_asset(tmp_path)
    assert (read.name, read.spacing_mm, read.notes) == (asset.name, asset.spacing_mm, asset.notes)
    assert np.array_equal(read.mask, asset.mask)
    for name in ("heights_mm", "normals", "diffuse", "specular", "lobe"):
        image = getattr(read, name)
        assert image.dtype == np.float32
        assert image == pytest.approx(getattr(asset, name), rel=2**-11, abs=2**-24)
    for field in fields(Boxes):
        assert np.array_equal(getattr(read.boxes, field.name), getattr(asset.boxes, field.name))
    stated = json.loads((tmp_path / "asset.json").read_text())["rounding"]["height_max_error_mm"]
    assert np.abs(read.heights_mm - asset.heights_mm).max() == pytest.approx(stated)
    assert 0 < stated < 0.0011


def test_the_same_bytes_again_and_no_more_than_declared(asset: Asset, tmp_path: Path) -> None:
    contents = []
    for name in ("a", "b"):
        (tmp_path / name / "asset").mkdir(parents=True)
        ASSET.save(tmp_path / name, asset)
        found = {p.name: p.read_bytes() for p in (tmp_path / name / "asset").iterdir()}
        assert {f"asset/{file}" for file in found} == set(ASSET.files)
        contents.append(found)
    assert contents[0] == contents[1]


def test_no_more_than_26_bytes_a_texel(tmp_path: Path) -> None:
    """With a noisy height and colour at every texel, as a real canvas has."""
    rng = np.random.default_rng(1)
    rows, columns = 400, 500
    shape = (rows, columns, 3)
    noisy = Asset(
        name="noisy",
        spacing_mm=0.5,
        heights_mm=rng.normal(0, 0.5, shape[:2]).astype(np.float32),
        normals=rng.normal(0, 0.1, (rows, columns, 2)).astype(np.float32),
        mask=np.ones(shape[:2], bool),
        diffuse=rng.uniform(0, 0.3, shape).astype(np.float32),
        specular=rng.uniform(0, 0.3, shape).astype(np.float32),
        lobe=rng.uniform(0.5, 60, shape).astype(np.float32),
        boxes=no_boxes(),
        notes={},
    )
    save_asset(tmp_path, noisy)
    size = sum(path.stat().st_size for path in tmp_path.iterdir())
    assert size <= 26 * rows * columns


def test_what_half_floats_cannot_hold_is_clamped_and_counted(asset: Asset, tmp_path: Path) -> None:
    asset.lobe[5, 5, 2] = 1e6
    asset.specular[6, 6, 0] = np.inf
    asset.diffuse[7, 7] = np.nan
    save_asset(tmp_path, asset)
    read = load_asset(tmp_path)
    assert read.lobe[5, 5, 2] == 65504
    assert read.specular[6, 6, 0] == 65504
    assert not read.diffuse[7, 7].any()
    assert json.loads((tmp_path / "asset.json").read_text())["rounding"]["values_clamped"] == 2


def test_a_flat_black_asset_of_one_texel(tmp_path: Path) -> None:
    one = np.zeros((1, 1, 3), np.float32)
    asset = Asset("dot", 1.0, one[..., 0], one[..., :2], np.ones((1, 1), bool), one, one, one,
                  no_boxes(), {})  # fmt: skip
    save_asset(tmp_path, asset)
    assert load_asset(tmp_path).heights_mm.shape == (1, 1)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("format", "other"),
        ("version", 2),
        ("size", [1 << 20, 1 << 20]),
        ("size", [44, 31]),
        ("size", [-1, 30]),
        ("size", [44.5, 30]),
        ("size", "44 x 30"),
        ("spacing_mm", 0),
        ("spacing_mm", "0.35"),
        ("spacing_mm", 1e999),
        ("name", ["x"]),
        ("name", "x" * 2000),
        ("notes", {"a": {"b": 1}}),
        ("notes", None),
    ],
    ids=str,
)
def test_a_hostile_document_is_one_line(asset: Asset, tmp_path: Path, key, value) -> None:
    save_asset(tmp_path, asset)
    document = json.loads((tmp_path / "asset.json").read_text())
    document[key] = value
    (tmp_path / "asset.json").write_text(json.dumps(document))
    with pytest.raises(ImpastoError) as error:
        load_asset(tmp_path)
    assert "\n" not in str(error.value)
    assert "." in str(error.value)


def test_the_document_names_no_file(asset: Asset, tmp_path: Path) -> None:
    save_asset(tmp_path, asset)
    document = json.loads((tmp_path / "asset.json").read_text())
    document["files"] = {"../../etc/passwd": ["NX"]}
    (tmp_path / "asset.json").write_text(json.dumps(document))
    assert load_asset(tmp_path).name == asset.name


@pytest.mark.parametrize("text", ["", "[]", "{", '{"format": 1, "format": 2}', "\x00", "[" * 9000])
def test_a_broken_document_is_one_line(asset: Asset, tmp_path: Path, text: str) -> None:
    save_asset(tmp_path, asset)
    (tmp_path / "asset.json").write_text(text)
    with pytest.raises(ImpastoError) as error:
        load_asset(tmp_path)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("file", [f.removeprefix("asset/") for f in ASSET.files])
def test_missing_and_truncated_files(asset: Asset, tmp_path: Path, file: str) -> None:
    save_asset(tmp_path, asset)
    whole = (tmp_path / file).read_bytes()
    if file == "preview.png":
        (tmp_path / file).unlink()
        assert load_asset(tmp_path).name == asset.name  # no renderer needs it
        return
    (tmp_path / file).write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ImpastoError):
        load_asset(tmp_path)
    (tmp_path / file).unlink()
    with pytest.raises(ImpastoError):
        load_asset(tmp_path)


def test_textures_of_another_kind(asset: Asset, tmp_path: Path) -> None:
    save_asset(tmp_path, asset)
    plane = np.zeros((ROWS, COLUMNS), np.float16)
    for channels, message in (
        ({"R": plane[:5], "G": plane[:5], "B": plane[:5]}, "44 x 5"),
        ({"R": plane, "G": plane}, "channels"),
        ({"R": plane, "G": plane, "B": plane, "A": plane}, "channels"),
        ({"R": plane, "G": plane, "B": plane + np.float16(np.inf)}, "NaN"),
    ):
        write_exr(tmp_path / "diffuse.exr", channels)
        with pytest.raises(ImpastoError, match=message):
            load_asset(tmp_path)


def test_a_folder_that_is_none(tmp_path: Path) -> None:
    with pytest.raises(ImpastoError, match=r"asset\.json"):
        load_asset(tmp_path / "nowhere")
