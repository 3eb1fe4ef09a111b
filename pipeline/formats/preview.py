"""The asset's preview: albedo under an oblique lamp and a soft sky, in plain numpy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.asset import Asset

LONGEST_PX = 640
_LIGHT = np.array([-0.55, 0.55, 0.63])
_LIGHT = _LIGHT / np.linalg.norm(_LIGHT)
_SKY = 0.35
_BACKGROUND = 0.05
_WHITE_PERCENTILE = 99.0
_WHITE = 0.9


def shade_preview(asset: Asset) -> NDArray[np.uint8]:
    """Return an sRGB picture, (rows, columns, 3), at most ``LONGEST_PX`` on its longer side.

    Diffuse light only; the brightest percentile of the canvas is shown at 90 %. Reduction is by the
    mean over whole blocks of texels, in linear light.
    """
    step = int(np.ceil(max(asset.mask.shape) / LONGEST_PX))
    normal = asset.normals.astype(np.float64)
    nz = np.sqrt(np.maximum(1 - (normal**2).sum(axis=-1), 0))
    cosine = np.maximum(normal @ _LIGHT[:2] + nz * _LIGHT[2], 0) / _LIGHT[2]
    light = _SKY * (0.5 + 0.5 * nz) + (1 - _SKY) * cosine
    colour = np.nan_to_num(asset.diffuse * light[..., None], posinf=0)
    weight = _blocks(asset.mask.astype(np.float64)[..., None], step)
    linear = _blocks(np.where(asset.mask[..., None], colour, 0.0), step)
    shown = linear[weight[..., 0] > 0.5]
    bright = float(np.percentile(shown.max(axis=-1), _WHITE_PERCENTILE)) if shown.size else 0.0
    linear = linear * (_WHITE / bright if bright > 0 else 1.0) + _BACKGROUND * (1 - weight)
    return np.rint(255 * _encode_srgb(linear)).astype(np.uint8)


def _blocks(image: NDArray[np.floating], step: int) -> NDArray[np.float64]:
    """Average blocks of step x step; the last ones repeat the border."""
    rows, columns = image.shape[:2]
    padded = np.pad(image, ((0, -rows % step), (0, -columns % step), (0, 0)), mode="edge")
    shape = (padded.shape[0] // step, step, padded.shape[1] // step, step, -1)
    return np.asarray(padded.reshape(shape).mean(axis=(1, 3)), dtype=np.float64)


def _encode_srgb(linear: NDArray[np.float64]) -> NDArray[np.float64]:
    """Encode [0, 1] with the sRGB curve (IEC 61966-2-1:1999)."""
    clipped = np.clip(linear, 0, 1)
    return np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1 / 2.4) - 0.055)
