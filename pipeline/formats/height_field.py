"""The canvas as a height field, ``extract/height.exr`` and ``extract/frame.json``."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from pipeline.errors import ImpastoError
from pipeline.formats.artifact import Artifact
from pipeline.formats.strict_json import parse_model, read_text
from pipeline.geometry.rigid import RigidTransform

MAX_SAMPLES = 1 << 28
"""Most samples of a height field: what an EXR image may hold."""

_FILES = ("extract/height.exr", "extract/frame.json")
_ORTHONORMAL = 1e-6


@dataclass(frozen=True)
class HeightField:
    """Heights above the canvas plane on a regular grid.

    Row 0 is the top of the painting. Sample (row, column) lies at canvas coordinates
    ``x = column * spacing_mm, y = -row * spacing_mm, z = heights_mm[row, column]``: x right,
    y up, z out of the paint, the origin at the centre of sample (0, 0).

    Parameters
    ----------
    heights_mm, sigma_mm
        (rows, columns) float32; NaN outside the canvas and in large holes.
    filled
        (rows, columns) bool: small holes whose height was interpolated.
    spacing_mm
        Distance between neighbouring samples, > 0.
    scan_from_canvas
        Takes canvas coordinates to the scan's frame.
    """

    heights_mm: NDArray[np.float32]
    sigma_mm: NDArray[np.float32]
    filled: NDArray[np.bool_]
    spacing_mm: float
    scan_from_canvas: RigidTransform

    @property
    def canvas_size_mm(self) -> tuple[float, float]:
        """Width and height between the outermost samples' centres."""
        rows, columns = self.heights_mm.shape
        return (columns - 1) * self.spacing_mm, (rows - 1) * self.spacing_mm

    def canvas_points(self) -> NDArray[np.float64]:
        """Return the samples as canvas coordinates, (rows, columns, 3), mm."""
        rows, columns = self.heights_mm.shape
        x, y = np.meshgrid(np.arange(columns) * self.spacing_mm, -np.arange(rows) * self.spacing_mm)
        return np.stack([x, y, self.heights_mm.astype(np.float64)], axis=-1)


_Row = tuple[float, float, float, float]


class _Frame(BaseModel):
    """The document ``extract/frame.json``."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    canvas_to_scan: tuple[_Row, _Row, _Row, _Row]
    spacing_mm: Annotated[float, Field(gt=0)]
    rows: Annotated[int, Field(ge=1)]
    columns: Annotated[int, Field(ge=1)]
    column_direction: tuple[Literal[1], Literal[0], Literal[0]] = (1, 0, 0)
    row_direction: tuple[Literal[0], Literal[-1], Literal[0]] = (0, -1, 0)


def _save(workspace: Path, field: HeightField) -> None:
    from pipeline.formats.exr import write_exr

    image, description = (workspace / file for file in _FILES)
    rows, columns = field.heights_mm.shape
    write_exr(
        image,
        {
            "H": field.heights_mm.astype(np.float32, copy=False),
            "S": field.sigma_mm.astype(np.float32, copy=False),
            "FILLED": field.filled.astype(np.uint32),
        },
    )
    document = {
        "canvas_to_scan": field.scan_from_canvas.matrix.tolist(),
        "spacing_mm": float(field.spacing_mm),
        "rows": rows,
        "columns": columns,
        "column_direction": [1, 0, 0],
        "row_direction": [0, -1, 0],
        "unit": "mm",
    }
    description.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def _load(workspace: Path) -> HeightField:
    from pipeline.formats.exr import read_exr
    from pipeline.formats.exr_header import read_exr_header

    image, description = (workspace / file for file in _FILES)
    frame = parse_model(_Frame, read_text(description, where=_FILES[1]), where=_FILES[1])
    declared = (frame.columns, frame.rows)
    if (found := read_exr_header(image).size_px) != declared:
        raise ImpastoError(
            f"the image is {found[0]} x {found[1]}",
            where=_FILES[0],
            expected=f"{declared[0]} x {declared[1]} as {_FILES[1]} says",
            fix="run the stage again: impasto run ... --from extract --force",
        )
    matrix = np.array(frame.canvas_to_scan)
    rotation = matrix[:3, :3]
    if (
        not np.abs(rotation @ rotation.T - np.eye(3)).max() <= _ORTHONORMAL
        or not np.linalg.det(rotation) > 0
        or matrix[3].tolist() != [0, 0, 0, 1]
    ):
        raise ImpastoError(
            "is not a rigid transform", where=f"{_FILES[1]}: canvas_to_scan", expected="[R t; 0 1]"
        )
    channels = read_exr(image, ("H", "S", "FILLED"))
    return HeightField(
        heights_mm=channels["H"].astype(np.float32, copy=False),
        sigma_mm=channels["S"].astype(np.float32, copy=False),
        filled=channels["FILLED"] != 0,
        spacing_mm=frame.spacing_mm,
        scan_from_canvas=RigidTransform.from_matrix(matrix),
    )


HEIGHT = Artifact(_FILES, _load, _save)
