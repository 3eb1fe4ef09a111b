"""``impasto status``: true, and without a trace."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

Impasto = Callable[..., Any]


def states(printed: str) -> dict[str, str]:
    """Return the state by stage of the printed table."""
    lines = printed.splitlines()
    assert re.split(r"\s{2,}", lines[1]) == ["stage", "state", "when", "time", "figures"]
    begin, end = lines[1].index("state"), lines[1].index("when")
    return {line.split()[0]: line[begin:end].strip() for line in lines[2:]}


def everything(folder: Path) -> dict[str, tuple[int, int]]:
    return {
        str(path): (path.stat().st_mtime_ns, path.stat().st_ino)
        for path in (folder, *folder.rglob("*"))
    }


def test_tells_every_state_and_changes_nothing(
    impasto: Impasto, toy: ModuleType, tmp_path: Path
) -> None:
    bundle, out = toy.write_bundle(tmp_path / "bundle", photos=0), tmp_path / "out"
    impasto("run", bundle, "--out", out, "--to", "fit")
    before = everything(out)
    ended = impasto("status", out)
    assert ended.status == 0
    assert ended.out.splitlines()[0] == f"{out}, made from {bundle}"
    assert "rms 0.25 px" in ended.out
    assert states(ended.out) == {
        "calibrate": "up to date",
        "scan": "up to date",
        "reflectance": "no work: the capture has no photographs",
        "fit": "no work: reflectance had no work: the capture has no photographs",
        "pack": "not run",
    }
    assert everything(out) == before


def test_tells_why_a_stage_is_stale(impasto: Impasto, toy_bundle: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    impasto("run", toy_bundle, "--out", out, "--set", "calibrate.factor=9")
    (out / "fit/maps.json").unlink()
    assert states(impasto("status", out).out) == {
        "calibrate": "stale: configuration: factor was 9, is 2",
        "scan": "stale: calibrate comes first",
        "reflectance": "up to date",
        "fit": "stale: fit/maps.json is missing",
        "pack": "stale: scan comes first",
    }
    with_setting = impasto("status", out, "--set", "calibrate.factor=9")
    assert states(with_setting.out)["calibrate"] == "up to date"
    assert impasto("status", out, "--set", "calibrate.factor=900").status == 2


def test_bundle_gone(impasto: Impasto, toy_bundle: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    impasto("run", toy_bundle, "--out", out)
    shutil.rmtree(toy_bundle)
    ended = impasto("status", out)
    assert ended.status == 0
    assert states(ended.out)["calibrate"].startswith("stale: ")
    assert str(toy_bundle) in ended.out


def test_no_workspace(impasto: Impasto, tmp_path: Path) -> None:
    for folder in (tmp_path, tmp_path / "nowhere"):
        ended = impasto("status", folder)
        assert (ended.status, ended.out) == (1, "")
        assert "this is not a workspace" in ended.err
        assert ended.err.count("\n") == 1
    assert not list(tmp_path.iterdir())
