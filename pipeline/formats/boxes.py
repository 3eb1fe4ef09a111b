"""The boxes that hold the relief above the bump-mapped plane, ``classify/boxes.npz``."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import ImpastoError
from pipeline.formats.artifact import Artifact
from pipeline.formats.npz import read_npz, write_npz
from pipeline.formats.strict_json import parse_object, read_text


@dataclass(frozen=True)
class Boxes:
    """Cells of the height field with relief above ``d0_mm`` (spec of the hybrid renderer).

    Positions and sizes are in samples of the height field: a box covers the patches from sample
    ``position`` to sample ``position + size`` (both ends included), as (column, row).

    Parameters
    ----------
    d0_mm, top_mm
        Bottom and top shared by all boxes: the threshold, and the field's maximum.
    cell
        Side of a cell, samples.
    position, size
        (N, 2) int32 column, row.
    highest_mm
        (N,) float32 height of the box's highest sample.
    highest_at
        (N, 2) int32 column, row of that sample.
    """

    d0_mm: float
    top_mm: float
    cell: int
    position: NDArray[np.int32]
    size: NDArray[np.int32]
    highest_mm: NDArray[np.float32]
    highest_at: NDArray[np.int32]

    def __len__(self) -> int:
        """Count the boxes."""
        return len(self.position)


@dataclass(frozen=True)
class Relief:
    """What classification found (``classify/boxes.npz`` and ``classify/relief.json``).

    Parameters
    ----------
    boxes
        The boxes; none if the canvas is flat.
    statistics
        ``d0_mm``, ``top_mm``, ``cell``, ``boxes``, ``valid_pixels``, ``share_in_boxes`` (of the
        canvas), ``rule`` (how d0 was chosen), and percentiles of the heights.
    """

    boxes: Boxes
    statistics: dict[str, float | int | str]


_MOST_BOXES = 1 << 26
_LAYOUT: dict[str, tuple[str, tuple[int | None, ...]]] = {
    "d0_mm": ("<f8", ()),
    "top_mm": ("<f8", ()),
    "cell": ("<i4", ()),
    "position": ("<i4", (None, 2)),
    "size": ("<i4", (None, 2)),
    "highest_mm": ("<f4", (None,)),
    "highest_at": ("<i4", (None, 2)),
}


def write_boxes(path: Path, boxes: Boxes) -> None:
    """Write boxes as an uncompressed ``.npz`` of plain arrays, the same bytes every time."""
    write_npz(
        path, {name: np.asarray(getattr(boxes, name), dtype=_LAYOUT[name][0]) for name in _LAYOUT}
    )


def read_boxes(path: Path, grid_shape: tuple[int, int] | None = None) -> Boxes:
    """Read boxes, and check that they lie on the grid.

    Parameters
    ----------
    path
        The file.
    grid_shape
        (rows, columns) of the height field they belong to; not checked if left out.

    Raises
    ------
    ImpastoError
        If the file is damaged, holds anything but plain arrays of the expected types, or a box
        leaves the grid.
    """
    arrays = read_npz(path, _LAYOUT, longest=_MOST_BOXES)
    counts = {len(arrays[name]) for name, (_, shape) in _LAYOUT.items() if shape}
    boxes = Boxes(
        d0_mm=float(arrays["d0_mm"]),
        top_mm=float(arrays["top_mm"]),
        cell=int(arrays["cell"]),
        position=arrays["position"].astype(np.int32, copy=False),
        size=arrays["size"].astype(np.int32, copy=False),
        highest_mm=arrays["highest_mm"].astype(np.float32, copy=False),
        highest_at=arrays["highest_at"].astype(np.int32, copy=False),
    )
    finite = np.isfinite([boxes.d0_mm, boxes.top_mm]).all() and np.isfinite(boxes.highest_mm).all()
    if len(counts) != 1 or not finite or boxes.cell < 1 or not _inside(boxes, grid_shape):
        raise ImpastoError(
            "the boxes contradict themselves or the height field",
            where=str(path),
            expected="finite heights, and boxes of one or more patches inside the grid",
            fix="make it again: impasto run ... --from classify --force",
        )
    return boxes


def _inside(boxes: Boxes, grid_shape: tuple[int, int] | None) -> bool:
    position, size = boxes.position.astype(np.int64), boxes.size.astype(np.int64)
    high = position + size
    at = boxes.highest_at
    last = np.array([np.iinfo(np.int32).max] * 2 if grid_shape is None else grid_shape[::-1]) - 1
    return bool(
        (position >= 0).all()
        and (size >= 1).all()
        and (high <= last).all()
        and (at >= position).all()
        and (at <= high).all()
    )


_FILES = ("classify/boxes.npz", "classify/relief.json")


def _save(workspace: Path, relief: Relief) -> None:
    write_boxes(workspace / _FILES[0], relief.boxes)
    text = json.dumps(relief.statistics, indent=1) + "\n"
    (workspace / _FILES[1]).write_text(text, encoding="utf-8")


def _load(workspace: Path) -> Relief:
    text = read_text(workspace / _FILES[1], where=_FILES[1])
    return Relief(read_boxes(workspace / _FILES[0]), parse_object(text, where=_FILES[1]))


BOXES = Artifact(_FILES, _load, _save)
