"""The scan's result, one point per camera pixel, and its file ``scan/range.exr``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import ImpastoError
from pipeline.formats.artifact import Artifact
from pipeline.formats.exr import read_exr, read_exr_attributes, read_float_channels, write_exr


@dataclass(frozen=True)
class RangeImage:
    """Points in the scan's frame on the scan camera's pixel grid; NaN where not measured.

    Parameters
    ----------
    points_mm
        (rows, columns, 3) float32 X, Y, Z.
    sigma_mm
        (rows, columns) float32 standard deviation of the position along the viewing ray.
    """

    points_mm: NDArray[np.float32]
    sigma_mm: NDArray[np.float32]


@dataclass(frozen=True)
class Texture:
    """What the scan camera saw under the projector's uniform light (``scan/texture.exr``).

    Parameters
    ----------
    radiance
        (rows, columns) or (rows, columns, 3) float32, linear, per second of exposure where the
        exposures are known: projector light alone, ambient removed where it can be; NaN where
        unknown (saturated in all exposures, or dark).
    source
        ``white`` (white minus black frames) or ``fringes`` (mean or amplitude of the phase steps).
    """

    radiance: NDArray[np.float32]
    source: str


_RANGE_FILES = ("scan/range.exr",)
_TEXTURE_FILES = ("scan/texture.exr",)
_SOURCE = "radianceSource"
_CHANNELS = {1: ("Y",), 3: ("R", "G", "B")}


def _save_range(workspace: Path, image: RangeImage) -> None:
    channels = dict(zip("XYZ", np.moveaxis(image.points_mm, 2, 0), strict=True))
    write_exr(workspace / _RANGE_FILES[0], {**channels, "S": image.sigma_mm})


def _load_range(workspace: Path) -> RangeImage:
    channels = read_float_channels(workspace / _RANGE_FILES[0], ("X", "Y", "Z", "S"))
    return RangeImage(channels[..., :3].copy(), channels[..., 3].copy())


def _save_texture(workspace: Path, texture: Texture) -> None:
    image = np.atleast_3d(texture.radiance)
    channels = dict(zip(_CHANNELS[image.shape[2]], np.moveaxis(image, 2, 0), strict=True))
    write_exr(workspace / _TEXTURE_FILES[0], channels, attributes={_SOURCE: texture.source})


def _load_texture(workspace: Path) -> Texture:
    path = workspace / _TEXTURE_FILES[0]
    found = read_exr(path)
    names = next((names for names in _CHANNELS.values() if set(names) == set(found)), None)
    if names is None:
        raise ImpastoError(
            f"it has the channels {sorted(found)}", where=str(path), expected="Y, or R, G and B"
        )
    image = read_float_channels(path, names)
    source = read_exr_attributes(path).get(_SOURCE, "white")
    return Texture(image[..., 0].copy() if len(names) == 1 else image, source)


RANGE = Artifact(_RANGE_FILES, _load_range, _save_range)
TEXTURE = Artifact(_TEXTURE_FILES, _load_texture, _save_texture)
