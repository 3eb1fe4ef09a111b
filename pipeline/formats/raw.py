"""A camera's RAW file, developed to linear camera RGB and nothing more."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rawpy
from numpy.typing import NDArray

from pipeline.errors import ImpastoError


def raw_size_px(path: Path) -> tuple[int, int]:
    """Return (width, height) of the developed picture, from the metadata alone.

    Raises
    ------
    ImpastoError
        If the file is not a RAW file that LibRaw knows.
    """
    try:
        with rawpy.imread(str(path)) as raw:
            return raw.sizes.width, raw.sizes.height
    except (rawpy.LibRawError, MemoryError) as error:
        raise _unreadable(path, error) from error


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
