"""Stage ``scan``: each scan sequence becomes one measured point per camera pixel."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from pipeline.engine.stage import Log, NoWork, Stage, reads, reads_bundle, writes
from pipeline.errors import ImpastoError
from pipeline.formats.bundle import Bundle
from pipeline.formats.calibration import CALIBRATION, Calibration
from pipeline.formats.capture import Sequence
from pipeline.formats.placement_scans import MOST_PLACEMENTS, PLACEMENTS, PlacementScan
from pipeline.formats.range_image import RANGE, TEXTURE, RangeImage, Texture

LEAST_AGREEMENT = 0.9
LARGEST_FRAME_SHIFT = 0.3
LARGEST_MOTION_PX = 0.25
MOST_SATURATED = 0.6


@dataclass(frozen=True)
class Inputs:
    """The scan's frames and the rig."""

    bundle: Bundle = reads_bundle("scan")
    calibration: Calibration = reads(CALIBRATION)


@dataclass(frozen=True)
class Outputs:
    """Points, the light they were seen in, and both of further placements."""

    range_image: RangeImage = writes(RANGE)
    texture: Texture = writes(TEXTURE)
    placements: tuple[PlacementScan, ...] = writes(PLACEMENTS)


class Config(BaseModel):
    """How points are accepted."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    epipolar_tolerance: float = Field(
        default=6.0,
        gt=0,
        description="Largest residual across the epipolar line, in its own robust deviations.",
    )
    minimum_modulation: float = Field(
        default=0.3,
        ge=0,
        le=1,
        description="Least contrast of the fringes, as a share of the picture's median.",
    )
    fewest_pixels: int = Field(
        default=25, ge=1, description="Pieces of surface with fewer pixels are dropped."
    )
    maximum_sigma_mm: float | None = Field(
        default=None, gt=0, description="Points with a larger standard deviation are dropped."
    )
    correct_albedo_edges: bool = Field(
        default=True, description="Correct the shift that albedo edges inside a pixel cause."
    )


def run(inputs: Inputs, config: Config, log: Log) -> Outputs:
    """Decode, triangulate, correct albedo edges, drop what contradicts itself; every placement."""
    sequences = inputs.bundle.sequences("scan")
    if not sequences:
        raise NoWork("the capture has no scan sequence")
    if inputs.calibration.projector is None:
        raise ImpastoError("the projector is not calibrated", where="calibration.json: projector")
    range_image, texture = _measure(inputs, sequences[0], config, log)
    if not np.isfinite(range_image.sigma_mm).any():
        raise ImpastoError(
            "no point could be triangulated",
            where=f"capture.json: sequence {sequences[0].name!r}",
            fix="check that the calibration belongs to this capture",
        )
    return Outputs(range_image, texture, _others(inputs, sequences, config, log))


def _others(
    inputs: Inputs, sequences: tuple[Sequence, ...], config: Config, log: Log
) -> tuple[PlacementScan, ...]:
    """Scan the placements after the first."""
    if len(sequences) > MOST_PLACEMENTS + 1:
        raise ImpastoError(
            f"{len(sequences)} scan sequences",
            where="capture.json: sequences",
            expected=f"at most {MOST_PLACEMENTS + 1} placements of one canvas",
        )
    scans = []
    for number, sequence in enumerate(sequences[1:], start=2):
        if sequence.camera != sequences[0].camera:
            log.warning(f"the scan {sequence.name} is left out: it is by camera {sequence.camera}")
            continue
        range_image, texture = _measure(inputs, sequence, config, _Numbered(log, number, sequence))
        if not np.isfinite(range_image.sigma_mm).any():
            log.warning(f"the scan {sequence.name} is left out: no point could be triangulated")
            continue
        scans.append(PlacementScan(sequence.name, range_image, texture))
    if len(sequences) > 1:
        log.metric("placements", 1 + len(scans))
    return tuple(scans)


@dataclass(frozen=True)
class _Numbered:
    """A log in which every figure and warning tells its placement."""

    log: Log
    number: int
    sequence: Sequence

    def progress(self, done: float, total: float, what: str = "") -> None:
        self.log.progress(done, total, f"{what} of placement {self.number}")

    def metric(self, name: str, value: float | int | str) -> None:
        self.log.metric(f"placement_{self.number}_{name}", value)

    def warning(self, text: str) -> None:
        self.log.warning(f"{self.sequence.name}: {text}")

    def skipped(self, what: str, why: str) -> None:
        self.log.skipped(f"{self.sequence.name}: {what}", why)


def _measure(
    inputs: Inputs, sequence: Sequence, config: Config, log: Log
) -> tuple[RangeImage, Texture]:
    """Scan one placement; nothing is known anywhere if no point could be triangulated."""
    from pipeline.scan.points import measure
    from pipeline.structured_light.decode import decode_sequence

    assert inputs.calibration.projector is not None
    camera = inputs.calibration.camera(sequence.camera)
    coordinates = decode_sequence(
        inputs.bundle,
        sequence,
        minimum_modulation=config.minimum_modulation,
        progress=lambda done, total: log.progress(done, total, "frames"),
    )
    measured = measure(
        coordinates,
        camera,
        inputs.calibration.projector,
        epipolar_tolerance=config.epipolar_tolerance,
        correct_albedo_edges=config.correct_albedo_edges,
        fewest_pixels=config.fewest_pixels,
    )
    points, sigma = measured.points_mm, measured.sigma_mm
    if config.maximum_sigma_mm is not None:
        unsure = sigma > config.maximum_sigma_mm
        points[unsure], sigma[unsure] = np.nan, np.nan
    known = np.isfinite(sigma)
    if known.any():
        log.metric("share_measured", float(known.mean()))
        log.metric("median_sigma_mm", float(np.median(sigma[known])))
        for name, value in (measured.statistics | coordinates.statistics).items():
            log.metric(name, value)
        _report(coordinates.statistics, measured.statistics, log)
    return (
        RangeImage(points, sigma),
        Texture(coordinates.radiance, coordinates.radiance_source),
    )


def _report(decoded: dict[str, float], measured: dict[str, float], log: Log) -> None:
    """Say what was doubtful and what was left out."""
    axes = [
        axis for axis in "xy" if f"jumps_repaired_{axis}" in decoded or f"bits_{axis}" in decoded
    ]
    if "epipolar_rms_px" not in measured:
        log.skipped("the epipolar check", f"the patterns code one axis only, {''.join(axes)}")
    for axis in axes:
        if decoded.get(f"redundant_steps_{axis}") == 0:
            log.skipped(
                f"the brightness of single frames along {axis}",
                "three steps leave nothing to spare",
            )
        agree = decoded.get(f"share_agree_{axis}", 1.0)
        if agree < LEAST_AGREEMENT:
            log.warning(
                f"the patterns along {axis} contradict each other on {1 - agree:.0%} of the "
                "pixels; check phase_offset, sign, period_px and the order of the frames"
            )
        shift = decoded.get(f"frame_shift_rad_{axis}", 0.0)
        if shift > LARGEST_FRAME_SHIFT:
            log.warning(
                f"a fringe along {axis} is {math.degrees(shift):.0f} degrees from where "
                "capture.json puts it; check the order of the frames"
            )
        moved = decoded.get(f"motion_px_{axis}", 0.0)
        if moved > LARGEST_MOTION_PX:
            log.warning(
                f"the picture moved by {moved:.1f} px before or during the fringes along {axis}: "
                "something was touched; record the sequence again"
            )
        saturated = decoded.get(f"share_steps_saturated_{axis}", 0.0)
        if saturated > MOST_SATURATED:
            log.warning(f"{saturated:.0%} of the fringes along {axis} are saturated and not used")


STAGE = Stage("scan", version=3, inputs=Inputs, outputs=Outputs, config=Config, run=run)
