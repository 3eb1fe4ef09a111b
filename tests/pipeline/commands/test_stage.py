"""One stage of a workspace."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from pipeline.recipe import RECIPE

Impasto = Callable[..., Any]


@pytest.fixture
def out(impasto: Impasto, toy_bundle: Path, tmp_path: Path) -> Path:
    assert impasto("run", toy_bundle, "--out", tmp_path / "out", "-q").status == 0
    return tmp_path / "out"


def test_knows_its_bundle(impasto: Impasto, out: Path) -> None:
    ended = impasto("scan", out)
    assert ended == (
        0, "scan        up to date\nnothing to do: the stage is up to date\n", "",
    )  # fmt: skip
    ended = impasto("scan", out, "--force")
    assert ended.out.startswith("scan        done in ")
    assert ended.out.endswith("because forced\n")


def test_leaves_the_other_stages_alone(impasto: Impasto, out: Path) -> None:
    before = (out / "asset/asset.json").read_bytes()
    assert impasto("scan", out, "--set", "scan.threshold=9").status == 0
    assert (out / "asset/asset.json").read_bytes() == before
    assert impasto("pack", out).status == 0
    assert (out / "asset/asset.json").read_bytes() != before


def test_needs_the_stages_before(impasto: Impasto, out: Path) -> None:
    shutil.rmtree(out / "calibrate")
    ended = impasto("scan", out)
    assert ended.status == 1
    assert "the stage scan needs " in ended.err
    assert "calibrate/calibration.json, which has not been made" in ended.err


def test_needs_a_workspace_and_its_bundle(
    impasto: Impasto, out: Path, toy_bundle: Path, tmp_path: Path
) -> None:
    ended = impasto("scan", toy_bundle)
    assert ended.status == 1
    assert "this is not a workspace; expected a folder with workspace.json" in ended.err
    shutil.move(toy_bundle, tmp_path / "gone")
    ended = impasto("scan", out)
    assert ended.status == 1
    assert f"impasto: {toy_bundle}: there is no such folder" in ended.err


def test_every_stage_of_the_recipe_has_a_command() -> None:
    from pipeline.cli import COMMANDS

    for reference in RECIPE:
        assert COMMANDS[reference.name][0] == f"pipeline.commands.stage:{reference.name}"
