"""The asset: all that a renderer needs, and nothing else (``asset/``)."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from pipeline.errors import ImpastoError
from pipeline.formats.artifact import Artifact
from pipeline.formats.boxes import Boxes, read_boxes, write_boxes
from pipeline.formats.strict_json import parse_model, read_text

DOCUMENT = "asset.json"
FORMAT, VERSION = "impasto-asset", 1
MAX_TEXELS = 1 << 28
HALF_MAX = 65504.0
"""Largest finite half-float."""

_TEXTURES = {
    "relief.exr": ("NX", "NY", "H", "MASK"),
    "diffuse.exr": ("R", "G", "B"),
    "specular.exr": ("R", "G", "B"),
    "lobe.exr": ("CXY", "CZ", "K"),
}
_BOXES, _PREVIEW = "boxes.npz", "preview.png"
_NAMES = (DOCUMENT, *_TEXTURES, _BOXES, _PREVIEW)


@dataclass(frozen=True)
class Asset:
    """A painting ready to be drawn; arrays on one grid, row 0 at the painting's top.

    Sample (row, column) lies at canvas coordinates ``(column, -row) * spacing_mm``.

    Parameters
    ----------
    heights_mm
        (rows, columns) float32; 0 outside the canvas.
    normals
        (rows, columns, 2) float32 n_x, n_y of the unit normal, canvas frame, n_z > 0.
    mask
        (rows, columns) bool: the canvas.
    diffuse, specular, lobe
        (rows, columns, 3) float32 as in ``ReflectanceMaps``, 0 outside the canvas.
    boxes
        The relief above the bump-mapped plane; may be empty.
    notes
        Plain statements about what is and is not known: ``reflectance`` (``fitted``,
        ``white image``, ``fringes``), ``absolute``, ``colour_calibrated``, ``scale_known``.
    """

    name: str
    spacing_mm: float
    heights_mm: NDArray[np.float32]
    normals: NDArray[np.float32]
    mask: NDArray[np.bool_]
    diffuse: NDArray[np.float32]
    specular: NDArray[np.float32]
    lobe: NDArray[np.float32]
    boxes: Boxes
    notes: dict[str, str | bool | float]


class _Document(BaseModel):
    """``asset.json``; unknown keys are kept for later versions to add some."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    format: Literal["impasto-asset"]
    version: Literal[1]
    name: Annotated[str, Field(max_length=1000)]
    size: tuple[Annotated[int, Field(ge=1)], Annotated[int, Field(ge=1)]]
    spacing_mm: Annotated[float, Field(gt=0)]
    notes: dict[str, str | bool | float]


def save_asset(folder: Path, asset: Asset) -> None:
    """Write an asset's files into a folder that exists.

    Textures are half-floats; what half-floats cannot hold is clamped, and the document states the
    rounding error of the heights and how many values were clamped. The same asset always gives the
    same bytes.

    Raises
    ------
    ImpastoError
        If a file cannot be written.
    ValueError
        If the arrays are not of one size.
    """
    from pipeline.formats.exr import write_exr
    from pipeline.formats.images import write_png
    from pipeline.formats.preview import shade_preview

    rows, columns = asset.heights_mm.shape
    clamped = 0
    rounding = 0.0
    for file, names in _TEXTURES.items():
        channels = {}
        for name, image in zip(names, _images(asset, file), strict=True):
            if image.shape != (rows, columns):
                raise ValueError(f"{file}, {name}: {image.shape} is not {(rows, columns)}")
            known = np.nan_to_num(image, nan=0.0, posinf=np.inf, neginf=-np.inf)
            clamped += int(np.count_nonzero(np.abs(known) > HALF_MAX))
            channels[name] = np.clip(known, -HALF_MAX, HALF_MAX).astype(np.float16)
        if file == "relief.exr":
            exact = np.clip(asset.heights_mm, -HALF_MAX, HALF_MAX)
            rounding = float(np.abs(channels["H"].astype(np.float32) - exact).max())
        write_exr(folder / file, channels)
    write_boxes(folder / _BOXES, asset.boxes)
    write_png(folder / _PREVIEW, shade_preview(asset))
    document: dict[str, Any] = {
        "format": FORMAT,
        "version": VERSION,
        "name": asset.name,
        "size": [columns, rows],
        "spacing_mm": float(asset.spacing_mm),
        "notes": asset.notes,
        "rounding": {
            "height_max_error_mm": rounding,
            "values_clamped": clamped,
            "statement": "textures are half-floats: 11 significant bits, relative error 2^-11",
        },
        "files": {file: list(names) for file, names in _TEXTURES.items()}
        | {_BOXES: "relief above the plane", _PREVIEW: "for people"},
        "units": {"H": "mm", "NX, NY": "unit normal", "R, G, B": "1/sr", "spacing_mm": "mm"},
        "origin": "sample (row, column) lies at x = column * spacing_mm, y = -row * spacing_mm",
    }
    text = json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n"
    (folder / DOCUMENT).write_text(text, encoding="utf-8")


