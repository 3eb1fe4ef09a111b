"""``impasto bench``: tables, files, frontier; wrong names."""

from __future__ import annotations

import json
import math

import pytest

from benchmarks.results import Result, Row
from pipeline.cli import main


def call(*arguments):
    with pytest.raises(SystemExit) as ended:
        main([str(argument) for argument in arguments])
    return ended.value.code


def test_a_quick_benchmark_writes_a_table_json_and_a_picture(tmp_path, capfd):
    assert call("bench", "classify", "--quick", "--out", tmp_path / "b") == 0
    assert "largest error, px" in capfd.readouterr().out
    document = json.loads((tmp_path / "b" / "classify.json").read_text())
    assert sum(row["default"] for row in document["rows"]) == 1
    assert document["frontier"]
    assert (tmp_path / "b" / "classify.svg").read_text().startswith("<svg")


def test_the_plane_stays_within_the_tolerated_error(tmp_path):
    assert call("bench", "classify", "--quick", "--out", tmp_path) == 0
    rows = json.loads((tmp_path / "classify.json").read_text())["rows"]
    (default,) = (row for row in rows if row["default"])
    # Components of a few pixels are dropped as noise, so a little more may show.
    assert default["error"] < 2.0 * 1.1


def test_an_unknown_benchmark_is_wrong_usage(tmp_path, capfd):
    assert call("bench", "nothing", "--out", tmp_path) == 2
    assert "'nothing'" in capfd.readouterr().err


def test_the_frontier_has_what_nothing_beats():
    rows = [Row("a", 1.0, 5.0), Row("b", 2.0, 6.0), Row("c", 3.0, 1.0), Row("d", 0.5, math.nan)]
    result = Result("x", "t", "mm", rows)
    assert [row.name for row in result.frontier()] == ["a", "c"]
    assert "<script" not in Result("x", "<script", "mm", rows).svg()


def test_a_benchmark_without_errors_still_has_a_picture():
    assert Result("x", "t", "mm", [Row("a", 1.0, math.nan)]).svg().startswith("<svg")
