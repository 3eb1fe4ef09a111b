"""A camera's RAW file, developed to linear camera RGB and nothing more."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rawpy
from numpy.typing import NDArray

from pipeline.errors import ImpastoError

Rectangle = tuple[int, int, int, int]


def raw_layout(path: Path) -> tuple[tuple[int, int], Rectangle | None]:
    """Return the developed picture's size and the part that the camera calls the picture.

    Only the metadata are read.

    Returns
    -------
    tuple
        (width, height) of what :func:`read_raw` gives, and (left, top, width, height) of the
        camera's own crop inside it, which leaves out margins needed for demosaicking; None where
        the file declares none.

    Raises
    ------
    ImpastoError
        If the file is not a RAW file that LibRaw knows.
    """
    try:
        with rawpy.imread(str(path)) as raw:
            sizes = raw.sizes
    except (rawpy.LibRawError, MemoryError) as error:
        raise _unreadable(path, error) from error
    left = sizes.crop_left_margin - sizes.left_margin
    top = sizes.crop_top_margin - sizes.top_margin
    width, height = sizes.crop_width, sizes.crop_height
    inside = left >= 0 and top >= 0 and left + width <= sizes.width and top + height <= sizes.height
    crop = (left, top, width, height) if inside and width > 0 and height > 0 else None
    return (sizes.width, sizes.height), crop


def read_raw(path: Path) -> NDArray[np.uint16]:
    """Develop the file: black removed, demosaicked, linear, unbalanced, unturned.

    Returns
    -------
    NDArray
        (rows, columns, 3) uint16 in the camera's own RGB; 65535 is the sensor's saturation.

    Raises
    ------
    ImpastoError
        If the file cannot be decoded.
    """
    try:
        with rawpy.imread(str(path)) as raw:
            return raw.postprocess(  # type: ignore[no-any-return]
                gamma=(1, 1),
                no_auto_bright=True,
                output_bps=16,
                user_wb=[1.0, 1.0, 1.0, 1.0],
                output_color=rawpy.ColorSpace.raw,
                user_flip=0,
                # The brightest value of a picture must not set its scale.
                adjust_maximum_thr=0.0,
            )
    except (rawpy.LibRawError, MemoryError) as error:
        raise _unreadable(path, error) from error


def _unreadable(path: Path, error: BaseException) -> ImpastoError:
    reason = error.args[0] if error.args else error
    if isinstance(reason, bytes):
        reason = reason.decode(errors="replace")
    return ImpastoError(
        f"cannot be decoded as a RAW file ({reason})",
        where=str(path),
        fix="copy the file again, or convert it to a 16-bit linear TIFF",
    )
