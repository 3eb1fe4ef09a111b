from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.errors import ImpastoError
from pipeline.formats.bundle import open_bundle
from pipeline.formats.bundle_writer import BundleWriter


def small_document() -> dict[str, Any]:
    return {
        "format": "impasto-capture",
        "version": 1,
        "name": "written",
        "encoding": "linear",
        "simulated": {"seed": 1},
        "cameras": {"C0": {"size_px": [8, 6]}},
        "lights": {"L0": {"intensity": 1.0}},
        "photos": [{"file": "photos/0.png", "camera": "C0", "light": "L0"}],
    }


def written(folder: Path, image: np.ndarray) -> BundleWriter:
    writer = BundleWriter(folder)
    writer.add_image("photos/0.png", image)
    return writer


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_what_is_written_is_read_back(tmp_path: Path, dtype: type[np.unsignedinteger]) -> None:
    image = np.arange(144).reshape(6, 8, 3).astype(dtype)
    folder = tmp_path / "a" / "bundle"
    writer = written(folder, image)
    assert not (folder / "capture.json").exists()
    writer.close(small_document())
    bundle = open_bundle(folder)
    np.testing.assert_array_equal(bundle.read_stored("photos/0.png"), image)
    assert bundle.capture.model_extra == {"simulated": {"seed": 1}}
    assert sorted(p.name for p in folder.rglob("*")) == ["0.png", "capture.json", "photos"]


def test_a_model_is_written_like_its_document(tmp_path: Path) -> None:
    image = np.zeros((6, 8), np.uint8)
    written(tmp_path / "a", image).close(small_document())
    capture = open_bundle(tmp_path / "a").capture
    written(tmp_path / "b", image).close(capture)
    assert open_bundle(tmp_path / "b").capture == capture
    assert "null" not in (tmp_path / "b" / "capture.json").read_text()


def test_the_same_recording_gives_the_same_bytes(tmp_path: Path) -> None:
    image = np.random.default_rng(0).integers(0, 65536, (6, 8, 3), dtype=np.uint16)
    for name in "ab":
        written(tmp_path / name, image).close(small_document())
    for file in ("capture.json", "photos/0.png"):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"photos": [{"file": "photos/1.png", "camera": "C0"}]}, r"photos\[0\].file.*missing"),
        ({"photos": [{"file": "photos/0.png", "camera": "C1"}]}, r"photos\[0\].camera"),
        ({"cameras": {"C0": {"size_px": [9, 6]}}}, "8 x 6 px; expected 9 x 6 px"),
        ({"lights": {"L0": {"intensity": float("nan")}}}, "lights.L0.intensity: nan"),
        ({"name": 3}, "capture.json: name"),
    ],
)
def test_a_bad_document_is_not_written(
    tmp_path: Path, change: dict[str, Any], message: str
) -> None:
    writer = written(tmp_path, np.zeros((6, 8), np.uint8))
    with pytest.raises(ImpastoError, match=message):
        writer.close(small_document() | change)
    assert not (tmp_path / "capture.json").exists()
    writer.close(small_document())
    assert open_bundle(tmp_path).capture.name == "written"


def test_a_recording_is_never_overwritten(tmp_path: Path) -> None:
    written(tmp_path, np.zeros((6, 8), np.uint8)).close(small_document())
    with pytest.raises(ImpastoError, match=r"holds a capture\.json already"):
        BundleWriter(tmp_path)


def test_a_closed_writer_takes_nothing_more(tmp_path: Path) -> None:
    image = np.zeros((6, 8), np.uint8)
    writer = written(tmp_path, image)
    writer.close(small_document())
    with pytest.raises(ValueError, match="closed"):
        writer.add_image("b.png", image)
    with pytest.raises(ValueError, match="closed"):
        writer.close(small_document())


def test_images_stay_inside(tmp_path: Path) -> None:
    folder = tmp_path / "bundle"
    writer = BundleWriter(folder)
    (folder / "linked").symlink_to(tmp_path)
    image = np.zeros((6, 8), np.uint8)
    for file in ("../a.png", "/a.png", "linked/a.png"):
        with pytest.raises(ImpastoError, match=str(folder)):
            writer.add_image(file, image)
    with pytest.raises(ValueError, match=r"\.png"):
        writer.add_image("a.tif", image)
    assert not list(tmp_path.glob("*.png"))


def test_a_folder_that_cannot_be_made_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(ImpastoError, match="cannot be made"):
        BundleWriter(tmp_path / "file" / "bundle")
