from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from pipeline.structured_light.gray import bit_score, cells


def scores_of(number, bits):
    code = number ^ (number >> 1)
    set_ = (code[None] >> np.arange(bits - 1, -1, -1)[:, None, None]) & 1
    return (2.0 * set_ - 1).astype(np.float32)


@given(st.integers(1, 12))
def test_every_cell_comes_back(bits):
    number = np.arange(1 << bits).reshape(1, -1)
    cell, doubt, _ = cells(scores_of(number, bits))
    assert np.array_equal(cell, number)
    assert (doubt == 1).all()


def test_the_least_sure_bit_leads_to_the_cell_next_door():
    bits, number = 6, np.arange(63).reshape(1, -1)
    here, there = scores_of(number, bits), scores_of(number + 1, bits)
    scores = np.where(here == there, here, 0.05 * here)
    cell, doubt, neighbour = cells(scores)
    assert np.array_equal(cell, number)
    assert np.array_equal(neighbour, number + 1)
    assert np.allclose(doubt, 0.05)


def test_scores_follow_the_inverse_where_there_is_one_and_the_midpoint_else():
    one = np.ones((1, 3), np.float32)
    dark, bright = 0.2 * one, 1.0 * one
    plain = np.array([[1.0, 0.2, 0.6]], np.float32)
    assert np.allclose(bit_score(plain, None, dark, bright), [[1, -1, 0]], atol=1e-6)
    assert np.allclose(bit_score(None, plain, dark, bright), [[-1, 1, 0]], atol=1e-6)
    # Light that comes by way of other surfaces lifts both; the midpoint would say lit.
    assert bit_score(0.7 * one, 0.8 * one, dark, bright)[0, 0] < 0
    assert bit_score(0.7 * one, None, dark, bright)[0, 0] > 0


def test_what_is_not_known_is_not_sure():
    nothing = np.full((1, 1), np.nan, np.float32)
    assert bit_score(nothing, None, nothing, nothing)[0, 0] == 0
