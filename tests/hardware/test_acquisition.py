from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hardware.acquisition import Coding, PhotoPlan, SequencePlan, acquire, coded, meter
from hardware.devices import Frame, Rig
from pipeline.errors import HardwareError, ImpastoError
from pipeline.formats.bundle import open_bundle
from pipeline.formats.bundle_writer import BundleWriter
from pipeline.formats.patterns import Black, Gray, Pattern, Phase, White


class Recorder:
    """All devices in one; keeps what was asked of it, in order."""

    def __init__(self, brightness: float = 20.0, fail_at: int | None = None) -> None:
        self.log: list[tuple[str, Any]] = []
        self.brightness, self.fail_at, self.captures = brightness, fail_at, 0
        self.pattern: Pattern | None = None
        self.lamp = False

    def capture(self, exposure_s: float) -> Frame:
        self.captures += 1
        if self.captures == self.fail_at:
            raise HardwareError("the camera does not answer")
        self.log.append(("capture", exposure_s))
        value = min(1.0, self.brightness * exposure_s)
        return Frame(np.full((3, 4), round(65535 * value), np.uint16), exposure_s)

    def show(self, pattern: Pattern | None) -> None:
        self.pattern = pattern
        self.log.append(("show", pattern))

    def switch(self, on: bool) -> None:
        self.lamp = on
        self.log.append(("switch", on))

    def move_to(self, where: float | str) -> None:
        self.log.append(("move", where))

    def place(self, what: str) -> None:
        self.log.append(("place", what))

    def rig(self) -> Rig:
        return Rig({"C0": self}, self, self, self, self, self)


def silent(_what: str, _done: int, _total: int) -> None:
    pass


def plan(**changes: Any) -> SequencePlan:
    entries = {
        "name": "front",
        "purpose": "scan",
        "camera": "C0",
        "patterns": (White(), Black()),
        "subject": "painting",
    }
    return SequencePlan(**(entries | changes))


def test_a_coding_lists_gray_then_phase() -> None:
    patterns = coded(Coding("y", bits=2, cell_px=4, periods_px=(8.0, 9.0), steps=3))
    assert patterns[:2] == (White(), Black())
    assert patterns[2:4] == tuple(Gray(axis="y", bit=b, bits=2, cell_px=4) for b in (0, 1))
    assert patterns[4:] == tuple(
        Phase(axis="y", period_px=p, step=s, steps=3) for p in (8.0, 9.0) for s in range(3)
    )


def test_inverted_bits_follow_their_own() -> None:
    patterns = coded(Coding("x", bits=2, inverted=True), uniform=False)
    assert [(p.bit, p.inverted) for p in patterns if isinstance(p, Gray)] == [
        (0, False),
        (0, True),
        (1, False),
        (1, True),
    ]


def test_a_sequence_shows_each_pattern_at_each_exposure(tmp_path: Path) -> None:
    devices = Recorder()
    taken = acquire(
        devices.rig(), BundleWriter(tmp_path / "b"), [plan(exposures=(1.0, 3.0))], [], silent
    )
    (entry,) = taken["sequences"]
    assert [f["pattern"]["type"] for f in entry["frames"]] == ["white", "white", "black", "black"]
    short, long = entry["frames"][0]["exposure_s"], entry["frames"][1]["exposure_s"]
    assert long == pytest.approx(3 * short, rel=1e-4)
    assert short * devices.brightness == pytest.approx(0.8, rel=1e-3)
    assert len(list((tmp_path / "b").rglob("*.png"))) == 4
    # The lamp is off and the object in place before the first frame.
    assert devices.log[:3] == [("place", "painting"), ("move", 0.0), ("switch", False)]


def test_what_was_taken_makes_a_valid_bundle(tmp_path: Path) -> None:
    writer = BundleWriter(tmp_path)
    photo = PhotoPlan("C0", "L1", 45.0, "painting")
    taken = acquire(Recorder().rig(), writer, [plan(stored_bits=8)], [photo], silent)
    head = {
        "format": "impasto-capture",
        "version": 1,
        "name": "test",
        "encoding": "linear",
        "cameras": {"C0": {"size_px": [4, 3]}},
        "projector": {"size_px": [8, 8], "camera": "C0"},
        "lights": {"L1": {}},
    }
    writer.close(head | taken)
    bundle = open_bundle(tmp_path)
    assert bundle.read_stored("front/0-000.png").dtype == np.uint8
    assert bundle.read("photos/0000.png") == pytest.approx(0.8, abs=1e-3)
    assert json.loads((tmp_path / "capture.json").read_text())["photos"][0]["light"] == "L1"


def test_a_photograph_is_taken_by_the_lamp_alone(tmp_path: Path) -> None:
    devices = Recorder()
    photo = PhotoPlan("C0", "L1", 45.0, "painting")
    acquire(devices.rig(), BundleWriter(tmp_path), [], [photo], silent)
    before = devices.log[: next(i for i, (what, _) in enumerate(devices.log) if what == "capture")]
    assert ("show", None) in before
    assert ("move", "L1") in before
    assert before[-1] == ("switch", True)


@pytest.mark.parametrize("fail_at", [1, 3, 5])
def test_lamp_and_projector_are_off_after_a_failure(tmp_path: Path, fail_at: int) -> None:
    devices = Recorder(fail_at=fail_at)
    devices.lamp = True
    photo = PhotoPlan("C0", "L1", 0.0, "painting")
    with pytest.raises(HardwareError, match="does not answer"):
        acquire(devices.rig(), BundleWriter(tmp_path), [plan()], [photo], silent)
    assert not devices.lamp
    assert devices.pattern is None
    assert not (tmp_path / "capture.json").exists()


def test_an_image_that_cannot_be_written_ends_the_capture(tmp_path: Path) -> None:
    (tmp_path / "front").symlink_to(tmp_path)
    with pytest.raises(ImpastoError, match="link"):
        acquire(Recorder().rig(), BundleWriter(tmp_path), [plan()], [], silent)


@pytest.mark.parametrize("brightness", [0.02, 1.0, 300.0, 20000.0])
def test_metering_finds_the_exposure_from_any_start(brightness: float) -> None:
    exposure_s = meter(Recorder(brightness), 0.01)
    assert exposure_s * brightness == pytest.approx(0.8, rel=0.05)


@pytest.mark.parametrize("brightness", [0.0, 1e12])
def test_metering_gives_up(brightness: float) -> None:
    devices = Recorder(brightness)
    with pytest.raises(HardwareError, match="no exposure"):
        meter(devices, 0.01)
    assert devices.captures < 20
