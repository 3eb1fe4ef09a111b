"""The errors of a result against a capture's known truth, after a rigid motion alone.

A truth folder holds ``surface.npz`` (x_mm, y_mm, height_mm, mask in the canvas frame, row 0 at the
smallest y), ``truth.json`` (``rig_from_canvas`` and the cameras' poses) and, optionally,
``brdf.npz`` (rho_d on the same grid). Nothing in a bundle points there.
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import ImpastoError
from pipeline.formats.height_field import HeightField
from pipeline.formats.reflectance_maps import ReflectanceMaps
from pipeline.geometry.rigid import RigidTransform
from pipeline.report.alignment import TrueSurface, align, sample

Array = NDArray[np.float64]
Row = tuple[str, float, str]

_NEAR_MM = 25.0
"""Points of the right frame lie within this distance of the canvas plane."""

_MOST_POINTS = 60_000
"""Points used to align; more add nothing to six parameters."""


@dataclass(frozen=True)
class DiffuseErrors:
    """How well rho_d was found, over all channels.

    Parameters
    ----------
    scale
        Median of fitted over true: 1 if the radiometry is right; any value if only relative.
    median, p95
        Of the size of fitted / (scale x true) - 1.
    absolute
        The maps claim to be in 1/sr.
    """

    scale: float
    median: float
    p95: float
    absolute: bool


@dataclass(frozen=True)
class TruthErrors:
    """Height errors (measured minus true) after rigid alignment, and the alignment's size.

    Parameters
    ----------
    error_mm
        (rows, columns) float32 on the truth's grid, row 0 at the top; NaN where not compared.
    spacing_mm
        Of that grid.
    coverage
        Share of the true canvas that was measured.
    bias_mm, median_mm, rms_mm, p95_mm, p99_mm
        Mean; median and percentiles of the absolute error; root of the mean square.
    normalised_rms
        RMS of the error over its stated standard deviation, 1 if that is honest; NaN if none is.
    rotation_deg, translation_mm
        How far the alignment moved the canvas from where the capture's own frame puts it: 0 if
        calibration is perfect. The translation is that of the canvas's centre.
    diffuse
        Errors of the diffuse albedo, if maps were given and the truth has them.
    """

    error_mm: NDArray[np.float32]
    spacing_mm: float
    coverage: float
    bias_mm: float
    median_mm: float
    rms_mm: float
    p95_mm: float
    p99_mm: float
    normalised_rms: float
    rotation_deg: float
    translation_mm: float
    diffuse: DiffuseErrors | None = None

    def rows(self) -> list[Row]:
        """Return (what, value, unit) of each figure, for tables."""
        rows: list[Row] = [
            ("canvas measured", 100 * self.coverage, "%"),
            ("height error, median", 1000 * self.median_mm, "µm"),
            ("height error, RMS", 1000 * self.rms_mm, "µm"),
            ("height error, 95th percentile", 1000 * self.p95_mm, "µm"),
            ("height error, 99th percentile", 1000 * self.p99_mm, "µm"),
            ("height error, mean", 1000 * self.bias_mm, "µm"),
            ("height error over its stated deviation, RMS", self.normalised_rms, ""),
            ("rotation taken out", self.rotation_deg, "°"),
            ("shift taken out", self.translation_mm, "mm"),
        ]
        if self.diffuse is not None:
            unit = "x true" if self.diffuse.absolute else "x true (relative reflectance)"
            rows += [
                ("diffuse albedo, scale", self.diffuse.scale, unit),
                ("diffuse albedo error, median", 100 * self.diffuse.median, "%"),
                ("diffuse albedo error, 95th percentile", 100 * self.diffuse.p95, "%"),
            ]
        return rows


def errors_against_truth(
    height_field: HeightField, truth_folder: Path, *, maps: ReflectanceMaps | None = None
) -> TruthErrors:
    """Align a height field rigidly with the true surface and measure what differs.

    Parameters
    ----------
    height_field
        The result of ``extract``, in the rig's frame or in that of a camera of the truth.
    truth_folder
        As the module says.
    maps
        The result of ``fit`` on the height field's grid.

    Raises
    ------
    ImpastoError
        If the truth is absent or malformed, or the height field does not lie where it says.
    """
    surface, document = _load_surface(truth_folder), _load_document(truth_folder)
    points = height_field.scan_from_canvas.apply(height_field.canvas_points())
    points = points[np.isfinite(height_field.heights_mm)]
    start = _starting_motion(points, surface, document, truth_folder)
    try:
        found = align(points[:: max(1, len(points) // _MOST_POINTS)], surface, start)
    except ValueError as problem:
        raise ImpastoError(
            f"the height field cannot be laid over the truth ({problem})", where=str(truth_folder)
        ) from problem

    true_points = np.stack([*np.meshgrid(surface.x_mm, surface.y_mm), surface.heights_mm], axis=-1)
    there = (found @ height_field.scan_from_canvas).inverse().apply(true_points)
    place = -there[..., 1] / height_field.spacing_mm, there[..., 0] / height_field.spacing_mm
    error = sample(height_field.surface_mm.astype(np.float64), *place) - there[..., 2]
    sigma = sample(height_field.sigma_mm.astype(np.float64), *place)
    known, wanted = np.isfinite(error), np.isfinite(surface.heights_mm)
    if not known.any():
        raise ImpastoError("the height field does not overlap the truth", where=str(truth_folder))
    diffuse = None
    if maps is not None and (truth_folder / "brdf.npz").is_file():
        true_diffuse = _load_diffuse(truth_folder, surface)[wanted]
        diffuse = _diffuse_errors(maps, true_diffuse, place[0][wanted], place[1][wanted])
    values, size = error[known], np.abs(error[known])
    stated = known & (sigma > 0)
    residual = found @ start.inverse()
    return TruthErrors(
        error_mm=error[::-1].astype(np.float32),
        spacing_mm=surface.spacing_mm,
        coverage=values.size / int(wanted.sum()),
        bias_mm=float(values.mean()),
        median_mm=float(np.median(size)),
        rms_mm=float(np.sqrt(np.mean(values**2))),
        p95_mm=float(np.percentile(size, 95)),
        p99_mm=float(np.percentile(size, 99)),
        normalised_rms=float(np.sqrt(np.mean((error[stated] / sigma[stated]) ** 2)))
        if stated.any()
        else float("nan"),
        rotation_deg=_angle_deg(residual),
        translation_mm=float(np.linalg.norm(residual.translation_mm)),
        diffuse=diffuse,
    )


def _starting_motion(
    points: Array, surface: TrueSurface, document: dict[str, Any], folder: Path
) -> RigidTransform:
    """Return the motion from the scan's frame, rig or camera, to the truth's canvas."""
    best, motion = 0.0, RigidTransform()
    for candidate in _frames(document, folder):
        moved = candidate.apply(points)
        rows, columns = surface.grid_position(moved)
        inside = (rows >= 0) & (rows <= len(surface.y_mm) - 1)
        inside &= (columns >= 0) & (columns <= len(surface.x_mm) - 1)
        inside &= np.abs(moved[:, 2]) < _NEAR_MM
        share = float(inside.mean()) if len(points) else 0.0
        if share > best:
            best, motion = share, candidate
    if best < 0.5:
        raise ImpastoError(
            f"at most {best:.0%} of the height field lies where the truth has its canvas",
            where=str(folder),
            expected="the truth of this capture",
        )
    return motion


def _frames(document: dict[str, Any], folder: Path) -> Iterator[RigidTransform]:
    """Yield canvas from rig, then canvas from each camera."""
    try:
        canvas_from_rig = RigidTransform.from_matrix(document["rig_from_canvas"]).inverse()
        yield canvas_from_rig
        for camera in document["cameras"].values():
            pose = RigidTransform(np.array(camera["R"]), np.array(camera["t_mm"]))
            yield canvas_from_rig @ pose.inverse()
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        raise _malformed(folder / "truth.json", error) from error


def _diffuse_errors(
    maps: ReflectanceMaps, true: Array, rows: Array, columns: Array
) -> DiffuseErrors | None:
    """Compare at (N,) places, where the truth is (N, 3)."""
    fitted = [sample(maps.diffuse[..., i].astype(np.float64), rows, columns) for i in range(3)]
    ratio = np.stack(fitted, axis=-1) / true
    ratio = ratio[np.isfinite(ratio)]
    scale = float(np.median(ratio)) if ratio.size else 0.0
    if scale <= 0:
        return None
    size = np.abs(ratio / scale - 1)
    return DiffuseErrors(
        scale, float(np.median(size)), float(np.percentile(size, 95)), maps.absolute
    )


def _load_surface(folder: Path) -> TrueSurface:
    path = folder / "surface.npz"
    arrays = _load_npz(path, ("x_mm", "y_mm", "height_mm", "mask"))
    x, y = (arrays[name].astype(np.float64) for name in ("x_mm", "y_mm"))
    heights, mask = arrays["height_mm"].astype(np.float64), arrays["mask"].astype(bool)
    if x.ndim != 1 or y.ndim != 1 or min(len(x), len(y)) < 2:
        raise _malformed(path, "x_mm and y_mm are no axes")
    if not heights.shape == mask.shape == (len(y), len(x)):
        raise _malformed(path, f"height_mm has the shape {heights.shape}")
    for axis in (x, y):
        step = np.diff(axis)
        if not (step > 0).all() or np.ptp(step) > 1e-3 * step.mean():
            raise _malformed(path, "x_mm and y_mm are not ascending in equal steps")
    if not mask.any():
        raise _malformed(path, "the mask is empty")
    return TrueSurface(x, y, np.where(mask, heights, np.nan))


def _load_diffuse(folder: Path, surface: TrueSurface) -> Array:
    path = folder / "brdf.npz"
    rho_d = _load_npz(path, ("rho_d",))["rho_d"].astype(np.float64)
    if rho_d.shape != (*surface.heights_mm.shape, 3):
        raise _malformed(path, f"rho_d has the shape {rho_d.shape}")
    return np.where(rho_d > 0, rho_d, np.nan)


def _load_npz(path: Path, names: tuple[str, ...]) -> dict[str, NDArray[Any]]:
    try:
        with np.load(path, allow_pickle=False) as archive:
            return {name: archive[name] for name in names}
    except FileNotFoundError:
        raise ImpastoError(
            "the file does not exist", where=str(path), expected="a folder with a capture's truth"
        ) from None
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise _malformed(path, error) from error


def _load_document(folder: Path) -> dict[str, Any]:
    path = folder / "truth.json"
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise _malformed(path, error) from error
    if not isinstance(document, dict):
        raise _malformed(path, "it is no object")
    return document


def _malformed(path: Path, why: object) -> ImpastoError:
    return ImpastoError(f"the truth cannot be read ({why})", where=str(path))


def _angle_deg(motion: RigidTransform) -> float:
    """Return the angle of a rotation from its skew part and its trace, stable near 0."""
    r = motion.rotation
    skew = np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])
    return float(np.degrees(np.arctan2(np.linalg.norm(skew), np.trace(r) - 1)))
