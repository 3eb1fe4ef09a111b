"""From linear radiance to a picture: exposure, sRGB, and the files.

Display value = sRGB(clip(exposure * radiance, 0, 1)); nothing else is done to the colours.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import ImpastoError, UsageError
from pipeline.formats.atomic import atomic_path
from pipeline.formats.exr import write_exr

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
"""Weights of linear sRGB (ITU-R BT.709) for the luminance Y."""

SUFFIXES = (".png", ".exr")


def automatic_exposure(image: NDArray[np.float32]) -> float:
    """Return the factor that takes the 99th percentile of the covered pixels' luminance to 0.9.

    Parameters
    ----------
    image
        (h, w, 4) linear RGB radiance, premultiplied by the coverage in the last channel.

    Returns
    -------
    float
        1 for a picture that is empty or black.
    """
    covered = image[image[..., 3] > 0.5]
    if not len(covered):
        return 1.0
    bright = float(np.percentile(covered[:, :3] @ LUMINANCE, 99))
    return 0.9 / bright if bright > 0 else 1.0


def encode_srgb(linear: NDArray[np.floating]) -> NDArray[np.float64]:
    """Encode linear values, clipped to [0, 1], with the sRGB curve (IEC 61966-2-1:1999)."""
    clipped = np.clip(np.asarray(linear, dtype=np.float64), 0.0, 1.0)
    return np.where(
        clipped <= 0.0031308, 12.92 * clipped, 1.055 * np.power(clipped, 1 / 2.4) - 0.055
    )


def decode_srgb(encoded: NDArray[np.floating]) -> NDArray[np.float64]:
    """Invert :func:`encode_srgb` on [0, 1]."""
    values = np.clip(np.asarray(encoded, dtype=np.float64), 0.0, 1.0)
    return np.where(values <= 0.04045, values / 12.92, np.power((values + 0.055) / 1.055, 2.4))


def to_display(
    image: NDArray[np.float32],
    *,
    exposure: float | None = None,
    background: float = 0.05,
    bits: int = 8,
) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Turn radiance into sRGB integers (h, w, 3).

    Parameters
    ----------
    image
        (h, w, 4) linear RGB radiance, premultiplied, with coverage.
    exposure
        Factor on the radiance; :func:`automatic_exposure` if left out.
    background
        Linear display value behind the painting, [0, 1]; the exposure does not touch it.
    bits
        8 or 16.
    """
    if bits not in (8, 16):
        raise UsageError(f"a picture of {bits} bits cannot be written", expected="8 or 16")
    factor = automatic_exposure(image) if exposure is None else exposure
    # Over-exposed paint is clipped before it is mixed with the background at its edge.
    coverage = image[..., 3:4].astype(np.float64)
    radiance = np.minimum(image[..., :3].astype(np.float64) * factor, coverage)
    largest = 2**bits - 1
    encoded = np.rint(encode_srgb(radiance + (1 - coverage) * background) * largest)
    if bits == 8:
        return np.asarray(encoded, dtype=np.uint8)
    return np.asarray(encoded, dtype=np.uint16)


def write_image(
    path: Path, image: NDArray[np.float32], *, exposure: float | None = None, bits: int = 8
) -> None:
    """Write radiance (h, w, 4) as ``.png`` (sRGB) or ``.exr`` (linear float32 R, G, B, A).

    An EXR holds the radiance itself: no exposure is applied.

    Raises
    ------
    ImpastoError
        Another suffix, or the file cannot be written.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise UsageError(f"the picture's type {suffix!r} is unknown", expected=".png or .exr")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_path(path) as temporary:
            if suffix == ".exr":
                write_exr(
                    temporary,
                    {name: np.ascontiguousarray(image[..., i]) for i, name in enumerate("RGBA")},
                )
            else:
                temporary.write_bytes(_png(to_display(image, exposure=exposure, bits=bits)))
    except OSError as error:
        raise ImpastoError(
            f"the picture cannot be written: {error.strerror or error}", where=str(path)
        ) from error


def _png(pixels: NDArray[np.uint8] | NDArray[np.uint16]) -> bytes:
    import cv2

    done, encoded = cv2.imencode(".png", pixels[..., ::-1])
    if not done:
        raise ImpastoError("OpenCV could not encode the PNG")
    return bytes(encoded.tobytes())
