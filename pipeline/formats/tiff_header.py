"""The header of a TIFF file: sizes, layout and whether its data lie inside the file.

Source: TIFF revision 6.0 (Aldus 1992); BigTIFF (libtiff, 2007) differs in the widths of numbers.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Literal

from pipeline.errors import ImpastoError
from pipeline.formats.exr_header import MAX_PIXELS

_MAX_ENTRIES = 4096
_MAX_VALUES = 1 << 20
_TYPES = {1: "B", 3: "H", 4: "I", 16: "Q"}
_LOSSLESS = {1: "none", 5: "LZW", 8: "deflate", 32773: "PackBits", 32946: "deflate"}
_WIDTH, _HEIGHT, _BITS, _COMPRESSION, _PHOTOMETRIC = 256, 257, 258, 259, 262
_STRIPS, _ORIENTATION, _SAMPLES, _STRIP_BYTES, _PLANAR = 273, 274, 277, 279, 284
_TILES, _TILE_BYTES, _SAMPLE_FORMAT = 324, 325, 339


@dataclass(frozen=True)
class TiffHeader:
    """Size (width, height), channels and depth of the one page."""

    size_px: tuple[int, int]
    channels: Literal[1, 3]
    depth: Literal["uint8", "uint16", "float32"]


def read_tiff_header(path: Path) -> TiffHeader:
    """Read the first directory and check that all strips or tiles lie inside the file.

    Raises
    ------
    ImpastoError
        If it is not a TIFF of one page, grey or RGB, 8 or 16 bits or float32, losslessly
        compressed and upright, or is truncated.
    """
    with path.open("rb") as file:
        size_bytes = file.seek(0, 2)
        file.seek(0)
        tags, next_page = _Reader(file, size_bytes).first_directory()
    if next_page:
        raise ImpastoError("is a TIFF of several pages", fix="save one page only")
    width, height = _one(tags, _WIDTH, 0), _one(tags, _HEIGHT, 0)
    if width < 1 or height < 1 or width * height > MAX_PIXELS:
        raise ImpastoError(
            f"declares {width} x {height} px", expected=f"1 to {MAX_PIXELS} pixels in all"
        )
    header = _interpret(tags, (width, height))
    offsets, counts = tags.get(_STRIPS, ()), tags.get(_STRIP_BYTES, ())
    if _TILES in tags:
        offsets, counts = tags[_TILES], tags.get(_TILE_BYTES, ())
    if not offsets or len(offsets) != len(counts):
        raise _truncated()
    if any(o + n > size_bytes or n == 0 for o, n in zip(offsets, counts, strict=True)):
        raise _truncated()
    raw_bytes = width * height * header.channels * {"uint8": 1, "uint16": 2}.get(header.depth, 4)
    stored = sum(counts)
    # No lossless method of TIFF compresses further than deflate's 1032 and LZW's 1365 to one.
    if stored < (raw_bytes if _one(tags, _COMPRESSION, 1) == 1 else raw_bytes // 1400):
        raise _truncated()
    return header


def _interpret(tags: dict[int, tuple[int, ...]], size_px: tuple[int, int]) -> TiffHeader:
    samples = _one(tags, _SAMPLES, 1)
    bits = set(tags.get(_BITS, (1,)))
    sample_format = set(tags.get(_SAMPLE_FORMAT, (1,)))
    photometric = _one(tags, _PHOTOMETRIC, -1)
    compression = _one(tags, _COMPRESSION, 1)
    if compression not in _LOSSLESS:
        raise ImpastoError(
            f"is a TIFF of compression {compression}",
            expected="none, LZW, deflate or PackBits",
            fix="save it again without loss",
        )
    if _one(tags, _ORIENTATION, 1) != 1 or _one(tags, _PLANAR, 1) != 1:
        raise ImpastoError(
            "is a TIFF that is turned or whose colours lie in separate planes",
            expected="orientation 1 and interleaved colours",
            fix="save it again so",
        )
    depth = {(8, 1): "uint8", (16, 1): "uint16", (32, 3): "float32"}.get(
        (next(iter(bits)), next(iter(sample_format)))
        if len(bits) == len(sample_format) == 1
        else (0, 0)
    )
    if (samples, photometric) not in ((1, 1), (3, 2)) or depth is None:
        raise ImpastoError(
            f"is a TIFF of {samples} samples of {sorted(bits)} bits, photometric {photometric}",
            expected="grey (black is zero) or RGB of 8 or 16 bits or float32, without transparency",
            fix="save it again in that form",
        )
    return TiffHeader(size_px, samples, depth)  # type: ignore[arg-type]


class _Reader:
    """Reads numbers of either byte order from a TIFF or BigTIFF."""

    def __init__(self, file: BinaryIO, size_bytes: int) -> None:
        self.file, self.size_bytes = file, size_bytes
        head = self.bytes_at(0, 8)
        self.order = {b"II": "<", b"MM": ">"}.get(head[:2], "")
        if not self.order:
            raise ImpastoError("is not a TIFF file", fix="name the file by its format")
        (magic,) = struct.unpack(f"{self.order}H", head[2:4])
        if magic not in (42, 43):
            raise ImpastoError("is not a TIFF file", fix="name the file by its format")
        self.big = magic == 43
        self.pointer = "Q" if self.big else "I"

    def bytes_at(self, offset: int, count: int) -> bytes:
        if offset + count > self.size_bytes:
            raise _truncated()
        self.file.seek(offset)
        return self.file.read(count)

    def numbers_at(self, offset: int, code: str, count: int) -> tuple[int, ...]:
        size = struct.calcsize(f"={code}") * count
        return struct.unpack(f"{self.order}{count}{code}", self.bytes_at(offset, size))

    def first_directory(self) -> tuple[dict[int, tuple[int, ...]], int]:
        """Return the whole-number tags of the first page, and the next page's offset."""
        (at,) = self.numbers_at(8 if self.big else 4, self.pointer, 1)
        counter, entry_size = ("Q", 20) if self.big else ("H", 12)
        (entries,) = self.numbers_at(at, counter, 1)
        if entries > _MAX_ENTRIES:
            raise _truncated()
        at += 8 if self.big else 2
        tags: dict[int, tuple[int, ...]] = {}
        for i in range(entries):
            entry = at + i * entry_size
            tag, kind = self.numbers_at(entry, "H", 2)
            (count,) = self.numbers_at(entry + 4, self.pointer, 1)
            if kind not in _TYPES or not 0 < count <= _MAX_VALUES:
                continue
            code = _TYPES[kind]
            value = entry + (12 if self.big else 8)
            if struct.calcsize(f"={code}") * count > (8 if self.big else 4):
                (value,) = self.numbers_at(value, self.pointer, 1)
            tags[tag] = self.numbers_at(value, code, count)
        return tags, self.numbers_at(at + entries * entry_size, self.pointer, 1)[0]


def _one(tags: dict[int, tuple[int, ...]], tag: int, default: int) -> int:
    return tags[tag][0] if tag in tags else default


def _truncated() -> ImpastoError:
    return ImpastoError("is truncated or corrupt", fix="copy or record the file again")
