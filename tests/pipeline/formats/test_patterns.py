from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from pipeline.formats.patterns import (
    Axis,
    Black,
    Gray,
    Pattern,
    Phase,
    Product,
    White,
    intensity,
    pattern_image,
    pattern_label,
)

axes = st.sampled_from(["x", "y"])


def along(axis: Axis, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    other = np.full_like(values, 3.0)
    return (values, other) if axis == "x" else (other, values)


@given(axes, st.integers(1, 10), st.integers(1, 7), st.integers(0, 1023))
def test_a_drawn_gray_code_decodes_to_the_cell(
    axis: Axis, bits: int, cell_px: int, start: int
) -> None:
    pixels = np.arange(start % (2**bits * cell_px), 2**bits * cell_px, dtype=np.float64)
    code = np.zeros(len(pixels), dtype=np.int64)
    for bit in range(bits):
        pattern = Gray(axis=axis, bit=bit, bits=bits, cell_px=cell_px)
        code = 2 * code + intensity(pattern, *along(axis, pixels)).astype(np.int64)
    number, shift = code.copy(), code >> 1
    while shift.any():
        number, shift = number ^ shift, shift >> 1
    np.testing.assert_array_equal(number, pixels // cell_px)


@given(axes, st.integers(1, 8), st.integers(1, 5))
def test_neighbouring_gray_cells_differ_in_one_bit(axis: Axis, bits: int, cell_px: int) -> None:
    centres = np.arange(2**bits, dtype=np.float64) * cell_px
    planes = [
        intensity(Gray(axis=axis, bit=b, bits=bits, cell_px=cell_px), *along(axis, centres))
        for b in range(bits)
    ]
    np.testing.assert_array_equal(np.abs(np.diff(planes, axis=1)).sum(axis=0), 1)


def test_gray_bits_by_hand() -> None:
    # Cells 0..7 on three bits: 000 001 011 010 110 111 101 100.
    expected = ["00001111", "00111100", "01100110"]
    for bit, row in enumerate(expected):
        image = pattern_image(Gray(axis="x", bit=bit, bits=3), (8, 2))
        assert ["".join(str(int(v)) for v in line) for line in image] == [row, row]
        inverted = pattern_image(Gray(axis="y", bit=bit, bits=3, inverted=True), (2, 8))
        np.testing.assert_array_equal(inverted, 1 - image.T)


def test_gray_is_decided_by_the_pixel_and_goes_on_outside() -> None:
    pattern = Gray(axis="x", bit=0, bits=1, cell_px=4)
    x = np.array([-9.0, -0.5, 3.49, 3.5, 7.4, 7.5])
    np.testing.assert_array_equal(intensity(pattern, x, np.zeros(6)), [0, 0, 0, 1, 1, 1])
    # A code of fewer bits than cells goes on reflected, as the low bits of the longer code.
    longer = pattern_image(Gray(axis="x", bit=1, bits=2, cell_px=4), (16, 1))
    np.testing.assert_array_equal(pattern_image(pattern, (16, 1)), longer)


@pytest.mark.parametrize(
    ("values", "column", "expected"),
    [
        ({"period_px": 4, "step": 0, "steps": 4}, 0, 0.5 + 0.5 * math.cos(math.pi / 4)),
        ({"period_px": 4, "step": 1, "steps": 4}, 0, 0.5 + 0.5 * math.cos(3 * math.pi / 4)),
        ({"period_px": 4, "step": 1, "steps": 4, "sign": -1}, 0, 0.5 + 0.5 * math.cos(math.pi / 4)),
        ({"period_px": 1, "step": 0, "steps": 1, "phase_offset": math.pi}, 0.5, 0.0),
        ({"period_px": 30, "step": 0, "steps": 12}, 29.5, 1.0),
        (
            {"period_px": 8, "step": 1, "steps": 4, "phase_offset": -math.pi / 2},
            1.5,
            0.5,
        ),
    ],
)
def test_phase_at_known_values(values: dict[str, Any], column: float, expected: float) -> None:
    pattern = Phase(axis="x", **values)
    assert intensity(pattern, np.array(column), np.array(0.0)) == pytest.approx(expected, abs=1e-12)


@given(
    axes,
    st.floats(2, 2000),
    st.integers(3, 16),
    st.floats(-7, 7),
    st.sampled_from([1, -1]),
    st.floats(0, 1919),
)
def test_the_steps_of_a_phase_decode_to_the_coordinate(
    axis: Axis, period: float, steps: int, offset: float, sign: int, position: float
) -> None:
    values = np.array([
        intensity(
            Phase(axis=axis, period_px=period, step=k, steps=steps, phase_offset=offset, sign=sign),
            *along(axis, np.array([position])),
        )[0]
        for k in range(steps)
    ])  # fmt: skip
    shifts = sign * 2 * np.pi * np.arange(steps) / steps
    phase = np.angle(np.sum(values * np.exp(-1j * shifts))) - offset
    error = (phase - 2 * np.pi * (position + 0.5) / period) / (2 * np.pi)
    assert abs(error - round(error)) < 1e-9
    assert values.mean() == pytest.approx(0.5)
    assert values.min() >= 0
    assert values.max() <= 1


@given(st.integers(1, 20), st.integers(1, 20))
def test_a_product_multiplies(width: int, height: int) -> None:
    gray = Gray(axis="x", bit=1, bits=5)
    phase = Phase(axis="y", period_px=7, step=1, steps=3)
    image = pattern_image(Product(of=(gray, Product(of=(phase, White())))), (width, height))
    assert image.shape == (height, width)
    expected = pattern_image(gray, (width, height)) * pattern_image(phase, (width, height))
    np.testing.assert_array_equal(image, expected)


def test_uniform_patterns_fill_the_image() -> None:
    np.testing.assert_array_equal(pattern_image(White(), (3, 2)), np.ones((2, 3)))
    np.testing.assert_array_equal(pattern_image(Black(), (3, 2)), np.zeros((2, 3)))


@pytest.mark.parametrize(
    "pattern",
    [
        White(),
        Black(),
        Gray(axis="x", bit=0, bits=2),
        Phase(axis="x", period_px=4, step=0, steps=1),
    ],
)
def test_an_unknown_coordinate_has_no_intensity(pattern: Pattern) -> None:
    values = intensity(pattern, np.array([np.nan, 1.0]), np.array([2.0, 2.0]))
    assert np.isnan(values[0])
    assert np.isfinite(values[1])


def test_labels_are_for_people() -> None:
    gray = Gray(axis="x", bit=2, bits=7, inverted=True)
    phase = Phase(axis="y", period_px=24, step=1, steps=4)
    assert pattern_label(White()) == "white"
    assert pattern_label(Product(of=(gray, phase))) == (
        "gray x bit 2 of 7 inverted times phase y period 24 step 1 of 4"
    )


@pytest.mark.parametrize(
    "values",
    [
        {"axis": "z", "period_px": 4, "step": 0, "steps": 4},
        {"axis": "x", "period_px": 0, "step": 0, "steps": 4},
        {"axis": "x", "period_px": -4, "step": 0, "steps": 4},
        {"axis": "x", "period_px": math.inf, "step": 0, "steps": 4},
        {"axis": "x", "period_px": 4, "step": -1, "steps": 4},
        {"axis": "x", "period_px": 4, "step": 0, "steps": 0},
        {"axis": "x", "period_px": 4, "step": 0, "steps": 4, "sign": 2},
        {"axis": "x", "period_px": 4, "step": 0, "steps": 4, "phase_offset": math.nan},
    ],
)
def test_impossible_phases_are_refused(values: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        Phase.model_validate(values)
