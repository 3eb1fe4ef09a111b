"""How every calibration corner fits, ``calibrate/residuals.json``: for reports and for doubters."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from pipeline.errors import ImpastoError
from pipeline.formats.artifact import Artifact
from pipeline.formats.strict_json import parse_model, read_text

Array = NDArray[np.float64]

_FILE = "calibrate/residuals.json"


@dataclass(frozen=True)
class ViewResiduals:
    """The corners of one board in one device.

    Parameters
    ----------
    view, device
        The sequence's name; a camera's name, or ``projector``.
    pixels, residuals
        (N, 2) where the corners were seen, px; predicted minus seen, px.
    distance_mm, tilt_deg
        Of the board's middle from the device's camera; of its normal from the line of sight.
    """

    view: str
    device: str
    pixels: Array
    residuals: Array
    distance_mm: float
    tilt_deg: float


@dataclass(frozen=True)
class Correlation:
    """Correlations of parameters that were found together: names, and their (n, n) matrix."""

    parameters: tuple[str, ...]
    matrix: Array


@dataclass(frozen=True)
class BoardResiduals:
    """All views of all devices that were calibrated, and why others were left out."""

    views: tuple[ViewResiduals, ...] = ()
    correlations: tuple[Correlation, ...] = ()
    left_out: tuple[tuple[str, str], ...] = ()


class _Entry(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class _View(_Entry):
    view: str
    device: str
    pixels: list[tuple[float, float]]
    residuals: list[tuple[float, float]]
    distance_mm: float
    tilt_deg: float


class _Correlation(_Entry):
    parameters: list[str]
    matrix: list[list[float]]


class _Document(_Entry):
    views: list[_View]
    correlations: list[_Correlation]
    left_out: list[tuple[str, str]]


def _save(workspace: Path, residuals: BoardResiduals) -> None:
    document = {
        "views": [
            {
                "view": view.view,
                "device": view.device,
                "pixels": np.round(view.pixels, 4).tolist(),
                "residuals": np.round(view.residuals, 6).tolist(),
                "distance_mm": round(view.distance_mm, 3),
                "tilt_deg": round(view.tilt_deg, 3),
            }
            for view in residuals.views
        ],
        "correlations": [
            {"parameters": list(c.parameters), "matrix": np.round(c.matrix, 5).tolist()}
            for c in residuals.correlations
        ],
        "left_out": [list(pair) for pair in residuals.left_out],
    }
    text = json.dumps(document, allow_nan=False)
    (workspace / _FILE).write_text(text + "\n", encoding="utf-8")


def _load(workspace: Path) -> BoardResiduals:
    document = parse_model(_Document, read_text(workspace / _FILE, where=_FILE), where=_FILE)
    for i, view in enumerate(document.views):
        if len(view.pixels) != len(view.residuals):
            raise ImpastoError(
                f"{len(view.residuals)} residuals of {len(view.pixels)} corners",
                where=f"{_FILE}: views[{i}]",
            )
    for i, found in enumerate(document.correlations):
        count = len(found.parameters)
        if [len(row) for row in found.matrix] != [count] * count:
            raise ImpastoError(
                f"the matrix is not {count} x {count}", where=f"{_FILE}: correlations[{i}]"
            )
    return BoardResiduals(
        tuple(
            ViewResiduals(
                v.view,
                v.device,
                np.array(v.pixels, dtype=np.float64).reshape(-1, 2),
                np.array(v.residuals, dtype=np.float64).reshape(-1, 2),
                v.distance_mm,
                v.tilt_deg,
            )
            for v in document.views
        ),
        tuple(
            Correlation(
                tuple(c.parameters),
                np.array(c.matrix, dtype=np.float64).reshape(len(c.parameters), -1),
            )
            for c in document.correlations
        ),
        tuple(document.left_out),
    )


BOARD_RESIDUALS = Artifact((_FILE,), _load, _save)
