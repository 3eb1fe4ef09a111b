"""Stage ``extract``: the canvas, cut from its surroundings, as a height field."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from pipeline.engine.stage import Log, Stage, reads, writes
from pipeline.errors import ImpastoError
from pipeline.formats.calibration import CALIBRATION, Calibration
from pipeline.formats.height_field import HEIGHT, HeightField, Placement
from pipeline.formats.placement_scans import PLACEMENTS, PlacementScan
from pipeline.formats.range_image import RANGE, TEXTURE, RangeImage, Texture
from pipeline.geometry.rigid import RigidTransform


@dataclass(frozen=True)
class Inputs:
    """The scan of each placement and who took it."""

    range_image: RangeImage = reads(RANGE)
    calibration: Calibration = reads(CALIBRATION)
    texture: Texture = reads(TEXTURE)
    placements: tuple[PlacementScan, ...] = reads(PLACEMENTS)


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
    widen: bool = Field(
        default=True,
        description="Widen the kernel, up to twice, where noise hides the finest relief anyway.",
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


@dataclass(frozen=True)
class _Sampled:
    """A height field with all its holes, and what is known of how it came about."""

    field: HeightField
    skew_deg: float | None
    slope: float | None
    pixels: int


def run(inputs: Inputs, config: Config, log: Log) -> Outputs:
    """Find the canvas, straighten it and sample it; source: spec of the painting, 1.2."""
    from pipeline.extract.holes import fill_holes, small_holes
    from pipeline.extract.roughness import unresolved_variance

    sampled = _sample_several(inputs, config, log) if inputs.placements else None
    if sampled is None:
        sampled = _sample(inputs, config, log)
    field = sampled.field
    heights, deviation = field.heights_mm, field.sigma_mm
    deviation = np.sqrt(deviation**2 + unresolved_variance(heights, deviation))
    holes, left = small_holes(np.isfinite(heights), config.fill_mm / field.spacing_mm)
    heights, deviation = fill_holes(heights, deviation, holes)
    field = trim(replace(field, heights_mm=heights, sigma_mm=deviation, filled=holes))
    field = without_form(field, config.form_mm, log)
    _report(field, sampled.skew_deg, config.straighten, left, log)
    if sampled.slope is not None:
        log.metric("steepest_slope", sampled.slope)
    log.metric("scan_pixels", sampled.pixels)
    return Outputs(field)


def _sample(inputs: Inputs, config: Config, log: Log) -> _Sampled:
    """Sample the canvas of one placement, the first."""
    from pipeline.extract.canvas import find_canvas, ray_factor
    from pipeline.extract.kernel import widest_kernel
    from pipeline.extract.resample import check_size, grid_around, resample

    camera = inputs.calibration.camera(inputs.calibration.scan_camera)
    points, sigma = inputs.range_image.points_mm, inputs.range_image.sigma_mm
    found = find_canvas(points, sigma, camera, config.erosion_px, straighten=config.straighten)
    distance = found.region.sampling.distance_mm
    spacing = config.spacing_mm or distance
    grid = grid_around(found.points[:, :2], spacing)
    check_size(grid)
    deviation = sigma[found.region.mask]
    kernel = config.kernel_samples * max(distance, spacing)
    if config.widen:
        narrow, kernel = kernel, widest_kernel(found.points, deviation, grid, kernel)
        if kernel == narrow:
            log.skipped("a wider kernel", "the relief stands above the noise")
    log.metric("kernel_mm", kernel)
    heights, deviation = resample(
        found.points,
        deviation,
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
    field = replace(field, sigma_mm=(deviation * factor).astype(np.float32))
    return _Sampled(field, found.skew_deg, found.region.slope, len(found.points))


def _sample_several(inputs: Inputs, config: Config, log: Log) -> _Sampled | None:
    """Put the placements together; None if none can be joined to the first."""
    from pipeline.extract.merge import merge, registration_rms_mm
    from pipeline.extract.placements import find_together

    calibration = inputs.calibration
    if calibration.projector is None:
        raise ImpastoError("the projector is not calibrated", where="calibration.json: projector")
    camera = calibration.camera(calibration.scan_camera)
    first = PlacementScan("first", inputs.range_image, inputs.texture)
    together = find_together(
        [first, *inputs.placements],
        camera,
        calibration.projector.centre_mm,
        config.erosion_px,
        lambda done, total: log.progress(done, total, "placements found"),
    )
    for name, why in together.left_out.items():
        log.warning(f"the scan {name} is left out: {why}")
    log.metric("placements", len(together.patches))
    if together.registration is None:
        return None
    spacing = config.spacing_mm or together.patches[0].distance_mm
    merged = merge(
        together,
        camera,
        spacing,
        config.kernel_samples,
        straighten=config.straighten,
        widen=config.widen,
        progress=lambda done, total: log.progress(done, total, "placements sampled"),
    )
    log.metric("registration_rms_um", 1000 * registration_rms_mm(together.registration))
    log.metric("share_overlap", merged.share_overlap)
    log.metric("kernel_mm", merged.kernel_mm)
    origin = RigidTransform(np.eye(3), np.array([merged.grid.left_mm, merged.grid.top_mm, 0.0]))
    field = HeightField(
        merged.heights,
        merged.sigma,
        np.zeros(merged.heights.shape, bool),
        spacing,
        merged.scan_from_canvas[0] @ origin,
        placements=tuple(
            Placement(patch.name, pose @ origin)
            for patch, pose in zip(together.patches, merged.scan_from_canvas, strict=True)
        ),
    )
    return _Sampled(field, merged.skew_deg, None, sum(len(p.points) for p in together.patches))


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
        With at least one sample, its form still in its heights.
    """
    known = np.isfinite(field.heights_mm)
    rows, columns = np.flatnonzero(known.any(axis=1)), np.flatnonzero(known.any(axis=0))
    part = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    offset = np.array([columns[0], -rows[0], 0.0]) * field.spacing_mm
    corner = RigidTransform(np.eye(3), offset)
    return HeightField(
        field.heights_mm[part].copy(),
        field.sigma_mm[part].copy(),
        field.filled[part].copy(),
        field.spacing_mm,
        field.scan_from_canvas @ corner,
        placements=tuple(Placement(p.name, p.scan_from_canvas @ corner) for p in field.placements),
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


STAGE = Stage("extract", version=3, inputs=Inputs, outputs=Outputs, config=Config, run=run)
