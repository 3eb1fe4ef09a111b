from __future__ import annotations

import contextlib
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import OpenEXR
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from pipeline.errors import ImpastoError
from pipeline.formats import image_header
from pipeline.formats.exr import write_exr
from pipeline.formats.image_header import read_image_header
from pipeline.formats.images import read_image, srgb_to_linear, to_grey, write_png

each_example = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
shapes = st.one_of(
    st.tuples(st.integers(1, 30), st.integers(1, 30)),
    st.tuples(st.integers(1, 30), st.integers(1, 30), st.just(3)),
)


def chunk(kind: bytes, content: bytes) -> bytes:
    check = struct.pack(">I", zlib.crc32(kind + content))
    return struct.pack(">I", len(content)) + kind + content + check


def png(width: int, height: int, idat: bytes, *, bits: int = 8, extra: bytes = b"") -> bytes:
    header = struct.pack(">IIBBBBB", width, height, bits, 0, 0, 0, 0)
    chunks = chunk(b"IHDR", header) + extra + chunk(b"IDAT", idat) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + chunks


def refused(path: Path) -> str:
    with pytest.raises(ImpastoError) as info:
        read_image(path)
    assert info.value.where == str(path)
    assert "\n" not in str(info.value)
    return str(info.value)


@each_example
@given(st.data(), st.sampled_from([np.uint8, np.uint16]))
def test_png_survives_a_round_trip(
    tmp_path: Path, data: st.DataObject, dtype: type[np.unsignedinteger]
) -> None:
    image = data.draw(hnp.arrays(dtype, shapes))
    write_png(tmp_path / "a.png", image)
    first = (tmp_path / "a.png").read_bytes()
    read = read_image(tmp_path / "a.png", size_px=(image.shape[1], image.shape[0]))
    assert read.dtype == dtype
    np.testing.assert_array_equal(read, image)
    header = read_image_header(tmp_path / "a.png")
    assert (header.depth, header.channels) == (np.dtype(dtype).name, 1 if image.ndim == 2 else 3)
    write_png(tmp_path / "a.png", image)
    assert (tmp_path / "a.png").read_bytes() == first


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((2, 2)),
        np.zeros((2, 2, 4), np.uint8),
        np.zeros((0, 2), np.uint8),
        np.zeros(4, np.uint8),
    ],
)
def test_what_png_cannot_hold_is_refused(tmp_path: Path, image: np.ndarray) -> None:
    with pytest.raises(ValueError, match="not an 8- or 16-bit image"):
        write_png(tmp_path / "a.png", image)


