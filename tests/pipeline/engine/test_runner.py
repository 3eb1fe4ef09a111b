"""Runs of the toy recipe: order, skipping, what makes a stage stale, no work, errors."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import pytest

from pipeline.engine.batch import Job, run_job
from pipeline.engine.display import Quiet
from pipeline.engine.runner import Result, Selection, statuses
from pipeline.engine.workspace import open_workspace
from pipeline.errors import ImpastoError, UsageError

Run = Callable[..., list[Result]]


@pytest.fixture
def run(toy: ModuleType, toy_bundle: Path, tmp_path: Path) -> Run:
    def go(**selection: object) -> list[Result]:
        job = Job(toy_bundle, tmp_path / "out", toy.RECIPE, Selection(**selection))
        return run_job(job, Quiet())

    return go


def whys(results: list[Result]) -> dict[str, str]:
    return {result.stage: result.why for result in results if result.ran}


def states(toy: ModuleType, out: Path) -> dict[str, tuple[str, str]]:
    return {s.stage: (s.state, s.why) for s in statuses(toy.RECIPE, open_workspace(out), {})}


def test_first_run_does_everything_then_nothing(run: Run, toy: ModuleType, tmp_path: Path) -> None:
    assert whys(run()) == dict.fromkeys(
        ("calibrate", "scan", "reflectance", "fit", "pack"), "not run yet"
    )
    asset = json.loads((tmp_path / "out/asset/asset.json").read_text())
    grey = (200 + 50) / 2 / 255
    assert asset["range"] == pytest.approx(3 * grey)
    assert asset["maps"] == pytest.approx(2 * 100 / 255)
    before = {path: path.stat() for path in (tmp_path / "out").glob("[a-z]*/*.json")}
    assert not whys(run())
    assert {path: path.stat() for path in before} == before
    assert set(states(toy, tmp_path / "out").values()) == {("up to date", "")}


def test_manifest_records_what_was_done(run: Run, tmp_path: Path) -> None:
    run()
    manifest = json.loads((tmp_path / "out/calibrate/manifest.json").read_text())
    assert manifest["stage"] == {"name": "calibrate", "version": 1}
    assert manifest["configuration"] == {"factor": 2, "behave": "well", "tags": []}
    assert list(manifest["inputs"]["bundle"]) == [
        "calibrate/0.png", "calibrate/1.png", "capture.json",
    ]  # fmt: skip
    assert manifest["metrics"] == {"rms_px": 0.25, "endless": None}
    assert manifest["warnings"] == ["the boards all lie flat"]
    assert manifest["skipped"] == [{"what": "the projector", "why": "its calibration is given"}]
    assert manifest["software"].keys() >= {"impasto", "python", "numpy"}
    assert manifest["run"]["peak_memory_bytes"] > 10_000_000


@pytest.mark.parametrize(
    ("change", "redone"),
    [
        (
            lambda bundle, out: (bundle / "scan/1.png").write_bytes(
                (bundle / "calibrate/0.png").read_bytes()
            ),
            {"scan": "scan/1.png changed", "pack": "scan/range.json and 1 more changed"},
        ),
        (
            # The same numbers come out of calibrate and scan, so nothing after them is redone.
            lambda bundle, out: (bundle / "capture.json").write_text(
                (bundle / "capture.json").read_text() + " "
            ),
            dict.fromkeys(("calibrate", "scan", "reflectance"), "capture.json changed"),
        ),
        (
            lambda bundle, out: (out / "scan/copy.json").write_text("{}"),
            {"scan": "scan/copy.json was changed after it was made"},
        ),
        (
            lambda bundle, out: (out / "scan/copy.json").unlink(),
            {"scan": "scan/copy.json is missing"},
        ),
        (
            lambda bundle, out: (out / "scan/manifest.json").write_text("{"),
            {"scan": "scan/manifest.json is missing or damaged"},
        ),
        (
            lambda bundle, out: (out / "scan/manifest.json").unlink(),
            {"scan": "scan/manifest.json is missing or damaged"},
        ),
        (lambda bundle, out: shutil.rmtree(out / "scan"), {"scan": "not run yet"}),
        (lambda bundle, out: shutil.rmtree(out / ".engine"), {}),
        (lambda bundle, out: (out / ".engine/hashes.json").write_text("[1]"), {}),
        (lambda bundle, out: os.utime(bundle / "scan/1.png", (1, 1)), {}),
    ],
)
def test_what_makes_a_stage_stale(
    run: Run,
    toy_bundle: Path,
    tmp_path: Path,
    snapshot: Callable[[Path], dict[str, bytes]],
    change: Callable[[Path, Path], object],
    redone: dict[str, str],
) -> None:
    run()
    before = snapshot(tmp_path / "out")
    change(toy_bundle, tmp_path / "out")
    assert whys(run()) == redone
    if "capture.json changed" not in redone.values() and "pack" not in redone:
        assert snapshot(tmp_path / "out") == before
    assert not whys(run())


def test_change_in_place_of_same_size_and_time_is_seen(run: Run, tmp_path: Path) -> None:
    run()
    run()
    path = tmp_path / "out/scan/copy.json"
    times = path.stat()
    content = bytearray(path.read_bytes())
    content[-2] ^= 1
    path.write_bytes(content)
    os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
    assert path.stat().st_size == times.st_size
    assert whys(run()) == {"scan": "scan/copy.json was changed after it was made"}


def test_settings_hold_for_one_run(run: Run, toy: ModuleType, tmp_path: Path) -> None:
    run()
    assert whys(run(settings={"scan": {"threshold": 4}})) == {
        "scan": "configuration: threshold was 3.0, is 4.0",
        "pack": "scan/range.json and 1 more changed",
    }
    found = states(toy, tmp_path / "out")
    assert found["scan"] == ("stale", "configuration: threshold was 4.0, is 3.0")
    assert found["pack"] == ("stale", "scan comes first")
    assert found["fit"] == ("up to date", "")
    assert whys(run())["scan"] == "configuration: threshold was 4.0, is 3.0"


def test_new_version_redoes_the_stage(
    run: Run, toy: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    run()
    monkeypatch.setattr(toy, "SCAN", replace(toy.SCAN, version=2))
    assert whys(run()) == {"scan": "the stage's version was 1, is 2"}


def test_selection(run: Run) -> None:
    assert list(whys(run(last="scan"))) == ["calibrate", "scan"]
    with pytest.raises(ImpastoError, match=r"pack needs .*fit/maps.json.*leave out --from"):
        run(first="pack")
    assert list(whys(run(first="scan"))) == ["reflectance", "fit", "pack"]
    assert whys(run(first="scan", last="fit", force=True)) == dict.fromkeys(
        ("scan", "reflectance", "fit"), "forced"
    )


@pytest.mark.parametrize(
    ("selection", "message"),
    [
        ({"first": "scna"}, "no stage 'scna'.*one of calibrate, scan"),
        ({"first": "fit", "last": "scan"}, "--from fit comes after --to scan"),
        ({"settings": {"scan": {"treshold": 1}}}, "no such key; expected one of threshold"),
        ({"settings": {"fit": {"x": 1}}}, "no configuration"),
        ({"settings": {"calibrate": {"factor": 101}}}, "calibrate.factor:.*less than.*given 101"),
        ({"first": "fit", "settings": {"scan": {"treshold": 1}}}, "no such key"),
    ],
)
def test_wrong_usage_changes_nothing(
    run: Run, tmp_path: Path, selection: dict[str, object], message: str
) -> None:
    with pytest.raises(UsageError, match=message):
        run(**selection)
    assert not (tmp_path / "out").exists()


def test_no_work_is_carried_downstream(toy: ModuleType, tmp_path: Path) -> None:
    bundle, out = toy.write_bundle(tmp_path / "bare", photos=0), tmp_path / "out"
    job = Job(bundle, out, toy.RECIPE, Selection())
    found = {result.stage: result.manifest for result in run_job(job, Quiet())}
    assert found["reflectance"].reason == "the capture has no photographs"
    reason = "reflectance had no work: the capture has no photographs"
    assert (found["fit"].outcome, found["fit"].reason) == ("no work", reason)
    assert found["fit"].inputs == {"samples": {"no work": reason}}
    assert found["pack"].outcome == "done"
    assert json.loads((out / "asset/asset.json").read_text())["maps"] == -1.0
    assert not whys(run_job(job, Quiet()))

    toy.write_bundle(bundle, photos=2)
    redone = whys(run_job(job, Quiet()))
    assert redone["reflectance"] == "capture.json changed; photos/0.png and 1 more added"
    assert redone["fit"] == "samples is there now"
    assert redone["pack"] == "maps is there now"

    toy.write_bundle(bundle, photos=0)
    redone = whys(run_job(job, Quiet()))
    assert redone["fit"] == reason
    assert redone["pack"] == "fit had no work: the capture has no photographs"
    assert sorted(path.name for path in (out / "fit").iterdir()) == ["manifest.json"]


@pytest.mark.parametrize(
    ("behave", "error"), [("error", ImpastoError), ("crash", ValueError), ("memory", MemoryError)]
)
def test_a_failing_stage_leaves_what_was_there(
    run: Run,
    tmp_path: Path,
    snapshot: Callable[[Path], dict[str, bytes]],
    behave: str,
    error: type[Exception],
) -> None:
    run()
    before = snapshot(tmp_path / "out")
    with pytest.raises(error):
        run(settings={"calibrate": {"behave": behave}})
    assert snapshot(tmp_path / "out") == before
    assert not list((tmp_path / "out/.engine/new").iterdir())
    assert not whys(run())


def test_images_of_other_purposes_cannot_be_read(run: Run) -> None:
    with pytest.raises(RuntimeError, match=r"scan/0.png is not of a purpose"):
        run(settings={"calibrate": {"behave": "peek"}})


def test_input_that_changes_during_the_run_is_not_recorded(
    run: Run, toy: ModuleType, toy_bundle: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def scan(inputs: object, config: object, log: object) -> object:
        toy.write_image(toy_bundle / "scan/0.png", 7)
        return toy.scan(inputs, config, log)

    monkeypatch.setattr(toy, "SCAN", replace(toy.SCAN, run=scan))
    with pytest.raises(ImpastoError, match="the inputs of scan changed while it ran"):
        run()
    assert not (tmp_path / "out/scan").exists()


def test_bundle_is_not_opened_when_nothing_changed(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    import pipeline.formats.bundle

    run()
    monkeypatch.setattr(pipeline.formats.bundle, "open_bundle", None)
    assert not whys(run())


def test_missing_image_is_named(run: Run, toy_bundle: Path) -> None:
    run()
    (toy_bundle / "scan/1.png").unlink()
    with pytest.raises(ImpastoError, match=r"scan/1\.png"):
        run()


def test_the_same_bundle_gives_the_same_bytes_elsewhere(
    toy: ModuleType,
    run: Run,
    toy_bundle: Path,
    tmp_path: Path,
    snapshot: Callable[[Path], dict[str, bytes]],
) -> None:
    run()
    run_job(Job(toy_bundle, tmp_path / "other", toy.RECIPE, Selection()), Quiet())
    assert snapshot(tmp_path / "other") == snapshot(tmp_path / "out")


def test_a_stage_must_write_what_it_declares(
    run: Run, toy: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(toy, "FIT", replace(toy.FIT, run=lambda *_: toy.FitOutputs(None)))
    with pytest.raises(TypeError, match="fit gave nothing for maps"):
        run()
    monkeypatch.setattr(toy, "FIT", replace(toy.FIT, run=lambda *_: None))
    with pytest.raises(TypeError, match="fit returned NoneType"):
        run()
