from __future__ import annotations

import re

import cv2
import numpy as np
import pytest
from pydantic import ValidationError

from pipeline.engine.stage import NoWork
from pipeline.errors import ImpastoError
from pipeline.formats.bundle import open_bundle
from pipeline.formats.calibration import Calibration
from pipeline.formats.patterns import Phase
from pipeline.geometry.rigid import RigidTransform
from pipeline.scan.stage import STAGE, Config, Inputs, run


class Log:
    def __init__(self):
        self.metrics, self.warnings, self.left_out, self.done = {}, [], [], []

    def progress(self, done, total, what=""):
        self.done.append((done, total))

    def metric(self, name, value):
        self.metrics[name] = value

    def warning(self, text):
        self.warnings.append(text)

    def skipped(self, what, why):
        self.left_out.append(what)


def calibration(rig, **changes):
    known = {
        "frame": "camera",
        "scan_camera": "C0",
        "lenses": {"C0": rig.camera.lens},
        "poses": {"C0": RigidTransform()},
        "projector": rig.projector,
    }
    return Calibration(**(known | changes))


def test_a_scan_becomes_points_with_figures(rig):
    made, log = rig(), Log()
    out = run(Inputs(made.bundle(made.patterns()), calibration(made)), Config(), log)
    assert np.nanmax(np.abs(out.range_image.points_mm - made.points)) < 1.0
    assert out.texture.source == "white"
    assert out.placements == ()
    assert np.nanmedian(out.texture.radiance) == pytest.approx(0.6, rel=0.01)
    assert list(log.metrics)[:2] == ["share_measured", "median_sigma_mm"]
    assert log.metrics["share_measured"] > 0.95
    assert log.done[-1] == (20, 20)
    assert log.warnings == []
    assert log.left_out == []


def test_the_same_frames_give_the_same_bytes(rig):
    made = rig()
    first, second = (
        run(Inputs(made.bundle(made.patterns()), calibration(made)), Config(), Log())
        for _ in range(2)
    )
    assert first.range_image.points_mm.tobytes() == second.range_image.points_mm.tobytes()
    assert first.range_image.sigma_mm.tobytes() == second.range_image.sigma_mm.tobytes()


def test_what_could_not_be_done_is_said(rig):
    made, log = rig(), Log()
    run(Inputs(made.bundle(made.patterns("x", steps=3)), calibration(made)), Config(), log)
    assert log.left_out == ["the epipolar check", "the brightness of single frames along x"]


def test_frames_in_a_wrong_order_are_warned_of(rig):
    made, log = rig(), Log()
    patterns = made.patterns("x", steps=8)
    bundle = made.bundle(patterns)
    steps = [f"{i}.png" for i, p in enumerate(patterns) if isinstance(p, Phase)]
    bundle.images[steps[2]], bundle.images[steps[3]] = (
        bundle.images[steps[3]],
        bundle.images[steps[2]],
    )
    run(Inputs(bundle, calibration(made)), Config(), log)
    (warning,) = [text for text in log.warnings if "the order of the frames" in text]
    shift = int(re.search(r"is (\d+) degrees from where", warning)[1])
    assert shift == pytest.approx(45, abs=3)


@pytest.mark.parametrize("axes", ["x", "xy"])
def test_an_object_that_was_moved_is_warned_of(rig, axes):
    texture = cv2.GaussianBlur(np.random.default_rng(4).random((90, 120)), (0, 0), 1.2)
    made = rig(albedo=0.2 + 0.7 * (texture - texture.min()) / np.ptp(texture))
    bundle, before, after = made.bundle(made.patterns(axes)), Log(), Log()
    run(Inputs(bundle, calibration(made)), Config(), before)
    assert not [text for text in before.warnings if "moved" in text]
    names = list(bundle.images)
    for name in names[len(names) // 2 :]:
        bundle.images[name] = np.roll(bundle.images[name], 1, axis=1)
    run(Inputs(bundle, calibration(made)), Config(), after)
    assert any("moved by 1." in text for text in after.warnings)


def test_every_placement_is_scanned(rig):
    made, log = rig(), Log()
    bundle = made.bundle(made.patterns("x"))
    first = bundle.sequences("scan")[0]
    second = first.model_copy(update={"name": "second"})
    third = first.model_copy(update={"name": "third", "camera": "C1"})
    bundle.sequences = lambda purpose: (first, second, third)
    out = run(Inputs(bundle, calibration(made)), Config(), log)
    (other,) = out.placements
    assert other.name == "second"
    assert other.range_image.points_mm.tobytes() == out.range_image.points_mm.tobytes()
    assert other.texture.radiance.tobytes() == out.texture.radiance.tobytes()
    assert log.metrics["placements"] == 2
    assert log.metrics["placement_2_share_measured"] == log.metrics["share_measured"]
    assert log.warnings == ["the scan third is left out: it is by camera C1"]
    assert "second: the epipolar check" in log.left_out


def test_unsure_points_are_dropped_on_request(rig):
    made = rig(albedo=np.where(np.arange(120) < 60, 0.02, 0.8))
    config = Config(maximum_sigma_mm=0.2)
    out = run(Inputs(made.bundle(made.patterns("x")), calibration(made)), config, Log())
    known = np.isfinite(out.range_image.sigma_mm)
    assert np.array_equal(known, np.isfinite(out.range_image.points_mm).all(axis=2))
    assert known[:, :55].mean() < 0.1 < 0.9 < known[:, 65:].mean()
    assert np.nanmax(out.range_image.sigma_mm) <= 0.2


def test_without_a_scan_there_is_no_work(rig):
    made = rig()
    bundle = made.bundle(made.patterns())
    bundle.sequences = lambda purpose: ()
    with pytest.raises(NoWork):
        run(Inputs(bundle, calibration(made)), Config(), Log())


def test_without_a_projector(rig):
    made = rig()
    with pytest.raises(ImpastoError, match="projector is not calibrated"):
        run(
            Inputs(made.bundle(made.patterns()), calibration(made, projector=None)), Config(), Log()
        )


def test_settings_have_bounds():
    for bad in ({"epipolar_tolerance": 0}, {"minimum_modulation": 2}, {"unknown": 1}):
        with pytest.raises(ValidationError):
            Config(**bad)
    assert STAGE.output_files == ("scan/placements.npz", "scan/range.exr", "scan/texture.exr")


@pytest.mark.shared_data
def test_the_eye_is_measured(shared_data):
    """The bundle gives the calibration; nothing is known of the truth but that it is smooth."""
    from pipeline.geometry.camera import Camera, Lens

    bundle, log = open_bundle(shared_data("eye")), Log()
    camera, projector = bundle.capture.cameras["C0"], bundle.capture.projector
    lens, other = (
        Lens(entry.size_px, np.array(entry.K), np.array(entry.distortion))
        for entry in (camera, projector)
    )
    known = Calibration(
        frame="camera",
        scan_camera="C0",
        lenses={"C0": lens},
        poses={"C0": RigidTransform()},
        projector=Camera(other, RigidTransform(np.array(projector.R), np.array(projector.t_mm))),
    )
    out = run(Inputs(bundle, known), Config(), log)
    depth = out.range_image.points_mm[..., 2]
    plaque = (depth > 690) & (depth < 780)
    assert np.count_nonzero(plaque) > 200_000
    assert out.texture.source == "fringes"
    # The README's three frames, 3 % off.
    assert log.metrics["frame_brightness_spread_x"] == pytest.approx(0.03, abs=0.01)
    jumps = np.abs(np.diff(depth, axis=1)) > 30
    assert np.count_nonzero(jumps) < 300