def load_asset(folder: Path) -> Asset:
    """Read the asset in ``folder`` (the folder that holds ``asset.json``).

    Nothing in the document names a file, and sizes are checked before memory is taken.

    Raises
    ------
    ImpastoError
        If a file is missing, damaged, or contradicts the document.
    """
    from pipeline.formats.exr import read_exr
    from pipeline.formats.exr_header import read_exr_header

    where = str(folder / DOCUMENT)
    if not (folder / DOCUMENT).is_file():
        raise ImpastoError(
            f"there is no {DOCUMENT}", where=str(folder), expected="the folder of an asset"
        )
    document = parse_model(_Document, read_text(folder / DOCUMENT, where=where), where=where)
    columns, rows = document.size
    if columns * rows > MAX_TEXELS:
        raise ImpastoError(
            f"{columns} x {rows} texels", where=f"{where}: size", expected=f"<= {MAX_TEXELS}"
        )
    for file, names in _TEXTURES.items():
        header = read_exr_header(folder / file)
        if header.size_px != (columns, rows):
            raise ImpastoError(
                f"is {header.size_px[0]} x {header.size_px[1]}",
                where=str(folder / file),
                expected=f"{columns} x {rows} as {DOCUMENT} says",
            )
        if set(header.channels) != set(names):
            raise ImpastoError(
                f"has the channels {', '.join(sorted(header.channels)[:8])}",
                where=str(folder / file),
                expected=", ".join(names),
            )
    images = {}
    for file, names in _TEXTURES.items():
        stored = read_exr(folder / file, names)
        stack = np.stack([stored[name].astype(np.float32) for name in names], axis=-1)
        if not np.isfinite(stack).all():
            raise ImpastoError("holds NaN or infinity", where=str(folder / file))
        images[file] = stack
    relief = images["relief.exr"]
    return Asset(
        name=document.name,
        spacing_mm=document.spacing_mm,
        heights_mm=relief[..., 2].copy(),
        normals=relief[..., :2].copy(),
        mask=relief[..., 3] > 0.5,
        diffuse=images["diffuse.exr"],
        specular=images["specular.exr"],
        lobe=images["lobe.exr"],
        boxes=read_boxes(folder / _BOXES, (rows, columns)),
        notes=dict(document.notes),
    )


def _images(asset: Asset, file: str) -> list[NDArray[np.floating]]:
    """Return the images of a texture's channels."""
    if file == "relief.exr":
        normals = np.moveaxis(asset.normals, 2, 0)
        return [*normals, asset.heights_mm, asset.mask.astype(np.float32)]
    return list(np.moveaxis(getattr(asset, file.removesuffix(".exr")), 2, 0))


ASSET = Artifact(
    tuple(f"asset/{name}" for name in _NAMES),
    lambda workspace: load_asset(workspace / "asset"),
    lambda workspace, asset: save_asset(workspace / "asset", asset),
)
