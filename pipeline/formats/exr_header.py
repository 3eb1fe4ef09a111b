"""The header of an OpenEXR file, read without the library, so that nothing is allocated first.

Source: the OpenEXR file layout (openexr.com, "OpenEXR File Layout"): magic number, version and
flags, attributes (name, type, size, value) ended by a zero byte, a table of chunk offsets, chunks.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from pipeline.errors import ImpastoError

MAGIC = b"\x76\x2f\x31\x01"
MAX_PIXELS = 1 << 28
_MAX_HEADER_BYTES = 1 << 20
_MAX_CHANNELS = 64
_TILED, _DEEP, _MULTIPART = 0x200, 0x800, 0x1000
_PIXEL_TYPES = {0: "uint32", 1: "float16", 2: "float32"}
_LINES_PER_CHUNK = {0: 1, 1: 1, 2: 1, 3: 16, 4: 32, 5: 16, 6: 32, 7: 32, 8: 32, 9: 256}
# How far none, RLE and the two ZIPs (deflate) can compress; less data than that is not the image.
_MOST_COMPRESSION = {0: 1, 1: 64, 2: 1032, 3: 1032}


@dataclass(frozen=True)
class ExrHeader:
    """What an EXR file declares of itself.

    Parameters
    ----------
    size_px
        (width, height) of the data window.
    origin_px
        (x, y) of the data window's first pixel.
    display_size_px
        (width, height) of the display window.
    channels
        Pixel type (``float16``, ``float32`` or ``uint32``) by name, in the file's order.
    attributes
        The attributes of type string.
    """

    size_px: tuple[int, int]
    origin_px: tuple[int, int]
    display_size_px: tuple[int, int]
    channels: dict[str, str]
    attributes: dict[str, str]

    @property
    def pixel_bytes(self) -> int:
        """What all channels need uncompressed."""
        sample_bytes = sum(2 if kind == "float16" else 4 for kind in self.channels.values())
        return self.size_px[0] * self.size_px[1] * sample_bytes


def read_exr_header(path: Path) -> ExrHeader:
    """Read and check the header, and that every chunk it promises lies inside the file.

    Raises
    ------
    ImpastoError
        If the file is not a single-part scan-line EXR, declares more than ``MAX_PIXELS`` pixels,
        or is truncated.
    """
    try:
        with path.open("rb") as file:
            size_bytes = file.seek(0, 2)
            file.seek(0)
            head = file.read(_MAX_HEADER_BYTES)
            values, end = _attributes(head)
            header, compression = _interpret(values)
            chunks = math.ceil(header.size_px[1] / _LINES_PER_CHUNK[compression])
            stored = _check_chunks(file, end, chunks, size_bytes)
            ratio = _MOST_COMPRESSION.get(compression)
            if ratio is not None and stored * ratio < header.pixel_bytes:
                raise _truncated()
    except ImpastoError as error:
        raise ImpastoError(
            error.problem, where=str(path), expected=error.expected, fix=error.fix
        ) from None
    except OSError as error:
        raise ImpastoError(
            f"the file cannot be read ({error.strerror or error})", where=str(path)
        ) from error
    return header


def _attributes(head: bytes) -> tuple[dict[str, tuple[str, bytes]], int]:
    """Return the attributes' types and values by name, and where the header ends."""
    if head[:4] != MAGIC:
        raise ImpastoError("is not an EXR file", expected="the EXR magic number")
    if len(head) < 8:
        raise _truncated()
    (version,) = struct.unpack_from("<I", head, 4)
    if version & 0xFF != 2 or version & (_TILED | _DEEP | _MULTIPART):
        raise ImpastoError(
            "is tiled, deep, of several parts, or of another version",
            expected="an EXR of version 2 with one part of scan lines",
            fix="save it again as scan lines",
        )
    values: dict[str, tuple[str, bytes]] = {}
    at = 8
    while True:
        name, at = _string(head, at)
        if not name:
            return values, at
        kind, at = _string(head, at)
        if at + 4 > len(head):
            raise _truncated()
        (length,) = struct.unpack_from("<i", head, at)
        at += 4
        if length < 0 or at + length > len(head):
            raise _truncated()
        values[name] = (kind, head[at : at + length])
        at += length


def _string(head: bytes, at: int) -> tuple[str, int]:
    end = head.find(b"\0", at, at + 256)
    if end < 0:
        raise _truncated()
    return head[at:end].decode("utf-8", "replace"), end + 1


def _interpret(values: dict[str, tuple[str, bytes]]) -> tuple[ExrHeader, int]:
    """Check the required attributes; return the header and the compression's number."""
    window = _box(values, "dataWindow")
    display = _box(values, "displayWindow")
    width, height = window[2] - window[0] + 1, window[3] - window[1] + 1
    if width < 1 or height < 1 or width * height > MAX_PIXELS:
        raise ImpastoError(
            f"declares {width} x {height} px", expected=f"1 to {MAX_PIXELS} pixels in all"
        )
    compression = values.get("compression", ("", b""))[1]
    if len(compression) != 1 or compression[0] not in _LINES_PER_CHUNK:
        raise ImpastoError("has an unknown compression", fix="save it again with ZIP compression")
    header = ExrHeader(
        (width, height),
        (window[0], window[1]),
        (display[2] - display[0] + 1, display[3] - display[1] + 1),
        _channels(values.get("channels", ("", b""))[1]),
        {n: v.decode("utf-8", "replace") for n, (kind, v) in values.items() if kind == "string"},
    )
    return header, compression[0]


def _box(values: dict[str, tuple[str, bytes]], name: str) -> tuple[int, int, int, int]:
    kind, value = values.get(name, ("", b""))
    if kind != "box2i" or len(value) != 16:
        raise ImpastoError(f"has no valid {name}", fix="save it again")
    x0, y0, x1, y1 = struct.unpack("<4i", value)
    return x0, y0, x1, y1


def _channels(value: bytes) -> dict[str, str]:
    channels: dict[str, str] = {}
    at = 0
    while at < len(value) and value[at]:
        name, at = _string(value, at)
        if at + 16 > len(value):
            raise _truncated()
        kind, _, x_step, y_step = struct.unpack_from("<iIii", value, at)
        at += 16
        if kind not in _PIXEL_TYPES or (x_step, y_step) != (1, 1):
            raise ImpastoError(
                f"channel {name!r} is subsampled or of unknown type",
                expected="half, float or uint32 at every pixel",
            )
        channels[name] = _PIXEL_TYPES[kind]
    if not 1 <= len(channels) <= _MAX_CHANNELS:
        raise ImpastoError(f"has {len(channels)} channels", expected=f"1 to {_MAX_CHANNELS}")
    return channels


def _check_chunks(file: BinaryIO, table: int, chunks: int, size_bytes: int) -> int:
    """Check that the table, at ``table``, and all chunks are whole; return the chunks' bytes."""
    stored = 0
    first = table + 8 * chunks
    if first > size_bytes:
        raise _truncated()
    file.seek(table)
    for offset in struct.unpack(f"<{chunks}Q", file.read(8 * chunks)):
        if not first <= offset <= size_bytes - 8:
            raise _truncated()
        file.seek(offset + 4)
        (length,) = struct.unpack("<i", file.read(4))
        if length < 0 or offset + 8 + length > size_bytes:
            raise _truncated()
        stored += length
    return stored


def _truncated() -> ImpastoError:
    return ImpastoError("is truncated or corrupt", fix="copy or record the file again")
