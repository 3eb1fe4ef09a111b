"""Declarations that cannot work are refused when they are made."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import ModuleType
from typing import Any

import pytest

from pipeline.engine.recipe import StageReference
from pipeline.engine.stage import writes
from pipeline.errors import ImpastoError


def test_folder_is_the_name_unless_given(toy: ModuleType) -> None:
    assert toy.SCAN.folder == "scan"
    assert toy.PACK.folder == "asset"
    assert toy.SCAN.output_files == ("scan/copy.json", "scan/range.json")


def test_outputs_lie_in_the_stage_folder(toy: ModuleType) -> None:
    with pytest.raises(TypeError, match=r"scan/copy\.json is not a file of its own in fit/"):
        replace(toy.SCAN, folder="fit")

    @dataclass(frozen=True)
    class Outputs:
        numbers: Any = writes(toy.json_artifact("scan/manifest.json"))

    with pytest.raises(TypeError, match=r"manifest\.json is not a file of its own"):
        replace(toy.SCAN, outputs=Outputs)


def test_every_field_is_declared(toy: ModuleType) -> None:
    @dataclass(frozen=True)
    class Plain:
        numbers: int

    with pytest.raises(TypeError, match="input numbers needs reads"):
        replace(toy.SCAN, inputs=Plain)
    with pytest.raises(TypeError, match="output numbers needs writes"):
        replace(toy.SCAN, outputs=Plain)


def test_reference(toy: ModuleType) -> None:
    assert StageReference("scan", "toy_stages:SCAN", "scan").load() is toy.SCAN
    with pytest.raises(ImpastoError, match="the stage scan is not installed"):
        StageReference("scan", "pipeline.nowhere.stage:STAGE", "scan").load()
    with pytest.raises(TypeError, match="toy_stages:FIT is fit in fit/"):
        StageReference("scan", "toy_stages:FIT", "scan").load()