def test_red_is_first_in_every_format(tmp_path: Path) -> None:
    red = np.zeros((3, 4, 3), np.uint16)
    red[..., 0] = 65535
    write_png(tmp_path / "a.png", red)
    cv2.imwrite(str(tmp_path / "a.tif"), red[..., ::-1])
    planes = dict(zip("RGB", np.moveaxis(red // 65535, 2, 0).astype(np.float16), strict=True))
    write_exr(tmp_path / "a.exr", planes)
    for suffix in ("png", "tif", "exr"):
        image = read_image(tmp_path / f"a.{suffix}")
        assert image[1, 1, 0] > 0
        np.testing.assert_array_equal(image[..., 1:], 0)


def test_a_png_cut_anywhere_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    write_png(path, np.random.default_rng(0).integers(0, 256, (20, 20), dtype=np.uint8))
    data = path.read_bytes()
    for length in range(len(data)):
        path.write_bytes(data[:length])
        refused(path)


@each_example
@given(st.lists(st.tuples(st.integers(0, 10_000), st.integers(1, 255)), min_size=1, max_size=4))
def test_a_damaged_png_is_refused(tmp_path: Path, changes: list[tuple[int, int]]) -> None:
    path = tmp_path / "a.png"
    write_png(path, np.random.default_rng(0).integers(0, 256, (20, 20), dtype=np.uint8))
    good = path.read_bytes()
    damaged = bytearray(good)
    for at, bits in changes:
        damaged[at % len(good)] ^= bits
    path.write_bytes(damaged)
    if damaged != good:
        refused(path)


def test_bombs_are_refused_before_decoding(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cv2, "imdecode", None)  # reaching the decoder would raise TypeError
    path = tmp_path / "a.png"
    path.write_bytes(png(100_000, 100_000, zlib.compress(b"")))
    assert "declares 100000 x 100000 px" in refused(path)
    path.write_bytes(png(2**31 - 1, 1, zlib.compress(b"")))
    assert "declares" in refused(path)
    path.write_bytes(png(0, 5, zlib.compress(b"")))
    assert "declares 0 x 5 px" in refused(path)
    path.write_bytes(png(16_000, 16_000, zlib.compress(bytes(1000))))
    assert "truncated" in refused(path)
    with pytest.raises(ImpastoError, match="is 16000 x 16000 px; expected 8 x 6 px"):
        read_image(path, size_px=(8, 6))


def test_a_png_too_long_for_its_size_is_not_loaded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pipeline.formats.images._MAX_METADATA_BYTES", 100)
    path = tmp_path / "a.png"
    path.write_bytes(png(2, 2, zlib.compress(bytes(6)), extra=chunk(b"tEXt", bytes(1000))))
    assert "corrupt" in refused(path)


@pytest.mark.parametrize("content", [bytes(6 * 9 - 20), b""])
def test_a_png_with_too_few_rows_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(png(8, 6, zlib.compress(content)))
    assert "truncated or corrupt" in refused(path)


def test_forms_of_png_that_mean_something_else_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    for image in (np.zeros((4, 4, 4), np.uint8), np.zeros((4, 4, 4), np.uint16)):
        cv2.imwrite(str(path), image)
        assert "colour type 6" in refused(path)
    cv2.imwrite(str(path), np.eye(8, dtype=np.uint8) * 255, [cv2.IMWRITE_PNG_BILEVEL, 1])
    assert "1 bits" in refused(path)
    path.write_bytes(png(4, 4, zlib.compress(bytes(20)), extra=chunk(b"tRNS", b"\0\1")))
    assert "corrupt" in refused(path)


@pytest.mark.parametrize("name", ["a.jpg", "a.bmp", "a", "a.png.gz", "a.webp"])
def test_other_formats_are_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(b"whatever")
    assert "unsupported format" in refused(tmp_path / name)


@pytest.mark.parametrize("suffix", ["png", "tif", "tiff", "exr", "dng", "nef", "CR2"])
def test_a_file_that_is_not_what_it_is_called_is_refused(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a.{suffix}"
    for content in (b"", b"II*\0", b"not an image, but long enough to hold a header" * 9):
        path.write_bytes(content)
        refused(path)
    path.unlink()
    refused(path)


def test_formats_are_told_by_suffix_in_either_case(tmp_path: Path) -> None:
    write_png(tmp_path / "a.PNG", np.zeros((2, 3), np.uint8))
    assert read_image(tmp_path / "a.PNG").shape == (2, 3)


@pytest.mark.parametrize("compression", [1, 5, 8, 32773])
@pytest.mark.parametrize("shape", [(33, 47), (33, 47, 3)])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_tiff_is_read_as_stored(
    tmp_path: Path, dtype: type[np.generic], shape: tuple[int, ...], compression: int
) -> None:
    image = (np.random.default_rng(0).random(shape) * 200).astype(dtype)
    path = tmp_path / "a.tif"
    stored = image if image.ndim == 2 else np.ascontiguousarray(image[..., ::-1])
    assert cv2.imwrite(str(path), stored, [cv2.IMWRITE_TIFF_COMPRESSION, compression])
    read = read_image(path, size_px=(47, 33))
    assert read.dtype == dtype
    np.testing.assert_array_equal(read, image)
    data = path.read_bytes()
    for length in (0, 3, 7, 9, 100, len(data) // 2, len(data) - 1):
        path.write_bytes(data[:length])
        refused(path)


def tiff(tags: dict[int, tuple[int, int]], order: str = "<", after: int = 0) -> bytes:
    """A TIFF of 4 x 3 px, 8-bit grey 0 to 11; ``tags`` maps a number to its type and value."""
    data = bytes(range(12))
    entries = {256: (3, 4), 257: (3, 3), 258: (3, 8), 259: (3, 1), 262: (3, 1), 273: (4, 8),
               277: (3, 1), 278: (3, 3), 279: (4, 12), **tags}  # fmt: skip
    directory = struct.pack(f"{order}H", len(entries))
    for tag, (kind, value) in sorted(entries.items()):
        packed = struct.pack(f"{order}{'H' if kind == 3 else 'I'}", value).ljust(4, b"\0")
        directory += struct.pack(f"{order}HHI", tag, kind, 1) + packed
    mark = b"II" if order == "<" else b"MM"
    head = mark + struct.pack(f"{order}HI", 42, 8 + len(data))
    return head + data + directory + struct.pack(f"{order}I", after)


@pytest.mark.parametrize("order", ["<", ">"])
def test_tiff_of_either_byte_order_is_read(tmp_path: Path, order: str) -> None:
    (tmp_path / "a.tif").write_bytes(tiff({}, order))
    np.testing.assert_array_equal(
        read_image(tmp_path / "a.tif"), np.arange(12, dtype=np.uint8).reshape(3, 4)
    )


@pytest.mark.parametrize(
    ("tags", "message"),
    [
        ({256: (4, 100_000), 257: (4, 100_000)}, "declares 100000 x 100000"),
        ({256: (4, 16_000), 257: (4, 16_000)}, "truncated"),
        ({256: (4, 16_000), 257: (4, 16_000), 259: (3, 8)}, "truncated"),
        ({256: (3, 0)}, "declares 0 x 3"),
        ({257: (3, 4)}, "truncated"),
        ({258: (3, 4)}, "4] bits"),
        ({258: (3, 32)}, "32] bits"),
        ({259: (3, 7)}, "compression 7"),
        ({262: (3, 0)}, "photometric 0"),
        ({262: (3, 3)}, "photometric 3"),
        ({277: (3, 2)}, "2 samples"),
        ({273: (4, 4_000_000_000)}, "truncated"),
        ({279: (4, 4_000_000_000)}, "truncated"),
        ({279: (4, 0)}, "truncated"),
        ({274: (3, 6)}, "turned"),
        ({284: (3, 2)}, "separate planes"),
        ({339: (3, 2)}, "bits"),
    ],
)
def test_bad_tiffs_are_refused(
    tmp_path: Path, tags: dict[int, tuple[int, int]], message: str
) -> None:
    (tmp_path / "a.tif").write_bytes(tiff(tags))
    assert message in refused(tmp_path / "a.tif")


def test_a_tiff_of_several_pages_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.tif").write_bytes(tiff({}, after=8))
    assert "several pages" in refused(tmp_path / "a.tif")


@each_example
@given(st.lists(st.tuples(st.integers(0, 10_000), st.integers(0, 255)), min_size=1, max_size=4))
def test_a_damaged_tiff_gives_an_image_or_an_error(
    tmp_path: Path, changes: list[tuple[int, int]]
) -> None:
    path = tmp_path / "a.tif"
    data = bytearray(tiff({}))
    for at, value in changes:
        data[at % len(data)] = value
    path.write_bytes(data)
    with contextlib.suppress(ImpastoError):
        assert read_image(path).size > 0


@pytest.mark.parametrize("dtype", [np.float16, np.float32])
def test_exr_images_are_float32(tmp_path: Path, dtype: type[np.floating]) -> None:
    image = np.random.default_rng(0).random((5, 7, 3)).astype(dtype)
    write_exr(tmp_path / "a.exr", {c: image[..., i] for i, c in enumerate("RGB")})
    write_exr(tmp_path / "y.exr", {"Y": image[..., 0]})
    read = read_image(tmp_path / "a.exr")
    assert read.dtype == np.float32
    np.testing.assert_array_equal(read, image.astype(np.float32))
    np.testing.assert_array_equal(read_image(tmp_path / "y.exr"), read[..., 0])
    assert read_image_header(tmp_path / "a.exr").depth == np.dtype(dtype).name


@pytest.mark.parametrize(
    ("names", "dtype"),
    [("RGBA", np.float32), ("H", np.float32), ("RG", np.float32), ("Y", np.uint32)],
)
def test_other_channels_are_no_picture(tmp_path: Path, names: str, dtype: type[np.generic]) -> None:
    write_exr(tmp_path / "a.exr", {c: np.zeros((2, 2), dtype) for c in names})
    assert "has the channels" in refused(tmp_path / "a.exr")


def test_a_cropped_exr_is_refused(tmp_path: Path) -> None:
    header = {
        "type": OpenEXR.scanlineimage,
        "compression": OpenEXR.ZIP_COMPRESSION,
        "dataWindow": (np.array([2, 0], np.int32), np.array([5, 3], np.int32)),
        "displayWindow": (np.array([0, 0], np.int32), np.array([9, 9], np.int32)),
    }
    with OpenEXR.File(header, {"Y": np.zeros((4, 4), np.float32)}) as file:
        file.write(str(tmp_path / "a.exr"))
    assert "display window" in refused(tmp_path / "a.exr")


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_value_that_is_no_number_is_refused(tmp_path: Path, value: float) -> None:
    image = np.zeros((4, 4), np.float32)
    image[2, 1] = value
    write_exr(tmp_path / "a.exr", {"Y": image})
    cv2.imwrite(str(tmp_path / "a.tif"), image)
    for name in ("a.exr", "a.tif"):
        assert "NaN or infinity" in refused(tmp_path / name)


def test_a_folder_or_no_permission_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "a.png").mkdir()
    assert "cannot be read" in refused(tmp_path / "a.png")


def test_grey_weighs_as_a_bayer_mosaic() -> None:
    image = np.array([[[0.1, 0.2, 0.4]]], np.float32)
    assert to_grey(image)[0, 0] == pytest.approx(0.225)
    assert to_grey(image).dtype == np.float32
    grey = np.ones((2, 2), np.float32)
    assert to_grey(grey) is grey


def test_srgb_at_known_values() -> None:
    # IEC 61966-2-1: 0.04045 lies on both branches; the rest from the formula by hand.
    encoded = [0.0, 0.04045, 0.5, 1.0]
    linear = [0.0, 0.0031308, 0.21404114, 1.0]
    np.testing.assert_allclose(srgb_to_linear(np.array(encoded)), linear, rtol=1e-5)
    assert srgb_to_linear(np.array([-0.1]))[0] == pytest.approx(-0.1 / 12.92)


def test_the_pixel_limit_holds_for_every_format(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(image_header, "MAX_PIXELS", 11)
    write_png(tmp_path / "a.png", np.zeros((3, 4), np.uint8))
    assert "declares 4 x 3 px; expected 1 to 11 pixels" in refused(tmp_path / "a.png")
