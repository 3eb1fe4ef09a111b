from __future__ import annotations

import contextlib
import struct
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from pipeline.errors import ImpastoError
from pipeline.formats.exr import read_exr, read_exr_attributes, write_exr

each_example = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)


@each_example
@given(data=st.data())
def test_channels_survive_a_round_trip_bit_by_bit(tmp_path: Path, data: st.DataObject) -> None:
    shape = data.draw(hnp.array_shapes(min_dims=2, max_dims=2, max_side=40))
    names = data.draw(st.lists(st.sampled_from("HSXYZRGBN"), min_size=1, max_size=5, unique=True))
    channels = {
        name: data.draw(
            hnp.arrays(data.draw(st.sampled_from([np.float32, np.float16, np.uint32])), shape)
        )
        for name in names
    }
    path = tmp_path / "a.exr"
    write_exr(path, channels)
    read = read_exr(path, names)
    assert list(read) == names
    for name, image in channels.items():
        assert read[name].dtype == image.dtype
        np.testing.assert_array_equal(read[name], image)


def test_nan_views_and_attributes_survive(tmp_path: Path) -> None:
    whole = np.arange(120, dtype=np.float32).reshape(10, 12)
    whole[3, 3] = np.nan
    path = tmp_path / "a.exr"
    write_exr(
        path, {"H": whole[::-1, ::2].T, "S": whole[:6, :10]}, attributes={"source": "µ white"}
    )
    read = read_exr(path)
    np.testing.assert_array_equal(read["H"], whole[::-1, ::2].T)
    np.testing.assert_array_equal(read["S"], whole[:6, :10])
    assert read_exr_attributes(path)["source"] == "µ white"


def test_the_same_images_give_the_same_bytes(tmp_path: Path) -> None:
    image = np.random.default_rng(0).random((50, 40)).astype(np.float32)
    write_exr(tmp_path / "a.exr", {"X": image, "Y": image}, attributes={"b": "2", "a": "1"})
    write_exr(tmp_path / "b.exr", {"Y": image, "X": image}, attributes={"a": "1", "b": "2"})
    assert (tmp_path / "a.exr").read_bytes() == (tmp_path / "b.exr").read_bytes()


@pytest.mark.parametrize(
    "channels",
    [
        {},
        {"H": np.zeros((2, 3)), "S": np.zeros((2, 3))},
        {"H": np.zeros((2, 3), np.float32), "S": np.zeros((3, 2), np.float32)},
        {"H": np.zeros(3, np.float32)},
        {"H": np.zeros((0, 3), np.float32)},
        {"": np.zeros((2, 3), np.float32)},
    ],
)
def test_what_exr_cannot_hold_is_refused(tmp_path: Path, channels: dict[str, np.ndarray]) -> None:
    with pytest.raises(ValueError, match="channel"):
        write_exr(tmp_path / "a.exr", channels)


def test_a_text_cannot_take_the_place_of_the_header(tmp_path: Path) -> None:
    image = np.zeros((1, 1), np.float32)
    with pytest.raises(ValueError, match="dataWindow"):
        write_exr(tmp_path / "a.exr", {"H": image}, attributes={"dataWindow": "x"})


def test_a_missing_channel_is_named(tmp_path: Path) -> None:
    write_exr(tmp_path / "a.exr", {"H": np.zeros((2, 2), np.float32)})
    with pytest.raises(ImpastoError, match=r"a\.exr: channel 'S' is missing.*H, S.*there are H"):
        read_exr(tmp_path / "a.exr", ["H", "S"])


def test_a_missing_file_and_folder_are_errors(tmp_path: Path) -> None:
    with pytest.raises(ImpastoError, match=r"a\.exr"):
        read_exr(tmp_path / "a.exr")
    with pytest.raises(ImpastoError, match="cannot be written"):
        write_exr(tmp_path / "b" / "a.exr", {"H": np.zeros((2, 2), np.float32)})


@pytest.mark.parametrize("compression", ["NO", "RLE", "ZIPS", "ZIP", "PIZ"])
def test_a_file_cut_anywhere_is_refused(tmp_path: Path, compression: str) -> None:
    path = tmp_path / "a.exr"
    image = np.random.default_rng(0).random((40, 30)).astype(np.float32)
    header = {
        "compression": getattr(OpenEXR, f"{compression}_COMPRESSION"),
        "type": OpenEXR.scanlineimage,
    }
    with OpenEXR.File(header, {"H": image}) as file:
        file.write(str(path))
    data = path.read_bytes()
    np.testing.assert_array_equal(read_exr(path)["H"], image)
    for length in [*range(0, 400, 13), *range(400, len(data), 97), len(data) - 1]:
        path.write_bytes(data[:length])
        with pytest.raises(ImpastoError) as info:
            read_exr(path)
        assert "a.exr" in str(info.value)


def test_a_huge_declared_size_is_refused_before_allocating(tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    write_exr(path, {"H": np.zeros((16, 16), np.float32)})
    data = path.read_bytes()
    for corner, text in [((99_999, 99_999), "100000 x 100000"), ((15_999, 15_999), "truncated"),
                         ((-5, 15), "-4 x 16"), ((2**31 - 1, 0), "2147483648 x 1")]:  # fmt: skip
        old = struct.pack("<4i", 0, 0, 15, 15)
        path.write_bytes(data.replace(old, struct.pack("<4i", 0, 0, *corner)))
        with pytest.raises(ImpastoError, match=text):
            read_exr(path)


def test_corrupt_data_is_never_half_returned(tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    write_exr(path, {"H": np.tile(np.arange(70, dtype=np.float32), (50, 1))})
    data = bytearray(path.read_bytes())
    for i in range(20, 60):
        data[-i] ^= 0x55
    path.write_bytes(data)
    with pytest.raises(ImpastoError, match=r"a\.exr: is corrupt"):
        read_exr(path)


def test_tiled_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    write_exr(path, {"H": np.zeros((16, 16), np.float32)})
    data = bytearray(path.read_bytes())
    data[5] |= 0x02
    path.write_bytes(data)
    with pytest.raises(ImpastoError, match="tiled"):
        read_exr(path)


@each_example
@given(st.lists(st.tuples(st.integers(0, 400), st.integers(0, 255)), min_size=1, max_size=4))
def test_a_damaged_header_gives_an_image_or_an_error(
    tmp_path: Path, changes: list[tuple[int, int]]
) -> None:
    path = tmp_path / "a.exr"
    write_exr(path, {"H": np.ones((4, 4), np.float32)})
    data = bytearray(path.read_bytes())
    for at, value in changes:
        data[at % len(data)] = value
    path.write_bytes(data)
    with contextlib.suppress(ImpastoError):
        assert all(image.ndim == 2 for image in read_exr(path).values())
