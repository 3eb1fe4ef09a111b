"""Classification: box size against what is drawn with parallax, and the error of what is not."""

from __future__ import annotations

import numpy as np

from benchmarks.results import Result, Row, timed
from pipeline.classify.cells import boxes_of, covered, valid_pixels
from pipeline.classify.stage import Config
from pipeline.classify.threshold import threshold_by_error, threshold_by_share, tolerated_depth_mm


def measure(*, quick: bool = False) -> Result:
    """Vary the rule and the box; the error is the largest displacement outside the boxes."""
    size = 512 if quick else 2048
    heights = brushwork(size)
    config = Config()
    rows = []
    for cell in (8, 16, 32):
        for error_px in (1.0, 2.0, 4.0):
            tolerated = depth_of(error_px, config)
            name = f"screen error {error_px:g} px, cells of {cell}"
            d0 = threshold_by_error(heights, tolerated)
            rows.append(case(name, heights, d0, cell, config,
                             default=(cell, error_px) == (16, 2.0)))  # fmt: skip
    for share in (0.2, 0.4):
        d0 = threshold_by_share(heights, share)
        rows.append(case(f"{share:.0%} of the maximum (published)", heights, d0, 16, config))
    return Result("classify", f"classification, {size} x {size}", "largest error, px", rows)


def brushwork(size: int) -> np.ndarray:
    """Return strokes on a flat ground, mm."""
    import cv2

    rng = np.random.default_rng(3)
    noise = rng.normal(size=(size, size)).astype(np.float32)
    strokes = cv2.GaussianBlur(noise, (0, 0), sigmaX=14, sigmaY=4)
    weave = 0.02 * cv2.GaussianBlur(noise, (0, 0), 1.0) / 0.28
    return np.asarray(np.maximum(strokes / strokes.std() - 0.8, 0) * 0.6 + weave, dtype=np.float32)


def depth_of(error_px: float, config: Config) -> float:
    """Return the depth that moves a texel by so many px at the stage's nearest view."""
    return tolerated_depth_mm(
        error_px,
        config.nearest_mm,
        config.picture_height_px,
        config.vertical_field_deg,
        config.angle_deg,
    )


def case(  # type: ignore[no-untyped-def]
    name, heights, d0, cell, config, *, default=False
) -> Row:
    """Cut boxes; measure the relief that stays outside them."""

    def run():  # type: ignore[no-untyped-def]
        valid, _ = valid_pixels(heights, d0, config.fewest_px)
        return boxes_of(heights, valid, d0, cell)

    seconds, boxes = timed(run)
    outside = ~covered(boxes, heights.shape)
    low = float(np.nanpercentile(heights, 1.0))
    left = float(np.max(heights[outside], initial=low)) - low
    return Row(
        name,
        seconds,
        left / depth_of(1.0, config),
        default=default,
        figures={"boxes": float(len(boxes)), "% in boxes": 100 * float(1 - outside.mean())},
    )
