"""``impasto run``: what it prints, and several bundles."""

from __future__ import annotations

import errno
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from pipeline.engine.stage import writes
from pipeline.engine.workspace import open_workspace

Impasto = Callable[..., Any]


def test_prints_a_line_per_stage(impasto: Impasto, toy_bundle: Path, tmp_path: Path) -> None:
    ended = impasto("run", toy_bundle, "--out", tmp_path / "out")
    assert (ended.status, ended.err) == (0, "")
    assert re.sub(r"\d+\.\d s", "T s", ended.out).splitlines() == [
        "calibrate   done in T s   (rms 0.25 px, endless not finite)",
        "            warning: the boards all lie flat",
        "scan        done in T s   (52.1 % measured)",
        "reflectance done in T s",
        "fit         done in T s",
        "pack        done in T s",
        "skipped, as not needed:",
        "  calibrate: the projector: its calibration is given",
    ]
    ended = impasto("run", toy_bundle, "--out", tmp_path / "out")
    assert ended.out.splitlines()[-2:] == [
        "pack        up to date",
        "nothing to do: all 5 stages are up to date",
    ]


def test_says_why_a_stage_is_redone(impasto: Impasto, toy_bundle: Path, tmp_path: Path) -> None:
    impasto("run", toy_bundle, "--out", tmp_path / "out")
    ended = impasto("run", toy_bundle, "--out", tmp_path / "out", "--set", "scan.threshold=4")
    lines = ended.out.splitlines()
    assert lines[0] == "calibrate   up to date"
    assert lines[1].endswith("because configuration: threshold was 3.0, is 4.0")


def test_no_work_is_said(impasto: Impasto, toy: ModuleType, tmp_path: Path) -> None:
    bundle = toy.write_bundle(tmp_path / "bare", photos=0)
    for _ in range(2):
        ended = impasto("run", bundle, "--out", tmp_path / "out")
        assert "reflectance no work: the capture has no photographs\n" in ended.out
        assert "fit         no work: reflectance had no work: the capture has no ph" in ended.out
        assert ended.status == 0


def test_quiet(impasto: Impasto, toy_bundle: Path, tmp_path: Path) -> None:
    assert impasto("run", toy_bundle, "--out", tmp_path / "out", "-q") == (0, "", "")
    failing = ("--set", "calibrate.behave=error")
    ended = impasto("run", toy_bundle, "--out", tmp_path / "out", "-q", *failing)
    assert ended == (1, "", "impasto: board/0.png: the board was not found; wash it\n")


@pytest.mark.parametrize(
    ("behave", "line"),
    [
        ("error", "board/0.png: the board was not found; wash it"),
        ("memory", "not enough memory"),
        (
            "crash",
            "internal error, ValueError: a defect; "
            "please report it; --debug shows where it comes from",
        ),
    ],
)
def test_a_failing_stage_stops_the_run(
    impasto: Impasto, toy_bundle: Path, tmp_path: Path, behave: str, line: str
) -> None:
    settings = ("--set", f"calibrate.behave={behave}")
    ended = impasto("run", toy_bundle, "--out", tmp_path / "out", *settings)
    assert ended == (1, "calibrate   stopped\n", f"impasto: {line}\n")


@pytest.mark.parametrize("out", ["bundle", "bundle/out", "file", "file/out", "/proc/impasto"])
def test_unusable_outputs_are_one_line(
    impasto: Impasto, toy_bundle: Path, tmp_path: Path, out: str
) -> None:
    (tmp_path / "file").write_text("x")
    ended = impasto("run", toy_bundle, "--out", tmp_path / out)
    assert ended.status == 1
    assert ended.out == ""
    assert re.fullmatch(r"impasto: [^\n]+\n", ended.err)
    assert "internal error" not in ended.err
    assert str(tmp_path / out if out != "/proc/impasto" else out) in ended.err


def test_what_is_no_bundle_is_one_line(impasto: Impasto, tmp_path: Path) -> None:
    for bundle, text in ((tmp_path, "not a capture bundle"), (tmp_path / "x", "no such folder")):
        ended = impasto("run", bundle, "--out", tmp_path / "out")
        assert ended.status == 1
        assert text in ended.err
        assert ended.err.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("workers", [1, 3])
