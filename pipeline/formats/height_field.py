"""The canvas as a height field, ``extract/height.exr`` and ``extract/frame.json``."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from pipeline.errors import ImpastoError
from pipeline.formats.artifact import Artifact
from pipeline.formats.form import Form, FormModel
from pipeline.formats.strict_json import parse_model, read_text
from pipeline.geometry.rigid import RigidTransform

MAX_SAMPLES = 1 << 28
"""Most samples of a height field: what an EXR image may hold."""

_FILES = ("extract/height.exr", "extract/frame.json")
_ORTHONORMAL = 1e-6


@dataclass(frozen=True)
class Placement:
    """One of several positions in which parts of a canvas were scanned.

    Parameters
    ----------
    name
        The scan sequence's.
    scan_from_canvas
        Takes canvas coordinates to the scan's frame, as the canvas lay then.
    """

    name: str
    scan_from_canvas: RigidTransform


@dataclass(frozen=True)
class HeightField:
    """Heights above the canvas plane on a regular grid.

    Row 0 is the top of the painting. Sample (row, column) lies at canvas coordinates
    ``x = column * spacing_mm, y = -row * spacing_mm, z = surface_mm[row, column]``: x right,
    y up, z out of the paint, the origin at the centre of sample (0, 0). The surface is the relief
    ``heights_mm``, and the canvas's own form under it where it has one.

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
    form_mm, form
        Bulge or twist that was taken out of the heights: (rows, columns) float32, NaN where they
        are, and its polynomial; None for a canvas that is flat.
    placements
        Of a canvas that was scanned in parts, the placements that were put together, the first
        included; empty for a canvas scanned at once.
    """

    heights_mm: NDArray[np.float32]
    sigma_mm: NDArray[np.float32]
    filled: NDArray[np.bool_]
    spacing_mm: float
    scan_from_canvas: RigidTransform
    form_mm: NDArray[np.float32] | None = None
    form: Form | None = None
    placements: tuple[Placement, ...] = ()

    @property
    def surface_mm(self) -> NDArray[np.float32]:
        """Heights above the plane, the canvas's form included: where the surface truly is."""
        return self.heights_mm if self.form_mm is None else self.heights_mm + self.form_mm

    @property
    def canvas_size_mm(self) -> tuple[float, float]:
        """Width and height between the outermost samples' centres."""
        rows, columns = self.heights_mm.shape
        return (columns - 1) * self.spacing_mm, (rows - 1) * self.spacing_mm

    def canvas_points(self) -> NDArray[np.float64]:
        """Return the samples as canvas coordinates, (rows, columns, 3), mm."""
        rows, columns = self.heights_mm.shape
        x, y = np.meshgrid(np.arange(columns) * self.spacing_mm, -np.arange(rows) * self.spacing_mm)
        return np.stack([x, y, self.surface_mm.astype(np.float64)], axis=-1)


_Row = tuple[float, float, float, float]


class _PlacementModel(BaseModel):
    """One placement in ``extract/frame.json``."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    name: str
    canvas_to_scan: tuple[_Row, _Row, _Row, _Row]


class _Frame(BaseModel):
    """The document ``extract/frame.json``."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    canvas_to_scan: tuple[_Row, _Row, _Row, _Row]
    spacing_mm: Annotated[float, Field(gt=0)]
    rows: Annotated[int, Field(ge=1)]
    columns: Annotated[int, Field(ge=1)]
    column_direction: tuple[Literal[1], Literal[0], Literal[0]] = (1, 0, 0)
    row_direction: tuple[Literal[0], Literal[-1], Literal[0]] = (0, -1, 0)
    form: FormModel | None = None
    placements: tuple[_PlacementModel, ...] = ()


def _save(workspace: Path, field: HeightField) -> None:
    from pipeline.formats.exr import write_exr

    image, description = (workspace / file for file in _FILES)
    rows, columns = field.heights_mm.shape
    channels: dict[str, NDArray[np.float32] | NDArray[np.uint32]] = {
        "H": field.heights_mm.astype(np.float32, copy=False),
        "S": field.sigma_mm.astype(np.float32, copy=False),
        "FILLED": field.filled.astype(np.uint32),
    }
    if field.form_mm is not None:
        channels["FORM"] = field.form_mm.astype(np.float32, copy=False)
    write_exr(image, channels)
    document: dict[str, Any] = {
        "canvas_to_scan": field.scan_from_canvas.matrix.tolist(),
        "spacing_mm": float(field.spacing_mm),
        "rows": rows,
        "columns": columns,
        "column_direction": [1, 0, 0],
        "row_direction": [0, -1, 0],
        "unit": "mm",
    }
    if field.form is not None:
        document["form"] = asdict(field.form)
    if field.placements:
        document["placements"] = [
            {"name": p.name, "canvas_to_scan": p.scan_from_canvas.matrix.tolist()}
            for p in field.placements
        ]
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
    wanted = ("H", "S", "FILLED") if frame.form is None else ("H", "S", "FILLED", "FORM")
    channels = read_exr(image, wanted)
    form_mm = channels.get("FORM")
    return HeightField(
        heights_mm=channels["H"].astype(np.float32, copy=False),
        sigma_mm=channels["S"].astype(np.float32, copy=False),
        filled=channels["FILLED"] != 0,
        spacing_mm=frame.spacing_mm,
        scan_from_canvas=_rigid(frame.canvas_to_scan, "canvas_to_scan"),
        form_mm=None if form_mm is None else form_mm.astype(np.float32, copy=False),
        form=None if frame.form is None else frame.form.form(),
        placements=tuple(
            Placement(p.name, _rigid(p.canvas_to_scan, f"placements[{i}].canvas_to_scan"))
            for i, p in enumerate(frame.placements)
        ),
    )


def _rigid(rows: tuple[_Row, _Row, _Row, _Row], key: str) -> RigidTransform:
    matrix = np.array(rows)
    rotation = matrix[:3, :3]
    if (
        not np.abs(rotation @ rotation.T - np.eye(3)).max() <= _ORTHONORMAL
        or not np.linalg.det(rotation) > 0
        or matrix[3].tolist() != [0, 0, 0, 1]
    ):
        raise ImpastoError(
            "is not a rigid transform", where=f"{_FILES[1]}: {key}", expected="[R t; 0 1]"
        )
    return RigidTransform.from_matrix(matrix)


HEIGHT = Artifact(_FILES, _load, _save)
