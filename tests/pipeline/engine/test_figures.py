"""Metrics in words."""

from __future__ import annotations

import pytest

from pipeline.engine.figures import in_words, telling


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("share_measured", 0.5213, "52.1 % measured"),
        ("rms_px", 0.123456, "rms 0.1235 px"),
        ("median_residual_per_sr", 0.01, "median residual 0.01 1/sr"),
        ("boxes", 1234567, "boxes 1234567"),
        ("method", "phase", "method phase"),
        ("rms_mm", None, "rms mm not finite"),
        ("steps", 3, "steps 3"),
        ("mm", 3, "mm 3"),
    ],
)
def test_in_words(name: str, value: float | int | str | None, words: str) -> None:
    assert in_words(name, value) == words


def test_telling_takes_the_first_three() -> None:
    assert telling({"a": 1, "b": 2, "c": 3, "d": 4}) == "a 1, b 2, c 3"
    assert telling({}) == ""
