"""The asset's reflectance: fitted lobes where there are any, the white picture elsewhere."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.reflectance_maps import ReflectanceMaps

_MATTE_LOBE = np.array([0.0, 0.0, 1.0], np.float32)


@dataclass(frozen=True)
class Reflectance:
    """Maps without gaps, (rows, columns, 3) float32 each, 0 outside the canvas.

    Parameters
    ----------
    diffuse, specular, lobe
        As in :class:`~pipeline.formats.asset.Asset`.
    borrowed
        Texels that took their diffuse part from the white picture.
    """

    diffuse: NDArray[np.float32]
    specular: NDArray[np.float32]
    lobe: NDArray[np.float32]
    borrowed: int


def matte(albedo: NDArray[np.float32], canvas: NDArray[np.bool_]) -> Reflectance:
    """Return Lambert's reflectance: rho_d = albedo / pi, no highlight.

    Parameters
    ----------
    albedo
        (rows, columns, 3) in [0, 1], 0 outside the canvas.
    canvas
        (rows, columns) bool.
    """
    lobe = np.where(canvas[..., None], _MATTE_LOBE, 0).astype(np.float32)
    return Reflectance(
        (albedo / np.pi).astype(np.float32), np.zeros_like(albedo, np.float32), lobe, 0
    )


def complete(
    maps: ReflectanceMaps, albedo: NDArray[np.float32], canvas: NDArray[np.bool_]
) -> Reflectance:
    """Fill what no photograph saw from the white picture, brought to the maps' scale and colour.

    Parameters
    ----------
    maps
        Fitted; NaN where there was no fit.
    albedo
        (rows, columns, 3) relative albedo without gaps.
    canvas
        (rows, columns) bool.
    """
    stacked = np.concatenate([maps.diffuse, maps.specular, maps.lobe], axis=2)
    fitted = np.isfinite(stacked).all(axis=2) & (maps.count > 0) & canvas
    missing = canvas & ~fitted
    diffuse, specular, lobe = (
        np.where(fitted[..., None], image, 0).astype(np.float32)
        for image in (maps.diffuse, maps.specular, maps.lobe)
    )
    if missing.any():
        both = fitted & (albedo > 0).all(axis=2)
        ratio = (
            np.median(diffuse[both] / albedo[both], axis=0) if both.any() else np.full(3, 1 / np.pi)
        )
        diffuse[missing] = albedo[missing] * ratio
        lobe[missing] = _MATTE_LOBE
    return Reflectance(diffuse, specular, lobe, int(np.count_nonzero(missing)))
