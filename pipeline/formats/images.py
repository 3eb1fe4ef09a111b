"""Reading and writing images: never half of one, never more than declared, RGB order."""

from __future__ import annotations

import io
import struct
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import ImpastoError
from pipeline.formats.image_header import PNG_SIGNATURE, ImageHeader, png_header, read_image_header

Image = NDArray[np.uint8] | NDArray[np.uint16] | NDArray[np.float32]
# Deflate cannot compress further than 1032 to 1, so less data than that is not the image.
_DEFLATE_LIMIT = 1032
_MAX_METADATA_BYTES = 64 << 20


def read_image(path: Path, *, size_px: tuple[int, int] | None = None) -> Image:
    """Read a whole image as stored.

    Parameters
    ----------
    path
        A PNG, TIFF, EXR or RAW file.
    size_px
        The (width, height) that it must have; a RAW file may have it after its camera's own crop.

    Returns
    -------
    NDArray
        (rows, columns) or (rows, columns, 3) in RGB order: uint8, uint16, or float32 (half
        widened). RAW is developed to linear camera RGB, uint16.

    Raises
    ------
    ImpastoError
        If the file is missing, unsupported, of another size, truncated, corrupt, or holds NaN or
        infinity. The size is checked before anything is allocated.
    """
    header = read_image_header(path)
    if size_px is not None:
        header = header.fitted(size_px)
        if header.size_px != size_px:
            raise ImpastoError(
                f"is {header.size_px[0]} x {header.size_px[1]} px",
                where=str(path),
                expected=f"{size_px[0]} x {size_px[1]} px",
            )
    try:
        image = _DECODERS[header.kind](path, header)
    except OSError as error:
        raise ImpastoError(
            f"cannot be read ({error.strerror or error})", where=str(path)
        ) from error
    width, height = header.size_px
    if image.shape != ((height, width) if header.channels == 1 else (height, width, 3)):
        raise _corrupt(path)
    if image.dtype.kind == "f" and not np.isfinite(image).all():
        raise ImpastoError(
            "holds NaN or infinity", where=str(path), expected="finite values at every pixel"
        )
    return image


def write_png(path: Path, image: NDArray[np.uint8] | NDArray[np.uint16]) -> None:
    """Write (rows, columns) or (rows, columns, 3) RGB; the same image gives the same bytes.

    Raises
    ------
    ValueError
        If the array is not such an image of uint8 or uint16.
    """
    import cv2

    array = np.asarray(image)
    grey_or_rgb = array.ndim == 2 or (array.ndim == 3 and array.shape[2] == 3)
    if array.dtype not in (np.uint8, np.uint16) or not grey_or_rgb or array.size == 0:
        raise ValueError(f"{array.dtype} of shape {array.shape} is not an 8- or 16-bit image")
    stored = array if array.ndim == 2 else array[..., ::-1]
    _, encoded = cv2.imencode(
        ".png", np.ascontiguousarray(stored), [cv2.IMWRITE_PNG_COMPRESSION, 1]
    )
    path.write_bytes(encoded.tobytes())


def to_grey(image: NDArray[np.floating]) -> NDArray[np.float32]:
    """Average linear RGB (rows, columns, 3) to grey, (R + 2 G + B) / 4; grey passes unchanged.

    The weights are the counts of a Bayer mosaic, so that noise is averaged as the sensor drew it.
    """
    values = np.asarray(image, dtype=np.float32)
    if values.ndim == 2:
        return values
    return np.asarray((values[..., 0] + 2 * values[..., 1] + values[..., 2]) / 4)


def srgb_to_linear(encoded: NDArray[np.floating]) -> NDArray[np.float64]:
    """Invert the sRGB transfer function, [0, 1] to [0, 1] (IEC 61966-2-1:1999)."""
    values = np.asarray(encoded, dtype=np.float64)
    return np.where(
        values <= 0.04045, values / 12.92, ((np.maximum(values, 0.0) + 0.055) / 1.055) ** 2.4
    )


def _read_png(path: Path, header: ImageHeader) -> Image:
    width, height = header.size_px
    row_bytes = width * header.channels * (1 if header.depth == "uint8" else 2) + 1
    raw_bytes = height * row_bytes
    if path.stat().st_size > 2 * raw_bytes + _MAX_METADATA_BYTES:
        raise _corrupt(path)
    data = path.read_bytes()
    if png_header(io.BytesIO(data)) != header or not _png_is_whole(data, raw_bytes):
        raise _corrupt(path)
    return _decode_opencv(path, np.frombuffer(data, np.uint8))


def _png_is_whole(data: bytes, raw_bytes: int) -> bool:
    """Walk the chunks: lengths, check sums, enough image data, no transparency, the end."""
    view = memoryview(data)
    at, image_bytes = len(PNG_SIGNATURE), 0
    while at + 12 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, at)
        end = at + 12 + length
        if end > len(data):
            return False
        (check,) = struct.unpack_from(">I", data, end - 4)
        if zlib.crc32(view[at + 4 : end - 4]) != check or kind == b"tRNS":
            return False
        if kind == b"IDAT":
            image_bytes += length
        if kind == b"IEND":
            return image_bytes * _DEFLATE_LIMIT >= raw_bytes
        at = end
    return False


def _read_tiff(path: Path, header: ImageHeader) -> Image:
    image = _decode_opencv(path, np.fromfile(path, np.uint8))
    if image.dtype.name != header.depth:
        raise _corrupt(path)
    return image


def _decode_opencv(path: Path, data: NDArray[np.uint8]) -> Image:
    import cv2

    level = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(0)  # what it would print, the error below says
    try:
        image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
    except (cv2.error, MemoryError) as error:
        raise _corrupt(path) from error
    finally:
        cv2.utils.logging.setLogLevel(level)
    if image is None:
        raise _corrupt(path)
    return np.ascontiguousarray(image[..., ::-1]) if image.ndim == 3 else image


def _read_exr(path: Path, header: ImageHeader) -> Image:
    from pipeline.formats.exr import read_exr

    names = "Y" if header.channels == 1 else "RGB"
    planes = [plane.astype(np.float32) for plane in read_exr(path, names).values()]
    return planes[0] if header.channels == 1 else np.stack(planes, axis=-1)


def _read_raw(path: Path, header: ImageHeader) -> Image:
    from pipeline.formats.raw import read_raw

    image = read_raw(path)
    if header.crop_px is None or header.size_px != header.crop_px[2:]:
        return image
    left, top, width, height = header.crop_px
    return np.ascontiguousarray(image[top : top + height, left : left + width])


def _corrupt(path: Path) -> ImpastoError:
    return ImpastoError(
        "is truncated or corrupt", where=str(path), fix="copy or record the file again"
    )


_DECODERS = {"png": _read_png, "tiff": _read_tiff, "exr": _read_exr, "raw": _read_raw}
