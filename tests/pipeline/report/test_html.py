"""The pieces of the report: escaping, numbers, no outside resources."""

from __future__ import annotations

import re

import numpy as np
import pytest

from pipeline.report import html
from pipeline.report.figures import false_colour

HOSTILE = '<script>alert("x")</script>\'&'


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0, "0"),
        (12, "12"),
        (1234567, "1\u202f234\u202f567"),
        (0.01234, "0.012"),
        (1.2345, "1.23"),
        (98.76, "98.8"),
        (1234.5, "1\u202f234"),
        (0.00012, "0.00012"),
        (-2.5, "-2.50"),
        (float("nan"), "–"),
        (float("-inf"), "–"),
    ],
)
def test_numbers_are_written_for_people(value: float, text: str) -> None:
    assert html.number(value) == text


def test_every_text_is_escaped() -> None:
    picture = np.zeros((4, 4, 3), np.uint8)
    page = html.document(
        HOSTILE,
        html.facts([(HOSTILE, HOSTILE)]),
        [
            ("a", HOSTILE, html.section(HOSTILE, HOSTILE, HOSTILE, "")),
            ("b", "b", html.figure(picture, HOSTILE) + html.table([HOSTILE], [[HOSTILE]])),
        ],
    )
    assert "<script" not in page
    assert "alert(&quot;x&quot;)" in page


def test_the_page_loads_nothing_from_elsewhere() -> None:
    scale = false_colour(np.random.default_rng(1).normal(size=(20, 30)), "mm")
    body = html.figure(scale.picture, "caption", scale=scale, overlay=html.scale_bar(20, 30, 0.5))
    page = html.document("A painting", "", [("x", "X", body)])
    for address in re.findall(r'(?:src|href)="([^"]*)"', page):
        assert address.startswith(("data:", "#"))
    assert "url(" not in page
    assert "default-src 'none'" in page


def test_the_scale_bar_has_its_true_length() -> None:
    bar = html.scale_bar(100, 200, 0.5)
    width = float(re.search(r'width="([\d.]+)"', bar).group(1))  # type: ignore[union-attr]
    assert "20 mm" in bar
    assert width * 0.5 == pytest.approx(20.0)
