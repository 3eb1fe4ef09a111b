from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest

from pipeline.errors import ImpastoError
from pipeline.formats.bundle import open_bundle
from pipeline.formats.image_header import read_image_header
from pipeline.formats.images import read_image

BLACK, WHITE = 256, 4095


def write_dng(
    path: Path,
    mosaic: np.ndarray,
    *,
    orientation: int = 1,
    crop: tuple[int, int, int, int] | None = None,
) -> None:
    """Write the smallest DNG that LibRaw reads: one uncompressed RGGB strip of 12 bits."""
    rows, columns = mosaic.shape
    data = mosaic.astype("<u2").tobytes()

    def short(*values: int) -> tuple[int, int, bytes]:
        return 3, len(values), struct.pack(f"<{len(values)}H", *values)

    def long(*values: int) -> tuple[int, int, bytes]:
        return 4, len(values), struct.pack(f"<{len(values)}I", *values)

    def text(value: str) -> tuple[int, int, bytes]:
        return 2, len(value) + 1, value.encode() + b"\0"

    def rational(kind: int, values: list[float]) -> tuple[int, int, bytes]:
        pairs = [struct.pack("<ii", int(value * 10_000), 10_000) for value in values]
        return kind, len(values), b"".join(pairs)

    tags = {
        254: long(0), 256: long(columns), 257: long(rows), 258: short(16), 259: short(1),
        262: short(32803), 271: text("Test"), 272: text("Camera"), 273: long(0),
        274: short(orientation), 277: short(1), 278: long(rows), 279: long(len(data)),
        284: short(1), 33421: short(2, 2), 33422: (1, 4, bytes([0, 1, 1, 2])),
        50706: (1, 4, bytes([1, 4, 0, 0])), 50707: (1, 4, bytes([1, 1, 0, 0])),
        50708: text("Test Camera"), 50714: short(BLACK), 50717: long(WHITE),
        50721: rational(10, np.eye(3).ravel().tolist()), 50728: rational(5, [0.5, 1.0, 0.7]),
        50778: short(21),
    }  # fmt: skip
    if crop is not None:
        tags |= {50719: long(*crop[:2]), 50720: long(*crop[2:])}
    values_at = 8 + 2 + 12 * len(tags) + 4
    values = b""
    entries = b""
    data_at = values_at + sum((len(v) + 1) // 2 * 2 for _, _, v in tags.values() if len(v) > 4)
    tags[273] = long(data_at)
    for tag, (kind, count, value) in sorted(tags.items()):
        entries += struct.pack("<HHI", tag, kind, count)
        if len(value) <= 4:
            entries += value.ljust(4, b"\0")
        else:
            entries += struct.pack("<I", values_at + len(values))
            values += value + b"\0" * (len(value) % 2)
    head = struct.pack("<2sHIH", b"II", 42, 8, len(tags))
    path.write_bytes(head + entries + bytes(4) + values + data)


@pytest.mark.parametrize("orientation", [1, 6])
def test_raw_is_linear_unbalanced_and_unturned(tmp_path: Path, orientation: int) -> None:
    mosaic = np.full((64, 96), BLACK + 1000, np.uint16)
    mosaic[:, 48:] = WHITE
    mosaic[:8] = BLACK
    write_dng(tmp_path / "a.dng", mosaic, orientation=orientation)
    header = read_image_header(tmp_path / "a.dng")
    assert (header.kind, header.size_px, header.full_scale) == ("raw", (96, 64), 65535.0)
    image = read_image(tmp_path / "a.dng", size_px=(96, 64))
    assert image.shape == (64, 96, 3)
    assert image.dtype == np.uint16
    # The camera's own white balance, (2, 1, 1.4), is not applied.
    np.testing.assert_allclose(image[30, 20], 1000 / (WHITE - BLACK) * 65535, atol=2)
    np.testing.assert_array_equal(image[30, 80], 65535)
    np.testing.assert_array_equal(image[2, 20], 0)


def test_a_dark_raw_keeps_its_scale_and_its_colours(tmp_path: Path) -> None:
    mosaic = np.full((64, 96), BLACK + 100, np.uint16)
    mosaic[::2, ::2] = BLACK + 200
    write_dng(tmp_path / "a.dng", mosaic)
    image = read_image(tmp_path / "a.dng")
    expected = np.array([200, 100, 100]) / (WHITE - BLACK) * 65535
    np.testing.assert_allclose(image[20:40, 20:40], np.broadcast_to(expected, (20, 20, 3)), atol=2)


def test_the_camera_s_own_crop_is_taken_where_it_has_the_size(tmp_path: Path) -> None:
    path = tmp_path / "a.dng"
    mosaic = np.full((64, 96), BLACK, np.uint16)
    mosaic[20:40, 30:50] = WHITE
    write_dng(path, mosaic, crop=(4, 2, 88, 60))
    whole = read_image(path, size_px=(96, 64))
    np.testing.assert_array_equal(read_image(path), whole)
    np.testing.assert_array_equal(read_image(path, size_px=(88, 60)), whole[2:62, 4:92])
    with pytest.raises(ImpastoError, match="is 96 x 64 px; expected 90 x 60 px"):
        read_image(path, size_px=(90, 60))


@pytest.mark.parametrize("size_px", [[96, 64], [88, 60]])
def test_a_bundle_of_raw_photographs_is_linear(tmp_path: Path, size_px: list[int]) -> None:
    mosaic = np.full((64, 96), BLACK + 1000, np.uint16)
    write_dng(tmp_path / "a.dng", mosaic, crop=(4, 2, 88, 60))
    document = {
        "format": "impasto-capture", "version": 1, "name": "raw", "encoding": "srgb",
        "cameras": {"C0": {"size_px": size_px}}, "photos": [{"file": "a.dng", "camera": "C0"}],
    }  # fmt: skip
    (tmp_path / "capture.json").write_text(json.dumps(document))
    image = open_bundle(tmp_path).read("a.dng")
    assert image.shape == (size_px[1], size_px[0], 3)
    np.testing.assert_allclose(image, 1000 / (WHITE - BLACK), atol=1e-4)


def test_a_cut_raw_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.dng"
    write_dng(path, np.full((64, 96), 1000, np.uint16))
    data = path.read_bytes()
    for length in (0, 10, 200, 4000, len(data) - 100, len(data) - 1):
        path.write_bytes(data[:length])
        with pytest.raises(ImpastoError, match=r"a\.dng: cannot be decoded as a RAW file"):
            read_image(path)
