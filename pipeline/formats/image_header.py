"""What an image file declares of itself, read from its first bytes, before anything is decoded."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO, Literal

from pipeline.errors import ImpastoError
from pipeline.formats.exr_header import MAX_PIXELS, read_exr_header
from pipeline.formats.tiff_header import read_tiff_header

Depth = Literal["uint8", "uint16", "float16", "float32"]
# fmt: off
RAW_SUFFIXES = frozenset({
    ".3fr", ".arw", ".cr2", ".cr3", ".dng", ".erf", ".fff", ".iiq", ".kdc", ".mef", ".mos", ".mrw",
    ".nef", ".nrw", ".orf", ".pef", ".raf", ".raw", ".rw2", ".rwl", ".sr2", ".srf", ".srw", ".x3f",
})
# fmt: on
PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_FULL_SCALE = {"uint8": 255.0, "uint16": 65535.0, "float16": 1.0, "float32": 1.0}


@dataclass(frozen=True)
class ImageHeader:
    """Format, size and depth of an image.

    Parameters
    ----------
    kind
        The file format.
    size_px
        (width, height) of what is read; for a RAW file, of the demosaicked picture or its crop.
    channels
        1 (grey) or 3 (RGB).
    depth
        Type of the stored values.
    crop_px
        (left, top, width, height) of the part that a RAW file's camera calls the picture.
    """

    kind: Literal["png", "tiff", "exr", "raw"]
    size_px: tuple[int, int]
    channels: Literal[1, 3]
    depth: Depth
    crop_px: tuple[int, int, int, int] | None = None

    def fitted(self, size_px: tuple[int, int]) -> ImageHeader:
        """Take the camera's own crop of a RAW file where that, and not the whole, has the size."""
        if self.crop_px is not None and self.size_px != size_px == self.crop_px[2:]:
            return replace(self, size_px=size_px)
        return self

    @property
    def full_scale(self) -> float:
        """The stored value that means 1.0."""
        return _FULL_SCALE[self.depth]

    @property
    def linear(self) -> bool:
        """True if the format is proportional to light whatever the bundle's encoding."""
        return self.kind in ("exr", "raw")


def read_image_header(path: Path) -> ImageHeader:
    """Probe an image file; its name's suffix chooses the format, which the content must match.

    Raises
    ------
    ImpastoError
        If the file cannot be read, is of no supported format or layout, is truncated so that it
        shows in the header, or declares more than ``MAX_PIXELS`` pixels.
    """
    suffix = path.suffix.lower()
    probe = _PROBES.get(suffix, _probe_raw if suffix in RAW_SUFFIXES else None)
    if probe is None:
        raise ImpastoError(
            f"has the unsupported format {path.suffix!r}",
            where=str(path),
            expected="PNG, TIFF, EXR or a camera's RAW file",
            fix="convert the file without loss",
        )
    try:
        header = probe(path)
    except ImpastoError as error:
        raise ImpastoError(
            error.problem, where=str(path), expected=error.expected, fix=error.fix
        ) from None
    except OSError as error:
        raise ImpastoError(
            f"cannot be read ({error.strerror or error})", where=str(path)
        ) from error
    width, height = header.size_px
    if width < 1 or height < 1 or width * height > MAX_PIXELS:
        raise ImpastoError(
            f"declares {width} x {height} px",
            where=str(path),
            expected=f"1 to {MAX_PIXELS} pixels in all",
        )
    return header


def _probe_png(path: Path) -> ImageHeader:
    with path.open("rb") as file:
        return png_header(file)


def png_header(file: BinaryIO) -> ImageHeader:
    """Read IHDR (PNG specification, 3rd edition, 11.2.2)."""
    start = file.read(33)
    if start[:8] != PNG_SIGNATURE:
        raise ImpastoError("is not a PNG file", fix="name the file by its format")
    if len(start) < 33 or start[8:16] != b"\x00\x00\x00\rIHDR":
        raise ImpastoError("is truncated or corrupt", fix="copy or record the file again")
    width, height, bits, colour, *_ = struct.unpack(">IIBBBBB", start[16:29])
    if bits not in (8, 16) or colour not in (0, 2):
        raise ImpastoError(
            f"is a PNG of colour type {colour} and {bits} bits",
            expected="grey or RGB of 8 or 16 bits, without palette or transparency",
            fix="save it again in that form",
        )
    depth: Depth = "uint8" if bits == 8 else "uint16"
    return ImageHeader("png", (width, height), 1 if colour == 0 else 3, depth)


def _probe_tiff(path: Path) -> ImageHeader:
    tiff = read_tiff_header(path)
    return ImageHeader("tiff", tiff.size_px, tiff.channels, tiff.depth)


def _probe_exr(path: Path) -> ImageHeader:
    exr = read_exr_header(path)
    names = set(exr.channels)
    kinds = set(exr.channels.values())
    if names not in ({"R", "G", "B"}, {"Y"}) or len(kinds) != 1 or "uint32" in kinds:
        raise ImpastoError(
            f"has the channels {', '.join(f'{n} ({k})' for n, k in exr.channels.items())}",
            expected="R, G and B, or Y, all half or all float",
        )
    if exr.origin_px != (0, 0) or exr.display_size_px != exr.size_px:
        raise ImpastoError(
            "has a data window that differs from its display window",
            expected="the whole image, from (0, 0)",
            fix="save it again uncropped",
        )
    depth: Depth = "float16" if "float16" in kinds else "float32"
    return ImageHeader("exr", exr.size_px, 1 if names == {"Y"} else 3, depth)


def _probe_raw(path: Path) -> ImageHeader:
    from pipeline.formats.raw import raw_layout

    size_px, crop_px = raw_layout(path)
    return ImageHeader("raw", size_px, 3, "uint16", crop_px)


_PROBES: dict[str, Callable[[Path], ImageHeader]] = {
    ".png": _probe_png,
    ".tif": _probe_tiff,
    ".tiff": _probe_tiff,
    ".exr": _probe_exr,
}
