"""Pictures for people: colours, shading, lengths."""

from __future__ import annotations

import base64

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.report.figures import (
    PAPER,
    data_uri,
    display,
    false_colour,
    fit_width,
    round_length,
    shaded_relief,
)


def test_the_scale_runs_between_percentiles_and_counts_what_lies_beyond() -> None:
    values = np.linspace(0.0, 100.0, 10001).reshape(73, 137)
    scale = false_colour(values, "mm", percentiles=(10, 90))
    assert scale.low == pytest.approx(10.0)
    assert scale.high == pytest.approx(90.0)
    assert scale.clipped == pytest.approx(0.2, abs=1e-3)
    assert tuple(scale.picture[0, 0]) == tuple(scale.legend[0, 0])
    assert tuple(scale.picture[-1, -1]) == tuple(scale.legend[0, -1])


def test_missing_values_are_paper_and_do_not_move_the_scale() -> None:
    values = np.array([[0.0, 1.0], [np.nan, np.inf]])
    scale = false_colour(values, "mm", percentiles=(0, 100))
    assert (scale.low, scale.high) == (0.0, 1.0)
    assert tuple(scale.picture[1, 0]) == PAPER
    assert tuple(scale.picture[1, 1]) == PAPER


@pytest.mark.parametrize(
    "values", [np.full((3, 4), np.nan), np.zeros((1, 1)), np.full((2, 2), 7.0)]
)
def test_a_field_without_range_still_has_a_picture(values: np.ndarray) -> None:
    for symmetric in (False, True):
        scale = false_colour(values, "mm", symmetric=symmetric)
        assert scale.picture.shape == (*values.shape, 3)
        assert scale.low < scale.high


def test_a_symmetric_scale_puts_zero_in_its_middle() -> None:
    scale = false_colour(np.array([[-3.0, 0.0, 1.0]]), "µm", symmetric=True, percentiles=(0, 100))
    assert scale.low == -scale.high == -3.0
    red_negative, red_zero = int(scale.picture[0, 0, 0]), int(scale.picture[0, 1, 0])
    assert red_negative < red_zero
    assert np.ptp(scale.picture[0, 1].astype(int)) <= 4


def test_slopes_that_face_the_lamp_are_brighter() -> None:
    rows, columns = np.mgrid[0:40, 0:40]
    facing_left = shaded_relief(columns * 0.2, 1.0, azimuth_deg=180.0)[20, 20, 0]
    facing_right = shaded_relief(-columns * 0.2, 1.0, azimuth_deg=180.0)[20, 20, 0]
    assert facing_left > facing_right
    facing_up = shaded_relief(rows * 0.2, 1.0, azimuth_deg=90.0)[20, 20, 0]
    facing_down = shaded_relief(-rows * 0.2, 1.0, azimuth_deg=90.0)[20, 20, 0]
    assert facing_up > facing_down


def test_a_flat_plate_has_lamberts_brightness() -> None:
    shade = shaded_relief(np.zeros((5, 5)), 0.3, elevation_deg=30.0)
    assert int(shade[2, 2, 0]) == round(255 * 0.5 ** (1 / 2.2))


def test_display_maps_its_percentile_to_white() -> None:
    picture = display(np.array([[0.0, 0.25, 0.5, np.nan]]), percentile=100)
    assert picture[0, 2].tolist() == [255, 255, 255]
    assert picture[0, 1].tolist() == [round(255 * 0.5 ** (1 / 2.2))] * 3
    assert tuple(picture[0, 3]) == PAPER
    assert display(np.full((2, 2), np.nan)).shape == (2, 2, 3)


def test_fit_width_only_shrinks() -> None:
    picture = np.zeros((30, 60, 3), np.uint8)
    assert fit_width(picture, 100) is picture
    assert fit_width(picture, 20).shape == (10, 20, 3)


def test_a_data_address_holds_the_picture() -> None:
    picture = np.arange(48, dtype=np.uint8).reshape(4, 4, 3)
    kind, _, body = data_uri(picture, lossless=True).partition(",")
    decoded = cv2.imdecode(np.frombuffer(base64.b64decode(body), np.uint8), cv2.IMREAD_COLOR)
    assert kind == "data:image/png;base64"
    np.testing.assert_array_equal(decoded[..., ::-1], picture)


@given(st.floats(1e-6, 1e6))
def test_round_lengths_are_round_and_nearly_as_long(longest: float) -> None:
    length = round_length(longest)
    assert length <= longest * (1 + 1e-9)
    assert length > longest / 2.5001
    mantissa = float(f"{length:.3e}".split("e")[0])
    assert mantissa in (1.0, 2.0, 5.0)
