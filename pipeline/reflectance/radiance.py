"""Photographs become radiance: darks, flats, exposure and responsivity taken out."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.bundle import Bundle
from pipeline.formats.capture import Capture, Correction, Photo

SATURATED = 0.99
"""Share of full scale from which a value may be clipped (white balance and rounding included)."""

DARKEST_FLAT = 0.02
"""A flat's pixel below this share of its brightest says nothing of the light that fell on it."""


def radiance(bundle: Bundle, photo: Photo) -> NDArray[np.float32]:
    """Read a photograph as radiance.

    Returns
    -------
    (rows, columns, 3) float32 RGB: linear value over (exposure x responsivity), each taken as 1
    where the bundle does not give it; NaN where saturated, and next to that (the sensor's and the
    lens's spread reach there).

    Source: the bundle page's radiometry, value = L x exposure_s x responsivity_per_s.
    """
    camera = bundle.capture.cameras[photo.camera]
    value = bundle.read(photo.file)
    if value.ndim == 2:
        value = np.repeat(value[..., None], 3, axis=2)
    saturated = grow_by_one(np.asarray((value >= SATURATED).any(axis=2)))
    dark = closest(bundle.capture, bundle.capture.darks, photo)
    if dark is not None:
        value = value - _as_rgb(bundle.read(dark.file))
    flat = closest(bundle.capture, bundle.capture.flats, photo)
    if flat is not None:
        value = value / relative_flat(_as_rgb(bundle.read(flat.file)))
    scale = (photo.exposure_s or 1.0) * (camera.responsivity_per_s or 1.0)
    result = (value / np.float32(scale)).astype(np.float32)
    result[saturated] = np.nan
    return result


def closest(
    capture: Capture, corrections: tuple[Correction, ...], photo: Photo
) -> Correction | None:
    """Pick the dark or flat of the photo's camera body whose exposure is the nearest in ratio.

    ``lens_of`` names the same body standing elsewhere, so its corrections serve too.
    """
    body = _body(capture, photo.camera)
    own = [entry for entry in corrections if _body(capture, entry.camera) == body]
    if not own or photo.exposure_s is None:
        return own[0] if own else None
    wanted = photo.exposure_s

    def ratio(entry: Correction) -> float:
        return abs(math.log((entry.exposure_s or wanted) / wanted))

    return min(own, key=ratio)


def relative_flat(flat: NDArray[np.float32]) -> NDArray[np.float32]:
    """Scale a flat to 1 at its brightest (99th percentile); what is too dark becomes NaN."""
    brightest = np.nanpercentile(flat, 99, axis=(0, 1))
    relative = flat / np.maximum(brightest, np.finfo(np.float32).tiny)
    return np.where(relative > DARKEST_FLAT, relative, np.nan).astype(np.float32)


def grow_by_one(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Dilate a mask by one pixel in all eight directions."""
    padded = np.pad(mask, 1)
    rows, columns = mask.shape
    grown = np.zeros_like(mask)
    for down in range(3):
        for right in range(3):
            grown |= padded[down : down + rows, right : right + columns]
    return grown


def _as_rgb(image: NDArray[np.float32]) -> NDArray[np.float32]:
    return image if image.ndim == 3 else np.repeat(image[..., None], 3, axis=2)


def _body(capture: Capture, name: str) -> str:
    return capture.cameras[name].lens_of or name
