"""Stage ``extract``: the canvas, cut from its surroundings, as a height field."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from pipeline.engine.stage import Log, Stage, reads, writes
from pipeline.errors import ImpastoError
from pipeline.formats.calibration import CALIBRATION, Calibration
from pipeline.formats.height_field import HEIGHT, MAX_SAMPLES, HeightField
from pipeline.formats.range_image import RANGE, RangeImage
from pipeline.geometry.rigid import RigidTransform


@dataclass(frozen=True)
class Inputs:
    """The scan and who took it."""

    range_image: RangeImage = reads(RANGE)
    calibration: Calibration = reads(CALIBRATION)


@dataclass(frozen=True)
class Outputs:
    """The canvas."""

    height_field: HeightField = writes(HEIGHT)


class Config(BaseModel):
    """How the canvas is found and sampled."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    spacing_mm: float | None = Field(
        default=None,
        gt=0,
        le=1000,
        description="Distance of the samples; left out: the median distance of the scan's points.",
    )
    kernel_samples: float = Field(
        default=0.75,
        ge=0.5,
        le=5,
        description="Width (standard deviation) of the resampling kernel, in sample distances.",
    )
    erosion_px: int = Field(
        default=2,
        ge=0,
        le=50,
        description="Rim, in scan pixels, left out where it does not agree with what lies inside.",
    )
    fill_mm: float = Field(
        default=3.0, ge=0, le=1000, description="Holes narrower than this are filled and marked."
    )
    form_mm: float = Field(
        default=1.0,
        ge=0.05,
        le=1000,
        description="A bulge or twist of the canvas that spans more is taken out of the heights.",
    )
    straighten: bool = Field(
        default=True, description="Turn a rectangular canvas so that its edges are rows, columns."
    )


def run(inputs: Inputs, config: Config, log: Log) -> Outputs:
    """Find the canvas, straighten it and sample it; source: spec of the painting, 1.2."""
    from pipeline.extract.canvas import find_canvas, ray_factor
    from pipeline.extract.holes import fill_holes, small_holes
    from pipeline.extract.resample import grid_around, resample
    from pipeline.extract.roughness import unresolved_variance

    camera = inputs.calibration.camera(inputs.calibration.scan_camera)
    points, sigma = inputs.range_image.points_mm, inputs.range_image.sigma_mm
    found = find_canvas(points, sigma, camera, config.erosion_px, straighten=config.straighten)
    distance = found.region.sampling.distance_mm
    spacing = config.spacing_mm or distance
    grid = grid_around(found.points[:, :2], spacing)
    if grid.rows * grid.columns > MAX_SAMPLES:
        raise ImpastoError(
            f"{grid.columns} x {grid.rows} samples of {spacing:.4g} mm",
            where="extract.spacing_mm",
            expected=f"at most {MAX_SAMPLES} samples",
            fix="set a larger extract.spacing_mm",
        )
    kernel = config.kernel_samples * max(distance, spacing)
    heights, deviation = resample(
        found.points,
        sigma[found.region.mask],
        grid,
        kernel,
        progress=lambda done, total: log.progress(done, total, "rows"),
    )
    origin = RigidTransform(np.eye(3), np.array([grid.left_mm, grid.top_mm, 0.0]))
    field = HeightField(
        heights, deviation, np.zeros(heights.shape, bool), spacing, found.scene_from_canvas @ origin
    )
    eye = field.scan_from_canvas.inverse().apply(camera.centre_mm)
    factor = ray_factor(heights, spacing, field.canvas_points(), eye)
    deviation = (deviation * factor).astype(np.float32)
    deviation = np.sqrt(deviation**2 + unresolved_variance(heights, deviation))
    holes, left = small_holes(np.isfinite(heights), config.fill_mm / spacing)
    heights, deviation = fill_holes(heights, deviation, holes)
    field = trim(replace(field, heights_mm=heights, sigma_mm=deviation, filled=holes))
    field = without_form(field, config.form_mm, log)
    _report(field, found.skew_deg, config.straighten, left, log)
    log.metric("steepest_slope", found.region.slope)
    log.metric("scan_pixels", len(found.points))
    return Outputs(field)


def without_form(field: HeightField, least_mm: float, log: Log) -> HeightField:
    """Take the canvas's bulge and twist out of the heights, if it has any to speak of."""
    from pipeline.extract.form import find_form

    found = find_form(field.heights_mm, field.spacing_mm, least_mm)
    if isinstance(found, str):
        log.skipped("the removal of the canvas's form", found)
        return field
    log.metric("form_mm", found.form.range_mm)
    log.metric("form_degree", found.form.degree)
    log.metric("form_sigma_mm", found.sigma_mm)
    heights = field.heights_mm - found.heights_mm
    return replace(field, heights_mm=heights, form_mm=found.heights_mm, form=found.form)


def trim(field: HeightField) -> HeightField:
    """Cut off outer rows and columns without any sample; the canvas keeps its place in the scene.

    Parameters
    ----------
    field
        With at least one sample.
    """
    known = np.isfinite(field.heights_mm)
    rows, columns = np.flatnonzero(known.any(axis=1)), np.flatnonzero(known.any(axis=0))
    part = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    corner = np.array([columns[0], -rows[0], 0.0]) * field.spacing_mm
    return HeightField(
        field.heights_mm[part].copy(),
        field.sigma_mm[part].copy(),
        field.filled[part].copy(),
        field.spacing_mm,
        field.scan_from_canvas @ RigidTransform(np.eye(3), corner),
    )


def _report(
    field: HeightField, skew_deg: float | None, straighten: bool, left: int, log: Log
) -> None:
    known = np.isfinite(field.heights_mm)
    width, height = field.canvas_size_mm
    low, high = np.percentile(field.heights_mm[known], (0.5, 99.5))
    log.metric("canvas_mm", f"{width:.1f} x {height:.1f}")
    log.metric("spacing_mm", field.spacing_mm)
    log.metric("relief_mm", float(high - low))
    log.metric("median_sigma_mm", float(np.median(field.sigma_mm[known])))
    log.metric("share_covered", float(known.mean()))
    log.metric("share_filled", float(field.filled.sum() / known.sum()))
    log.metric("holes_left", left)
    if skew_deg is not None:
        log.metric("skew_deg", skew_deg)
    if skew_deg is None or not straighten:
        why = "it is switched off" if skew_deg is not None else "the canvas is not rectangular"
        log.skipped("straightening", why)
    if left:
        log.warning(f"{left} holes are wider than extract.fill_mm and stay open")


STAGE = Stage("extract", version=2, inputs=Inputs, outputs=Outputs, config=Config, run=run)
