from __future__ import annotations

import numpy as np
import pytest

from pipeline.classify.stage import STAGE, Config, Inputs, run
from pipeline.formats.boxes import BOXES
from pipeline.formats.height_field import HeightField
from pipeline.geometry.rigid import RigidTransform


class Recorder:
    def __init__(self) -> None:
        self.metrics, self.skips = {}, []

    def progress(self, done, total, what="") -> None: ...

    def warning(self, text) -> None: ...

    def metric(self, name, value) -> None:
        self.metrics[name] = value

    def skipped(self, what, why) -> None:
        self.skips.append((what, why))


def field(heights: np.ndarray) -> HeightField:
    h = heights.astype(np.float32)
    return HeightField(h, np.full_like(h, 0.01), np.zeros(h.shape, bool), 0.5, RigidTransform())


def test_a_flat_canvas_gives_no_boxes_and_says_so() -> None:
    log = Recorder()
    heights = np.random.default_rng(0).normal(0, 0.02, (80, 100))
    boxes = run(Inputs(field(heights)), Config(), log).relief.boxes
    assert len(boxes) == 0
    assert log.skips
    assert log.skips[0][0] == "boxes"
    assert "flat" in log.skips[0][1]


def test_strokes_get_boxes(tmp_path) -> None:
    heights = np.zeros((80, 100))
    heights[30:40, 20:60] = 2.0
    heights[70, 90] = 2.0  # a speck
    heights[:, :4] = np.nan
    log = Recorder()
    relief = run(Inputs(field(heights)), Config(cell=10), log).relief
    # Rows 30 to 39 touch the cells from 20 and 30; columns 20 to 59 those from 10 to 50.
    cells = {(c, r) for r in (20, 30) for c in range(10, 60, 10)}
    assert {tuple(p) for p in relief.boxes.position.tolist()} == cells
    assert log.metrics["specks_dropped"] == 1
    assert relief.statistics["valid_pixels"] == 400
    assert relief.statistics["canvas_pixels"] == 80 * 96
    assert relief.statistics["top_mm"] == 2.0
    assert 0 < relief.statistics["share_in_boxes"] < 0.5
    (tmp_path / STAGE.folder).mkdir()
    BOXES.save(tmp_path, relief)
    assert BOXES.load(tmp_path).statistics == relief.statistics


@pytest.mark.parametrize(
    ("config", "d0"),
    [
        (Config(rule="d0", d0_mm=1.25), 1.25),
        (Config(rule="share", share=0.25), 0.5),
        (Config(error_px=1, nearest_mm=1000, picture_height_px=1000, angle_deg=30,
                vertical_field_deg=90), 4.0),
    ],
)  # fmt: skip
def test_rules(config, d0) -> None:
    heights = np.zeros((40, 40))
    heights[10:20, 10:20] = 2.0
    relief = run(Inputs(field(heights)), config, Recorder()).relief
    assert relief.boxes.d0_mm == pytest.approx(d0)