def test_several_bundles(
    impasto: Impasto, toy: ModuleType, toy_bundle: Path, tmp_path: Path, workers: int
) -> None:
    bundles = [tmp_path / name for name in ("a", "b", "c")]
    for bundle in bundles:
        shutil.copytree(toy_bundle, bundle)
    (tmp_path / "b/scan/1.png").unlink()
    ended = impasto("run", *bundles, "--out", tmp_path / "out", "--workers", workers)
    assert ended.status == 1
    assert (tmp_path / "out/a/asset/asset.json").exists()
    assert (tmp_path / "out/c/asset/asset.json").exists()
    assert "a: pack        done in" in ended.out
    table = [re.sub(r"\d+\.\d s", "T s", line) for line in ended.out.splitlines()[-3:]]
    assert [line.split() for line in table] == [
        ["a", "T", "s", "5", "of", "5", "stages", "done"],
        ["b", "T", "s", "failed"],
        ["c", "T", "s", "5", "of", "5", "stages", "done"],
    ]
    first, last = ended.err.splitlines()
    assert first.startswith("impasto: b: ")
    assert "scan/1.png" in first
    assert last == "impasto: 1 of 3 bundles could not be processed: b"

    ended = impasto("run", bundles[0], bundles[2], "--out", tmp_path / "out", "-q")
    assert ended == (0, "", "")


def test_interrupt_ends_all_processes(
    toy_process: Callable[..., subprocess.Popen[str]], toy_bundle: Path, tmp_path: Path
) -> None:
    bundles = [tmp_path / name for name in ("a", "b")]
    for bundle in bundles:
        shutil.copytree(toy_bundle, bundle)
    sleeping = ("--workers", 2, "--set", "calibrate.behave=sleep")
    process = toy_process("run", *bundles, "--out", tmp_path / "out", *sleeping, own_group=True)
    deadline = time.monotonic() + 30
    while not all((tmp_path / f"out/{name}/.engine/new/calibrate").exists() for name in "ab"):
        assert time.monotonic() < deadline
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGINT)
    printed, errors = process.communicate(timeout=20)
    assert process.returncode == 130
    assert (printed, errors) == ("", "impasto: interrupted; what was finished is kept\n")
    for bundle in bundles:
        with open_workspace(tmp_path / "out" / bundle.name).locked():
            pass


def test_full_disk_names_the_file(
    impasto: Impasto,
    toy: ModuleType,
    toy_bundle: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def save(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    @dataclass(frozen=True)
    class Outputs:
        maps: Any = writes(replace(toy.MAPS, save=save))

    def run(inputs: object, config: object, log: object) -> Outputs:
        return Outputs({})

    monkeypatch.setattr(toy, "FIT", replace(toy.FIT, outputs=Outputs, run=run))
    ended = impasto("run", toy_bundle, "--out", tmp_path / "out", "-q")
    line = (
        f"impasto: {tmp_path}/out/fit/maps.json: it could not be written: No space left on device"
    )
    assert ended == (1, "", line + "\n")
    assert (tmp_path / "out/scan/range.json").exists()
    assert not (tmp_path / "out/fit").exists()


def test_dask_without_distributed_is_wrong_usage(
    impasto: Impasto, toy_bundle: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    ended = impasto("run", toy_bundle, "--out", tmp_path / "out", "--dask", "tcp://host:8786")
    assert (ended.status, ended.out) == (2, "")
    assert re.fullmatch(r"impasto: --dask needs the package distributed[^\n]+\n", ended.err)
    assert not (tmp_path / "out").exists()


def test_bundles_of_one_name_are_refused(impasto: Impasto, tmp_path: Path) -> None:
    ended = impasto("run", tmp_path / "x/eye", tmp_path / "y/eye", "--out", tmp_path / "out")
    assert ended == (2, "", "impasto: two bundles are named 'eye'; run them with two --out\n")


def test_a_bundle_whose_process_dies_does_not_stop_the_others(
    impasto: Impasto, toy_bundle: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("a", "b"):
        shutil.copytree(toy_bundle, tmp_path / name)
    module = tmp_path / "dying_stage.py"
    module.write_text(
        "import os\nfrom dataclasses import replace\nimport toy_stages\n"
        "def run(inputs, config, log):\n"
        "    if inputs.bundle.folder.name == 'a':\n        os._exit(7)\n"
        "    return toy_stages.scan(inputs, config, log)\n"
        "SCAN = replace(toy_stages.SCAN, run=run)\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    import pipeline.commands.run as command
    from pipeline.engine.recipe import StageReference

    dying = StageReference("scan", "dying_stage:SCAN", "scan")
    recipe = (command.RECIPE[0], dying, *command.RECIPE[2:])
    monkeypatch.setattr(command, "RECIPE", recipe)
    ended = impasto("run", tmp_path / "a", tmp_path / "b", "--out", tmp_path / "out")
    assert ended.status == 1
    assert "impasto: a: its process died (exit status 7)" in ended.err
    assert (tmp_path / "out/b/asset/asset.json").exists()
