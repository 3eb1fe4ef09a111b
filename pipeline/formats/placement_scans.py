"""Scans of further placements of a canvas larger than the field, ``scan/placements.npz``.

The first placement is ``scan/range.exr``; a canvas scanned at once leaves this file empty.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import ImpastoError
from pipeline.formats.artifact import Artifact
from pipeline.formats.npz import read_npz, write_npz
from pipeline.formats.range_image import RangeImage, Texture

MOST_PLACEMENTS = 16
"""Most placements besides the first."""

_FILES = ("scan/placements.npz",)
_LARGEST_SIDE = 1 << 16
_NAME_BYTES = 256
_SOURCES = ("white", "fringes")


@dataclass(frozen=True)
class PlacementScan:
    """What was measured in one placement, on the scan camera's pixel grid.

    Parameters
    ----------
    name
        The scan sequence's.
    range_image, texture
        As those of the first placement.
    """

    name: str
    range_image: RangeImage
    texture: Texture


def _save(workspace: Path, scans: tuple[PlacementScan, ...]) -> None:
    arrays: dict[str, NDArray[np.generic]] = {"count": np.array([len(scans)], np.int64)}
    for i, scan in enumerate(scans):
        name = np.frombuffer(scan.name.encode()[:_NAME_BYTES], np.uint8)
        arrays[f"name_{i}"] = name
        arrays[f"white_{i}"] = np.array([scan.texture.source == "white"])
        # One layer after the other: X, Y, Z, S, then the radiance's channels.
        layers = [*np.moveaxis(scan.range_image.points_mm, 2, 0), scan.range_image.sigma_mm]
        layers += [*np.moveaxis(np.atleast_3d(scan.texture.radiance), 2, 0)]
        arrays[f"layers_{i}"] = np.stack(layers).astype(np.float32, copy=False)
    write_npz(workspace / _FILES[0], arrays)


def _load(workspace: Path) -> tuple[PlacementScan, ...]:
    path = workspace / _FILES[0]
    count = int(read_npz(path, {"count": ("<i8", (1,))}, longest=1)["count"][0])
    if not 0 <= count <= MOST_PLACEMENTS:
        raise ImpastoError(
            f"it holds {count} placements", where=str(path), expected=f"0 to {MOST_PLACEMENTS}"
        )
    return tuple(_read(path, i) for i in range(count))


def _read(path: Path, i: int) -> PlacementScan:
    short = read_npz(
        path, {f"name_{i}": ("|u1", (None,)), f"white_{i}": ("|b1", (1,))}, longest=_NAME_BYTES
    )
    layers = read_npz(path, {f"layers_{i}": ("<f4", (None, None, None))}, longest=_LARGEST_SIDE)[
        f"layers_{i}"
    ]
    if layers.shape[0] not in (5, 7) or not layers.size:
        raise ImpastoError(
            f"placement {i + 1} has {layers.shape[0]} layers",
            where=str(path),
            expected="X, Y, Z, S and one or three of radiance",
            fix="run the stage again: impasto run ... --from scan --force",
        )
    points = np.ascontiguousarray(np.moveaxis(layers[:3], 0, 2))
    radiance = layers[4] if len(layers) == 5 else np.moveaxis(layers[4:], 0, 2)
    return PlacementScan(
        short[f"name_{i}"].tobytes().decode(errors="replace"),
        RangeImage(points, layers[3]),
        Texture(np.ascontiguousarray(radiance), _SOURCES[int(not short[f"white_{i}"][0])]),
    )


PLACEMENTS = Artifact(_FILES, _load, _save)
