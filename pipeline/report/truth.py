"""Errors against a known truth, after a rigid motion that lays the result over it.

A truth folder has ``surface.npz`` (x_mm, y_mm with row 0 the smallest y, height_mm, mask) and
``truth.json`` (rig_from_canvas, cameras), as the simulated rig writes them.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import ImpastoError
from pipeline.formats.height_field import HeightField
from pipeline.geometry.height_grid import sample_bilinear
from pipeline.geometry.rigid import RigidTransform

Array = NDArray[np.float64]

_MOST_POINTS = 60_000
_ITERATIONS = 30
_HUBER_MM = 0.1


@dataclass(frozen=True)
class Surface:
    """A true height field: heights (rows, columns), row 0 the *largest* y, NaN off the canvas."""

    left_mm: float
    top_mm: float
    spacing_mm: tuple[float, float]
    heights_mm: Array

    def sample(self, x_mm: Array, y_mm: Array) -> Array:
        """Return the heights at points; NaN outside."""
        columns = (x_mm - self.left_mm) / self.spacing_mm[0]
        rows = (self.top_mm - y_mm) / self.spacing_mm[1]
        return np.asarray(sample_bilinear(self.heights_mm, columns, rows), dtype=np.float64)


@dataclass(frozen=True)
class TruthErrors:
    """Height errors, measured minus true, mm, over the true canvas.

    Parameters
    ----------
    error_mm
        (rows, columns) on the truth's grid, row 0 at the top; NaN where not measured or off it.
    covered
        Share of the true canvas that was measured.
    motion
        The rigid motion that remained between the result and the truth.
    """

    error_mm: NDArray[np.float32]
    spacing_mm: float
    covered: float
    bias_mm: float
    median_mm: float
    rms_mm: float
    percentile_95_mm: float
    percentile_99_mm: float
    normalised_rms: float
    motion: RigidTransform

    def rows(self) -> list[tuple[str, float, str]]:
        """Return the figures as (what, value, unit) for a table."""
        angle = np.degrees(np.arccos(np.clip((np.trace(self.motion.rotation) - 1) / 2, -1, 1)))
        return [
            ("canvas covered", self.covered * 100, "%"),
            ("height error, median", self.median_mm * 1000, "µm"),
            ("height error, RMS", self.rms_mm * 1000, "µm"),
            ("height error, 95th percentile", self.percentile_95_mm * 1000, "µm"),
            ("height error, 99th percentile", self.percentile_99_mm * 1000, "µm"),
            ("bias", self.bias_mm * 1000, "µm"),
            ("error over its stated deviation, RMS", self.normalised_rms, ""),
            ("rotation taken out", float(angle), "°"),
            ("shift taken out", float(np.linalg.norm(self.motion.translation_mm)), "mm"),
        ]


def errors_against_truth(field: HeightField, folder: Path) -> TruthErrors:
    """Compare a height field with the truth in ``folder``.

    Raises
    ------
    ImpastoError
        A file of the truth is missing or is not what it should be, or the two do not overlap.
    """
    surface = read_surface(folder / "surface.npz")
    starts = _starting_motions(folder / "truth.json", field)
    points = field.canvas_points()[np.isfinite(field.heights_mm)]
    points = points[:: max(1, len(points) // _MOST_POINTS)]
    motion = min(starts, key=lambda start: _misfit(surface, start.apply(points)))
    start = motion
    if not np.isfinite(_misfit(surface, motion.apply(points))):
        raise ImpastoError("the result does not lie over the truth", where=str(folder))
    for _ in range(_ITERATIONS):
        step = _step(surface, motion.apply(points))
        motion = step @ motion
        if np.abs(step.translation_mm).max() < 1e-6:
            break
    return _errors(field, surface, motion, motion @ start.inverse())


def read_surface(path: Path) -> Surface:
    """Read ``surface.npz``."""
    try:
        with np.load(path, allow_pickle=False) as file:
            x, y = file["x_mm"].astype(np.float64), file["y_mm"].astype(np.float64)
            heights, mask = file["height_mm"].astype(np.float64), file["mask"].astype(bool)
    except (OSError, ValueError, KeyError) as error:
        raise ImpastoError(
            f"it cannot be read ({error})",
            where=str(path),
            expected="x_mm, y_mm, height_mm and mask",
        ) from error
    if heights.shape != (len(y), len(x)) or mask.shape != heights.shape or min(heights.shape) < 2:
        raise ImpastoError(
            f"sizes {heights.shape}, {mask.shape} do not fit {len(y)} x {len(x)}", where=str(path)
        )
    upright = np.where(mask, heights, np.nan)[::-1]
    return Surface(x[0], y[-1], (x[1] - x[0], y[1] - y[0]), upright)


def _starting_motions(path: Path, field: HeightField) -> list[RigidTransform]:
    """Return the motions that would be right if the scan's frame were the rig's, or a camera's."""
    try:
        document: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        canvas_from_rig = RigidTransform.from_matrix(
            np.array(document["rig_from_canvas"])
        ).inverse()
        cameras = [
            RigidTransform(np.array(entry["R"], float), np.array(entry["t_mm"], float))
            for entry in document["cameras"].values()
        ]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ImpastoError(f"it cannot be read ({error})", where=str(path)) from error
    frames = [RigidTransform(), *(camera.inverse() for camera in cameras)]
    return [canvas_from_rig @ frame @ field.scan_from_canvas for frame in frames]


