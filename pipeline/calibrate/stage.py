"""Stage ``calibrate``: what the bundle gives is taken as it is, the rest is found from boards."""

from __future__ import annotations

from dataclasses import dataclass

from pydantic import BaseModel, ConfigDict, Field

from pipeline.engine.stage import Log, Stage, reads_bundle, writes
from pipeline.formats.board_residuals import BOARD_RESIDUALS, BoardResiduals
from pipeline.formats.bundle import Bundle
from pipeline.formats.calibration import CALIBRATION, Calibration


@dataclass(frozen=True)
class Inputs:
    """The boards."""

    bundle: Bundle = reads_bundle("calibrate")


@dataclass(frozen=True)
class Outputs:
    """The rig, and how the boards fit it."""

    calibration: Calibration = writes(CALIBRATION)
    residuals: BoardResiduals = writes(BOARD_RESIDUALS)


class Config(BaseModel):
    """When a view is left out."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    worst_view: float = Field(
        default=4.0, gt=1, description="A view whose RMS exceeds this many medians is left out."
    )


def run(inputs: Inputs, config: Config, log: Log) -> Outputs:
    """Put together what is given and what has to be found; spec of the capture bundle."""
    from pipeline.calibrate.rig import calibrate_rig

    calibration, residuals = calibrate_rig(inputs.bundle, config.worst_view, log)
    for name, fit in calibration.residuals.items():
        if fit.rms_px is not None:
            log.metric(f"reprojection_error_{name}_px", fit.rms_px)
    if calibration.projector is not None:
        import numpy as np

        camera = calibration.camera(calibration.scan_camera)
        baseline = calibration.projector.centre_mm - camera.centre_mm
        log.metric("baseline_mm", float(np.linalg.norm(baseline)))
    return Outputs(calibration, residuals)


STAGE = Stage("calibrate", version=2, inputs=Inputs, outputs=Outputs, config=Config, run=run)
