"""``impasto demo`` and ``report``: what they leave, and what they never touch."""

from __future__ import annotations

import json

import pytest

from pipeline.cli import main
from pipeline.commands import demo as module
from pipeline.commands.demo import MARK, capture
from pipeline.errors import UsageError


def call(*arguments):
    with pytest.raises(SystemExit) as ended:
        main([str(argument) for argument in arguments])
    return ended.value.code


@pytest.fixture
def recorded(monkeypatch):
    """Stand in for the rig; return what it was asked for."""
    import hardware.simulated.studio as studio

    asked = []

    def record(setting, bundle, truth, progress):
        asked.append((setting.seed, setting.photos))
        for folder in (bundle, truth):
            folder.mkdir()
        progress("sequences to scan", 0, 3)

    monkeypatch.setattr(studio, "record", record)
    return asked


def test_a_capture_is_made_once(tmp_path, recorded):
    capture(tmp_path, 1, 8)
    capture(tmp_path, 1, 8)
    assert recorded == [(1, 8)]
    assert json.loads((tmp_path / MARK).read_text())["complete"]


def test_another_capture_replaces_it(tmp_path, recorded):
    capture(tmp_path, 1, 8)
    (tmp_path / "bundle" / "old").touch()
    capture(tmp_path, 2, 8)
    assert recorded == [(1, 8), (2, 8)]
    assert not (tmp_path / "bundle" / "old").exists()


def test_a_broken_off_capture_is_made_again(tmp_path, recorded):
    capture(tmp_path, 1, 8)
    mark = json.loads((tmp_path / MARK).read_text()) | {"complete": False}
    (tmp_path / MARK).write_text(json.dumps(mark))
    capture(tmp_path, 1, 8)
    assert len(recorded) == 2


@pytest.mark.parametrize("name", ["bundle", "truth"])
def test_a_folder_of_somebody_else_is_never_touched(tmp_path, recorded, name):
    (tmp_path / name).mkdir()
    (tmp_path / name / "precious").touch()
    with pytest.raises(UsageError, match="was not made by impasto demo"):
        capture(tmp_path, 1, 8)
    assert (tmp_path / name / "precious").exists()
    assert recorded == []


def test_a_damaged_mark_counts_as_our_own(tmp_path, recorded):
    (tmp_path / MARK).write_text("{")
    (tmp_path / "bundle").mkdir()
    capture(tmp_path, 1, 8)
    assert len(recorded) == 1


def test_wrong_options_are_wrong_usage(tmp_path, capfd):
    assert call("demo", "--out", tmp_path, "--seed", "-1") == 2
    assert "--seed" in capfd.readouterr().err


def test_report_of_no_workspace_is_one_line(tmp_path, capfd):
    assert call("report", tmp_path / "nowhere") == 1
    assert len(capfd.readouterr().err.strip().splitlines()) == 1


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_the_whole_demonstration(tmp_path, capfd, monkeypatch):
    from functools import partial

    import hardware.simulated.studio as studio
    from hardware.acquisition import Coding, coded

    small = partial(
        studio.Setting,
        scan_px=(320, 240), photo_px=(160, 120), projector_px=(512, 384), spacing_mm=0.4, boards=6,
        patterns=coded(*(Coding(axis, 6, 8, periods_px=(16,), steps=4) for axis in "xy")),
    )  # fmt: skip
    monkeypatch.setattr(studio, "Setting", small)
    assert call("demo", "--out", tmp_path / "d", "--photos", "8") == 0
    printed = capfd.readouterr().out
    assert "errors against the truth" in printed
    assert "height error, median" in printed
    assert (tmp_path / "d" / "report.html").stat().st_size > 100_000
    assert (tmp_path / "d" / "asset" / "asset.json").is_file()
    assert len(list((tmp_path / "d" / "pictures").glob("*.png"))) >= 6
    assert call("demo", "--out", tmp_path / "d", "--photos", "8") == 0
    printed = capfd.readouterr().out
    assert "capture    up to date" in printed
    assert printed.count("up to date") == 9
    assert "pictures   up to date" in printed
    assert module.MARK in {path.name for path in (tmp_path / "d").iterdir()}