def _misfit(surface: Surface, points: Array) -> float:
    difference = points[:, 2] - surface.sample(points[:, 0], points[:, 1])
    known = np.isfinite(difference)
    if known.mean() < 0.3:
        return float("inf")
    return float(np.median(np.abs(difference[known])))


def _step(surface: Surface, points: Array) -> RigidTransform:
    """Take one Gauss-Newton step of point-to-plane alignment (Chen and Medioni 1992)."""
    reach = surface.spacing_mm[0]
    x, y = points[:, 0], points[:, 1]
    error = points[:, 2] - surface.sample(x, y)
    by_x = (surface.sample(x + reach, y) - surface.sample(x - reach, y)) / (2 * reach)
    by_y = (surface.sample(x, y + reach) - surface.sample(x, y - reach)) / (2 * reach)
    known = np.isfinite(error + by_x + by_y)
    error, placed = error[known], points[known]
    normals = np.stack([-by_x[known], -by_y[known], np.ones(len(error))], axis=1)
    design = np.concatenate([np.cross(placed, normals), normals], axis=1)
    weight = 1 / np.maximum(1, np.abs(error) / _HUBER_MM)
    weighted = design * weight[:, None]
    solution = np.linalg.lstsq(weighted.T @ design, -weighted.T @ error, rcond=1e-12)[0]
    turn, shift = solution[:3], solution[3:]
    angle = np.linalg.norm(turn)
    cross = np.array([[0, -turn[2], turn[1]], [turn[2], 0, -turn[0]], [-turn[1], turn[0], 0]])
    rotation = np.eye(3) + np.sinc(angle / np.pi) * cross
    rotation += 0.5 * np.sinc(angle / (2 * np.pi)) ** 2 * cross @ cross
    return RigidTransform(rotation, shift)


def _errors(
    field: HeightField, surface: Surface, motion: RigidTransform, moved: RigidTransform
) -> TruthErrors:
    rows, columns = surface.heights_mm.shape
    x, y = np.meshgrid(
        surface.left_mm + np.arange(columns) * surface.spacing_mm[0],
        surface.top_mm - np.arange(rows) * surface.spacing_mm[1],
    )
    there = motion.inverse().apply(np.stack([x, y, surface.heights_mm], axis=-1))
    across, down = there[..., 0] / field.spacing_mm, -there[..., 1] / field.spacing_mm
    measured = sample_bilinear(field.heights_mm.astype(np.float64), across, down)
    sigma = sample_bilinear(field.sigma_mm.astype(np.float64), across, down)
    error = np.asarray(measured - there[..., 2], dtype=np.float64)
    canvas = np.isfinite(surface.heights_mm)
    known = np.isfinite(error) & canvas
    if not known.any():
        raise ImpastoError("the result covers none of the true canvas")
    values = error[known]
    stated = known & (sigma > 0)
    size = np.abs(values)
    return TruthErrors(
        error_mm=np.where(known, error, np.nan).astype(np.float32),
        spacing_mm=surface.spacing_mm[0],
        covered=float(known.sum() / canvas.sum()),
        bias_mm=float(np.mean(values)),
        median_mm=float(np.median(size)),
        rms_mm=float(np.sqrt(np.mean(values**2))),
        percentile_95_mm=float(np.percentile(size, 95)),
        percentile_99_mm=float(np.percentile(size, 99)),
        normalised_rms=float(np.sqrt(np.mean((error[stated] / sigma[stated]) ** 2)))
        if stated.any()
        else float("nan"),
        motion=moved,
    )
