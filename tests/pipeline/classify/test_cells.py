from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.classify.cells import boxes_of, covered, valid_pixels


def test_specks_are_dropped_and_diagonals_connect() -> None:
    heights = np.zeros((20, 20), np.float32)
    heights[2, 2] = 1  # one pixel
    heights[5, 5] = heights[6, 6] = heights[7, 5] = heights[8, 6] = 1  # four, by corners
    heights[10:12, 10] = 1  # two
    heights[15, :3] = np.nan
    valid, dropped = valid_pixels(heights, 0.5, 4)
    assert valid.sum() == 4
    assert dropped == 2
    assert valid_pixels(heights, 0.5, 1)[0].sum() == 7
    assert not valid_pixels(heights, 1.0, 1)[0].any()  # at the threshold is not above


def test_a_peak_inside_one_cell() -> None:
    heights = np.zeros((17, 25), np.float32)
    heights[5, 11] = 2.0
    boxes = boxes_of(heights, heights > 0.5, 0.5, 8)
    assert len(boxes) == 1
    assert boxes.position.tolist() == [[8, 0]]
    assert boxes.size.tolist() == [[8, 8]]
    assert boxes.highest_at.tolist() == [[11, 5]]
    assert boxes.highest_mm.tolist() == [2.0]
    assert (boxes.d0_mm, boxes.top_mm, boxes.cell) == (0.5, 2.0, 8)


def test_a_peak_on_a_corner_fills_four_cells() -> None:
    heights = np.zeros((17, 17), np.float32)
    heights[8, 8] = 1
    boxes = boxes_of(heights, heights > 0.5, 0.5, 8)
    assert sorted(boxes.position.tolist()) == [[0, 0], [0, 8], [8, 0], [8, 8]]


def test_border_cells_are_smaller() -> None:
    heights = np.ones((12, 21), np.float32)
    boxes = boxes_of(heights, heights > 0.5, 0.5, 8)
    assert len(boxes) == 6
    assert (boxes.position + boxes.size).max(axis=0).tolist() == [20, 11]
    assert covered(boxes, heights.shape).all()


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1), (2, 2)])
def test_fields_without_patches(shape) -> None:
    heights = np.ones(shape, np.float32)
    boxes = boxes_of(heights, heights > 0.5, 0.5, 4)
    assert len(boxes) == (1 if min(shape) > 1 else 0)
    assert boxes.position.shape == (len(boxes), 2)


def test_nothing_known_gives_no_boxes() -> None:
    heights = np.full((9, 9), np.nan, np.float32)
    boxes = boxes_of(heights, np.zeros((9, 9), bool), 0.5, 4)
    assert len(boxes) == 0
    assert boxes.top_mm == 0.5


@given(st.integers(0, 2**32 - 1), st.integers(1, 12), st.integers(2, 30), st.integers(2, 30))
def test_every_patch_with_a_valid_corner_is_in_a_box(seed, cell, rows, columns) -> None:
    rng = np.random.default_rng(seed)
    heights = rng.uniform(0, 1, (rows, columns)).astype(np.float32)
    heights[rng.uniform(size=heights.shape) < 0.1] = np.nan
    valid = heights > 0.95
    boxes = boxes_of(heights, valid, 0.95, cell)
    patches = np.zeros((rows - 1, columns - 1), bool)
    for (column, row), (width, height) in zip(boxes.position, boxes.size, strict=True):
        patches[row : row + height, column : column + width] = True
        inside = heights[row : row + height + 1, column : column + width + 1]
        assert np.nanmax(inside) > 0.95
    needed = valid[:-1, :-1] | valid[1:, :-1] | valid[:-1, 1:] | valid[1:, 1:]
    assert (patches | ~needed).all()
    for at, height in zip(boxes.highest_at, boxes.highest_mm, strict=True):
        assert heights[at[1], at[0]] == height
