"""OpenEXR images as named channels: float32, half or uint32, ZIP, the same bytes every time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import OpenEXR
from numpy.typing import NDArray

from pipeline.errors import ImpastoError
from pipeline.formats.exr_header import MAX_PIXELS, ExrHeader, read_exr_header

_DTYPES = ("float16", "float32", "uint32")
# Names that the library gives a meaning, so that a text of ours must not take them.
_RESERVED = {
    "channels", "compression", "dataWindow", "displayWindow", "lineOrder", "name",
    "pixelAspectRatio", "screenWindowCenter", "screenWindowWidth", "type", "version", "view",
    "chunkCount", "tiles",
}  # fmt: skip


def write_exr(
    path: Path,
    channels: Mapping[str, NDArray[np.float32] | NDArray[np.float16] | NDArray[np.uint32]],
    *,
    attributes: Mapping[str, str] | None = None,
) -> None:
    """Write images of one size as the channels of one file.

    Parameters
    ----------
    path
        The file; its folder must exist.
    channels
        (rows, columns) float32, float16 or uint32 by channel name (``"H"``, ``"R"``, ...).
    attributes
        Texts for the header.

    Raises
    ------
    ImpastoError
        If the file cannot be written.
    ValueError
        If there is no channel, or sizes or types are not as described.
    """
    arrays = {name: np.ascontiguousarray(image) for name, image in sorted(channels.items())}
    shapes = {image.shape for image in arrays.values()}
    if len(shapes) != 1 or len(shape := shapes.pop()) != 2 or not 1 <= np.prod(shape) <= MAX_PIXELS:
        raise ValueError(f"channels must be images of one size, not {shapes or 'none'}")
    for name, image in arrays.items():
        if image.dtype.name not in _DTYPES or not 0 < len(name.encode()) < 256:
            raise ValueError(f"channel {name!r} of {image.dtype} cannot be written as EXR")
    texts = dict(sorted((attributes or {}).items()))
    if _RESERVED & texts.keys():
        raise ValueError(f"reserved attributes {sorted(_RESERVED & texts.keys())}")
    header = {**texts, "compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    try:
        with OpenEXR.File(header, arrays) as file:
            file.write(str(path))
    except RuntimeError as error:
        raise ImpastoError(
            "the file cannot be written",
            where=str(path),
            fix="check that the folder exists, may be written to and has space left",
        ) from error


def read_exr(path: Path, names: Sequence[str] | None = None) -> dict[str, NDArray[np.generic]]:
    """Read the named channels, or all, as they are stored.

    Parameters
    ----------
    path
        The file.
    names
        The channels wanted.

    Returns
    -------
    dict
        (rows, columns) float32, float16 or uint32 by name, in the order of ``names``.

    Raises
    ------
    ImpastoError
        If the file is missing, not a plain EXR, too large, truncated or corrupt, or lacks a
        channel. Sizes are checked before anything is allocated.
    """
    header = read_exr_header(path)
    wanted = list(header.channels) if names is None else list(names)
    for name in wanted:
        if name not in header.channels:
            raise ImpastoError(
                f"channel {name!r} is missing",
                where=str(path),
                expected=f"the channels {', '.join(wanted)} and there are "
                f"{', '.join(header.channels)}",
            )
    pixels = _decode(path, header)
    return {name: pixels[name] for name in wanted}


def read_float_channels(path: Path, names: Sequence[str]) -> NDArray[np.float32]:
    """Read the named channels as one (rows, columns, len(names)) float32 image.

    Raises
    ------
    ImpastoError
        As :func:`read_exr`.
    """
    channels = read_exr(path, names)
    return np.stack([channels[name] for name in names], axis=2).astype(np.float32, copy=False)


def read_exr_attributes(path: Path) -> dict[str, str]:
    """Return the header's texts.

    Raises
    ------
    ImpastoError
        If the file is missing, not a plain EXR, too large or truncated.
    """
    return read_exr_header(path).attributes


def _decode(path: Path, header: ExrHeader) -> dict[str, NDArray[np.generic]]:
    width, height = header.size_px
    corrupt = ImpastoError("is corrupt", where=str(path), fix="copy or record the file again")
    try:
        # A part with a chunk that does not decode is left out by the library, with a warning.
        with OpenEXR.File(str(path), separate_channels=True) as file:
            if len(file.parts) != 1:
                raise corrupt
            pixels = {name: channel.pixels for name, channel in file.channels().items()}
    except (RuntimeError, ValueError, TypeError, MemoryError) as error:
        raise corrupt from error
    for name, kind in header.channels.items():
        image = pixels.get(name)
        if image is None or image.shape != (height, width) or image.dtype.name != kind:
            raise corrupt
    return pixels
