"""The stage as the engine runs it, and the height field against the truth."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from pipeline.errors import ImpastoError
from pipeline.extract.stage import STAGE, Config, Inputs, run
from pipeline.formats.calibration import Calibration
from pipeline.formats.range_image import RangeImage, Texture


class Recorder:
    def __init__(self) -> None:
        self.metrics, self.warnings, self.skips = {}, [], []

    def progress(self, done, total, what="") -> None: ...

    def metric(self, name, value) -> None:
        self.metrics[name] = value

    def warning(self, text) -> None:
        self.warnings.append(text)

    def skipped(self, what, why) -> None:
        self.skips.append((what, why))


def inputs_of(scene) -> Inputs:
    calibration = Calibration(
        frame="rig",
        scan_camera="C0",
        lenses={"C0": scene.camera.lens},
        poses={"C0": scene.camera.pose},
        projector=None,
    )
    image = RangeImage(scene.points.astype(np.float32), scene.sigma)
    return Inputs(image, calibration, Texture(np.ones_like(scene.sigma), "white"), ())


def test_heights_agree_with_the_truth(make_scene, reliefs) -> None:
    scene = make_scene(reliefs["impasto"], tilt_deg=(8, -6), roll_deg=3, noise=0.03)
    log = Recorder()
    field = run(inputs_of(scene), Config(), log).height_field
    known = np.isfinite(field.heights_mm)
    points = field.scan_from_canvas.apply(field.canvas_points()[known])
    truth = scene.scan_from_truth.inverse().apply(points)
    error = truth[:, 2] - scene.relief(truth[:, 0], truth[:, 1])
    smooth = np.abs(scene.relief(truth[:, 0], truth[:, 1])) < 0.31
    assert np.median(np.abs(error)) < 0.02
    assert np.percentile(np.abs(error[smooth]), 99) < 0.15
    normalised = error[smooth] / field.sigma_mm[known][smooth]
    assert 0.8 < np.median(np.abs(normalised)) / 0.6745 < 1.25
    area = len(points) * field.spacing_mm**2
    assert area > 0.98 * 200 * 160
    relative = (scene.scan_from_truth.inverse() @ field.scan_from_canvas).rotation
    assert np.rad2deg(relative[1, 0]) == pytest.approx(0, abs=0.1)  # hangs straight
    assert log.metrics["skew_deg"] > 1
    assert np.array_equal(np.isnan(field.heights_mm), np.isnan(field.sigma_mm))


def test_small_holes_are_filled_and_marked_large_ones_stay(make_scene) -> None:
    scene = make_scene(holes=120, hole_mm=30.0)
    log = Recorder()
    # A wider kernel would reach over the small hole by itself.
    field = run(inputs_of(scene), Config(fill_mm=5.0, widen=False), log).height_field
    assert field.filled.any()
    assert np.isfinite(field.heights_mm[field.filled]).all()
    assert log.metrics["holes_left"] == 1
    assert log.warnings
    untouched = run(inputs_of(scene), Config(fill_mm=0.0), Recorder()).height_field
    assert not untouched.filled.any()


def test_spacing_may_be_given(make_scene) -> None:
    scene = make_scene()
    field = run(inputs_of(scene), Config(spacing_mm=2.0), Recorder()).height_field
    assert field.spacing_mm == 2.0
    assert field.canvas_size_mm == pytest.approx((200, 160), abs=3)
    with pytest.raises(ImpastoError, match="spacing_mm"):
        run(inputs_of(scene), Config(spacing_mm=1e-3), Recorder())


def test_a_bulged_canvas_is_flattened_and_still_lies_where_it_is(make_scene) -> None:
    def bulged(x, y):
        return 5 - 5 * (x / 100) ** 2 - 3 * (y / 80) ** 2 + 0.2 * np.sin(x / 4) * np.sin(y / 4)

    scene = make_scene(bulged, noise=0.02, frame=None, tilt_deg=(5, 4))
    log = Recorder()
    field = run(inputs_of(scene), Config(), log).height_field
    known = np.isfinite(field.heights_mm)
    points = scene.scan_from_truth.inverse().apply(
        field.scan_from_canvas.apply(field.canvas_points()[known])
    )
    error = points[:, 2] - bulged(points[:, 0], points[:, 1])
    assert np.median(np.abs(error)) < 0.01
    ground = field.heights_mm[known] - 0.2 * np.sin(points[:, 0] / 4) * np.sin(points[:, 1] / 4)
    assert np.percentile(np.abs(ground), 95) < 0.05
    assert log.metrics["form_mm"] == pytest.approx(8, abs=0.4)
    assert field.form.degree in (2, 3, 4)  # seen askew, a bulge is not quite a parabola


def test_a_flat_canvas_has_no_form(make_scene, reliefs) -> None:
    for name in ("flat", "deep"):
        log = Recorder()
        field = run(inputs_of(make_scene(reliefs[name])), Config(), log).height_field
        assert field.form_mm is None
        assert "the removal of the canvas's form" in dict(log.skips)


def test_the_same_bytes_again(make_scene, reliefs) -> None:
    scene = make_scene(reliefs["impasto"], holes=50)
    first, second = (run(inputs_of(scene), Config(), Recorder()).height_field for _ in range(2))
    assert first.heights_mm.tobytes() == second.heights_mm.tobytes()
    assert first.sigma_mm.tobytes() == second.sigma_mm.tobytes()


def test_a_round_canvas_is_not_straightened(make_scene) -> None:
    scene = make_scene()
    x, y = scene.truth_points[..., 0], scene.truth_points[..., 1]
    scene.points[np.hypot(x, y) > 75] = np.nan
    log = Recorder()
    field = run(inputs_of(scene), Config(), log).height_field
    assert ("straightening", "the canvas is not rectangular") in log.skips
    assert np.isnan(field.heights_mm[0, 0])


def test_what_it_declares() -> None:
    assert STAGE.output_files == ("extract/frame.json", "extract/height.exr")
    with pytest.raises(ValidationError):
        Config(kernel_samples=0.1)
