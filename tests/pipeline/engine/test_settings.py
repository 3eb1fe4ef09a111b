"""What may stand after --set."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import pytest

from pipeline.engine.settings import configure, parse_settings
from pipeline.errors import UsageError


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("3", 3),
        ("0.5", 0.5),
        ("1e-3", 1e-3),
        ("true", True),
        ("'x'", "x"),
        ('"a=b"', "a=b"),
        ("[1, 2]", [1, 2]),
        ("{a = 1}", {"a": 1}),
        ('{"a": null}', {"a": None}),
        ("null", None),
        ("plain words", "plain words"),
        ("", ""),
        ("1\nother = 2", "1\nother = 2"),
    ],
)
def test_values(toy: ModuleType, text: str, value: Any) -> None:
    assert parse_settings([f"scan.key={text}"], toy.RECIPE) == {"scan": {"key": value}}


def test_last_one_wins(toy: ModuleType) -> None:
    texts = ["scan.a=1", "fit.a=2", "scan.a=3", "scan.b=4"]
    assert parse_settings(texts, toy.RECIPE) == {"scan": {"a": 3, "b": 4}, "fit": {"a": 2}}


@pytest.mark.parametrize("text", ["", "scan", "scan=3", "scan.=3", ".a=3", "scan.a", "=", "a.b.c"])
def test_form(toy: ModuleType, text: str) -> None:
    with pytest.raises(UsageError, match=r"not understood; expected stage\.key=value"):
        parse_settings([text], toy.RECIPE)


def test_unknown_stage_names_those_there_are(toy: ModuleType) -> None:
    with pytest.raises(UsageError, match="no stage 'scna'; expected one of calibrate, scan, refl"):
        parse_settings(["scna.threshold=3"], toy.RECIPE)


def test_configuration(toy: ModuleType) -> None:
    found = configure(toy.CALIBRATE, {"calibrate": {"factor": 7}, "scan": {"threshold": 1}})
    assert found == toy.CalibrateConfig(factor=7)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"factor": -1}, r"--set calibrate.factor: .*greater than or equal to 0, given -1"),
        ({"factor": "x"}, r"--set calibrate.factor: .*integer.*given 'x'"),
        ({"behave": "badly"}, r"'well'.*given 'badly'"),
        ({"tags": [1]}, r"--set calibrate.tags.0: .*string"),
        ({"other": 1}, r"no such key; expected one of factor, behave, tags"),
    ],
)
def test_bad_values_are_one_line(toy: ModuleType, values: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError, match=message) as caught:
        configure(toy.CALIBRATE, {"calibrate": values})
    assert "\n" not in str(caught.value)
