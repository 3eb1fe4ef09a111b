"""Stage ``scan``: the scan sequence becomes one measured point per camera pixel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from pipeline.engine.stage import Log, NoWork, Stage, reads, reads_bundle, writes
from pipeline.errors import ImpastoError
from pipeline.formats.bundle import Bundle
from pipeline.formats.calibration import CALIBRATION, Calibration
from pipeline.formats.range_image import RANGE, TEXTURE, RangeImage, Texture


@dataclass(frozen=True)
class Inputs:
    """The scan's frames and the rig."""

    bundle: Bundle = reads_bundle("scan")
    calibration: Calibration = reads(CALIBRATION)


@dataclass(frozen=True)
class Outputs:
    """Points, and the light they were seen in."""

    range_image: RangeImage = writes(RANGE)
    texture: Texture = writes(TEXTURE)


class Config(BaseModel):
    """How points are accepted."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    epipolar_tolerance: float = Field(
        default=6.0,
        gt=0,
        description="Largest residual across the epipolar line, in its own robust deviations.",
    )
    correct_albedo_edges: bool = Field(
        default=True, description="Correct the shift that albedo edges inside a pixel cause."
    )


def run(inputs: Inputs, config: Config, log: Log) -> Outputs:
    """Decode, triangulate, correct albedo edges, drop what contradicts itself."""
    from pipeline.scan.points import measure
    from pipeline.structured_light.decode import decode_sequence

    sequences = inputs.bundle.sequences("scan")
    if not sequences:
        raise NoWork("the capture has no scan sequence")
    sequence = sequences[0]
    for other in sequences[1:]:
        log.warning(f"the scan {other.name} is ignored: one placement is processed, the first")
    calibration = inputs.calibration
    if calibration.projector is None:
        raise ImpastoError("the projector is not calibrated", where="calibration.json: projector")
    camera = calibration.camera(sequence.camera)
    coordinates = decode_sequence(
        inputs.bundle, sequence, progress=lambda done, total: log.progress(done, total, "frames")
    )
    measured = measure(
        coordinates,
        camera,
        calibration.projector,
        epipolar_tolerance=config.epipolar_tolerance,
        correct_albedo_edges=config.correct_albedo_edges,
    )
    known = np.isfinite(measured.sigma_mm)
    if not known.any():
        raise ImpastoError(
            "no point could be triangulated",
            where=f"capture.json: sequence {sequence.name!r}",
            fix="check that the calibration belongs to this capture",
        )
    log.metric("share_measured", float(known.mean()))
    log.metric("median_sigma_mm", float(np.median(measured.sigma_mm[known])))
    for name, value in (measured.statistics | coordinates.statistics).items():
        log.metric(name, value)
    if coordinates.x is None or coordinates.y is None:
        absent = "x" if coordinates.x is None else "y"
        log.skipped(f"axis {absent} and the epipolar check", "the patterns code one axis only")
    agree = min(
        (v for k, v in coordinates.statistics.items() if k.startswith("share_agree")), default=1.0
    )
    if agree < 0.9:
        log.warning(
            f"phase and Gray code contradict each other on {1 - agree:.0%} of the pixels; check "
            "phase_offset, sign and the order of the frames"
        )
    return Outputs(
        RangeImage(measured.points_mm, measured.sigma_mm),
        Texture(coordinates.radiance, coordinates.radiance_source),
    )


STAGE = Stage("scan", version=1, inputs=Inputs, outputs=Outputs, config=Config, run=run)
