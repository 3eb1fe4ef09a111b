"""Killed at any moment, a workspace holds complete stages, and a new run ends as undisturbed."""

from __future__ import annotations

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

from pipeline.engine.batch import Job, run_job
from pipeline.engine.display import Quiet
from pipeline.engine.runner import Selection
from pipeline.engine.workspace import open_workspace

Snapshot = Callable[[Path], dict[str, bytes]]
STAGES = ("calibrate", "scan", "reflectance", "fit", "asset")
WRITES = {"os.mkdir", "os.remove", "os.rename", "os.rmdir", "os.truncate"}
KILLED = 99


def die_before_write(number: int) -> None:
    """End this process before its n-th change of the disk: a file opened, renamed, synced ..."""
    left = number

    def count() -> None:
        nonlocal left
        left -= 1
        if left < 0:
            os._exit(KILLED)

    def hook(event: str, arguments: tuple[object, ...]) -> None:
        if event == "open":
            flags = arguments[2]
            if isinstance(flags, int) and flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT):
                count()
        elif event in WRITES:
            count()

    fsync = os.fsync

    def counted_fsync(descriptor: int) -> None:
        count()
        fsync(descriptor)

    os.fsync = counted_fsync
    sys.addaudithook(hook)


def run_and_die(job: Job, number: int) -> int:
    """Do the job in a child that dies before its n-th write; return the child's exit status."""
    child = os.fork()
    if child == 0:
        try:
            die_before_write(number)
            run_job(job, Quiet())
        except BaseException:
            os._exit(1)
        os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def stage_of(files: dict[str, bytes], stage: str) -> dict[str, bytes]:
    return {name: content for name, content in files.items() if name.startswith(stage + "/")}


# The child only runs the toy stages and ends with os._exit, so threads cannot trouble it.
@pytest.mark.filterwarnings("ignore:.*multi-threaded, use of fork:DeprecationWarning")
@pytest.mark.parametrize("fresh", [True, False], ids=["first run", "redone"])
def test_killed_before_every_write(
    toy: ModuleType, toy_bundle: Path, tmp_path: Path, snapshot: Snapshot, fresh: bool
) -> None:
    recipe = toy.RECIPE[:2]
    first = Selection(settings={"calibrate": {"factor": 3}, "scan": {"threshold": 1}})
    old, new, out = tmp_path / "old", tmp_path / "new", tmp_path / "out"
    for folder, selection in ((old, first), (new, Selection())):
        run_job(Job(toy_bundle, folder, recipe, selection), Quiet())
    before = {} if fresh else snapshot(old)
    after = snapshot(new)
    assert stage_of(after, "scan").keys() == {
        "scan/copy.json", "scan/manifest.json", "scan/range.json",
    }  # fmt: skip
    job = Job(toy_bundle, out, recipe, Selection())
    kills, number = 0, 0
    restored = set()
    while True:
        if out.exists():
            shutil.rmtree(out)
        if not fresh:
            shutil.copytree(old, out)
        status = run_and_die(job, number)
        assert status in (0, KILLED), number
        if status == 0:
            break
        kills += 1
        if (out / "workspace.json").exists():
            with open_workspace(out).locked():
                found = snapshot(out)
            for stage in STAGES:
                here = stage_of(found, stage)
                assert here in (stage_of(before, stage), stage_of(after, stage)), (number, stage)
                restored.add((stage, here == stage_of(after, stage)))
        run_job(job, Quiet())
        assert snapshot(out) == after, number
        assert not list((out / ".engine/new").iterdir())
        assert not list((out / ".engine/old").iterdir())
        number += 1
    assert kills > 20
    assert restored >= {("calibrate", False), ("calibrate", True), ("scan", False), ("scan", True)}


def test_killed_at_random_moments(
    toy: ModuleType,
    toy_bundle: Path,
    tmp_path: Path,
    toy_process: Callable[..., subprocess.Popen[str]],
    snapshot: Snapshot,
) -> None:
    undisturbed, out = tmp_path / "undisturbed", tmp_path / "out"
    started = time.perf_counter()
    process = toy_process("run", toy_bundle, "--out", undisturbed)
    process.communicate(timeout=60)
    assert process.returncode == 0
    usual = time.perf_counter() - started
    moments = random.Random(1)
    for _ in range(6):
        process = toy_process("run", toy_bundle, "--out", out, "--force")
        time.sleep(moments.uniform(0.4, 1.0) * usual)
        process.send_signal(signal.SIGKILL)
        process.communicate(timeout=60)
    run_job(Job(toy_bundle, out, toy.RECIPE, Selection()), Quiet())
    assert {name: data for name, data in snapshot(out).items() if name != "workspace.json"} == {
        name: data for name, data in snapshot(undisturbed).items() if name != "workspace.json"
    }


def test_interrupt_is_130_and_keeps_what_was_finished(
    toy_bundle: Path,
    tmp_path: Path,
    toy_process: Callable[..., subprocess.Popen[str]],
    snapshot: Snapshot,
) -> None:
    out = tmp_path / "out"
    first = toy_process("run", toy_bundle, "--out", out)
    first.communicate(timeout=60)
    assert first.returncode == 0
    before = snapshot(out)
    process = toy_process("run", toy_bundle, "--out", out, "--set", "calibrate.behave=sleep")
    deadline = time.monotonic() + 30
    while not (out / ".engine/new/calibrate").exists():
        assert time.monotonic() < deadline
        time.sleep(0.01)
    time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    printed, errors = process.communicate(timeout=30)
    assert process.returncode == 130
    assert errors == "impasto: interrupted; what was finished is kept\n"
    assert printed == "calibrate   stopped\n"
    assert snapshot(out) == before
    assert not list((out / ".engine/new").iterdir())


def test_second_run_says_who_holds_the_workspace(
    toy_bundle: Path, tmp_path: Path, toy_process: Callable[..., subprocess.Popen[str]]
) -> None:
    out = tmp_path / "out"
    holder = toy_process("run", toy_bundle, "--out", out, "--set", "calibrate.behave=sleep")
    deadline = time.monotonic() + 30
    while not (out / ".engine/new/calibrate").exists():
        assert time.monotonic() < deadline
        time.sleep(0.01)
    second = toy_process("run", toy_bundle, "--out", out)
    _, errors = second.communicate(timeout=30)
    assert second.returncode == 1
    assert errors == (
        f"impasto: {out}: the workspace is in use by process {holder.pid}; "
        "wait until it ends, or use another --out\n"
    )
    holder.kill()
    holder.communicate(timeout=30)
    third = toy_process("run", toy_bundle, "--out", out)
    third.communicate(timeout=60)
    assert third.returncode == 0
