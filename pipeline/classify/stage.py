"""Stage ``classify``: which relief the plane can stand in for, and boxes for the rest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from pipeline.engine.stage import Log, Stage, reads, writes
from pipeline.formats.boxes import BOXES, Boxes, Relief
from pipeline.formats.height_field import HEIGHT, HeightField


@dataclass(frozen=True)
class Inputs:
    """The canvas."""

    height_field: HeightField = reads(HEIGHT)


@dataclass(frozen=True)
class Outputs:
    """The boxes and what they hold."""

    relief: Relief = writes(BOXES)


class Config(BaseModel):
    """How relief and plane are parted."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    rule: Literal["screen_error", "share", "d0"] = Field(
        default="screen_error",
        description="screen_error: from the tolerated error; share: of the maximum; d0: as given.",
    )
    d0_mm: float = Field(default=0.0, ge=-1e4, le=1e4, description="Threshold of rule d0.")
    share: float = Field(
        default=0.3, gt=0, lt=1, description="Of the maximum height, for rule share; 0.2 to 0.4."
    )
    error_px: float = Field(
        default=2.0, gt=0, le=100, description="Displacement that the plane may show on screen."
    )
    nearest_mm: float = Field(
        default=500.0, gt=0, le=1e6, description="Smallest distance of the eye from the paint."
    )
    picture_height_px: int = Field(default=1080, ge=1, le=65536, description="Rows of the screen.")
    vertical_field_deg: float = Field(
        default=40.0, gt=0, lt=180, description="The picture's vertical field of view."
    )
    angle_deg: float = Field(
        default=60.0, gt=0, lt=90, description="Largest angle of view from the normal."
    )
    cell: int = Field(default=16, ge=1, le=4096, description="Side of a box, in samples.")
    fewest_px: int = Field(
        default=4, ge=1, le=1_000_000, description="Smaller components above d0 are noise."
    )


def run(inputs: Inputs, config: Config, log: Log) -> Outputs:
    """Choose d0, drop specks, cut cells; source: spec of the painting, 1.3."""
    from pipeline.classify.cells import boxes_of, covered, valid_pixels

    heights = inputs.height_field.heights_mm
    known = np.isfinite(heights)
    d0 = _threshold(heights, config)
    valid, specks = valid_pixels(heights, d0, config.fewest_px)
    boxes = boxes_of(heights, valid, d0, config.cell)
    share = float((covered(boxes, heights.shape) & known).sum() / known.sum())
    if not len(boxes):
        log.skipped("boxes", f"the canvas is flat: no relief stands above {d0:.3f} mm")
    elif share > 0.9:
        log.skipped("the bump-mapped plane", f"{share:.0%} of the canvas is relief")
    log.metric("boxes", len(boxes))
    log.metric("d0_mm", d0)
    log.metric("share_in_boxes", share)
    log.metric("specks_dropped", specks)
    return Outputs(Relief(boxes, _statistics(inputs.height_field, boxes, valid, share, config)))


def _threshold(heights: np.ndarray, config: Config) -> float:
    from pipeline.classify import threshold

    if config.rule == "d0":
        return config.d0_mm
    if config.rule == "share":
        return threshold.threshold_by_share(heights, config.share)
    tolerated = threshold.tolerated_depth_mm(
        config.error_px,
        config.nearest_mm,
        config.picture_height_px,
        config.vertical_field_deg,
        config.angle_deg,
    )
    return threshold.threshold_by_error(heights, tolerated)


def _statistics(
    field: HeightField, boxes: Boxes, valid: np.ndarray, share: float, config: Config
) -> dict[str, float | int | str]:
    heights = field.heights_mm[np.isfinite(field.heights_mm)].astype(np.float64)
    percentiles = {
        f"height_percentile_{p:g}_mm": float(np.percentile(heights, p))
        for p in (0.5, 1, 5, 25, 50, 75, 95, 99, 99.5)
    }
    return {
        "d0_mm": boxes.d0_mm,
        "top_mm": boxes.top_mm,
        "cell": boxes.cell,
        "rule": config.rule,
        "boxes": len(boxes),
        "canvas_pixels": len(heights),
        "valid_pixels": int(np.count_nonzero(valid)),
        "share_in_boxes": share,
        "height_mean_mm": float(heights.mean()),
        "height_rms_mm": float(np.sqrt(np.mean((heights - heights.mean()) ** 2))),
        "height_min_mm": float(heights.min()),
        "height_max_mm": float(heights.max()),
        **percentiles,
    }


STAGE = Stage("classify", version=1, inputs=Inputs, outputs=Outputs, config=Config, run=run)
