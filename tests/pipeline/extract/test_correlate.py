from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from pipeline.extract.correlate import SIGNIFICANT, coarse, match
from pipeline.extract.patch import PatchMap

ROWS, COLUMNS, SPACING = 90, 120, 1.0


@pytest.fixture(scope="module")
def world():
    rng = np.random.default_rng(0)
    return [ndimage.gaussian_filter(rng.standard_normal((300, 400)), 1.5) for _ in range(2)]


def cut(world, x, y, turn_deg=0.0, noise=0.01, seed=1):
    """Return the map of a patch whose axes lie at x, y of the world, turned; y is up."""
    column, row = np.meshgrid(np.arange(COLUMNS) - COLUMNS / 2, ROWS / 2 - np.arange(ROWS))
    angle = np.deg2rad(turn_deg)
    there_x = x + np.cos(angle) * column - np.sin(angle) * row
    there_y = y + np.sin(angle) * column + np.cos(angle) * row
    rng = np.random.default_rng(seed)
    images = [
        ndimage.map_coordinates(w, [150 - there_y, 200 + there_x], order=1, cval=np.nan)
        + noise * rng.standard_normal(column.shape)
        for w in world
    ]
    return PatchMap(-COLUMNS / 2, ROWS / 2, SPACING, images[0], images[0] * 0, images[1])


@pytest.mark.parametrize(
    ("x", "y", "turn"), [(0, 0, 0), (60, 30, 0), (-70, -20, 6), (30, 50, -10), (95, -5, 3)]
)
def test_shift_and_turn_are_found(world, x, y, turn):
    first, second = (coarse(cut(world, *p), SPACING) for p in ((0, 0), (x, y, turn, 0.01, 2)))
    found = match(first, second)
    assert found.score > SIGNIFICANT
    assert found.motion.translation_mm == pytest.approx([x, y, 0], abs=1.5)
    assert np.rad2deg(np.arctan2(*found.motion.rotation[1::-1, 0])) == pytest.approx(turn, abs=0.8)


def test_unrelated_maps_do_not_match():
    rng = np.random.default_rng(3)
    for seed in range(4):
        one, other = (
            [ndimage.gaussian_filter(rng.standard_normal((300, 400)), 1.5) for _ in range(2)]
            for _ in range(2)
        )
        found = match(
            coarse(cut(one, 0, 0), SPACING), coarse(cut(other, 0, 0, seed=seed + 9), SPACING)
        )
        assert found.score < 0.85 * SIGNIFICANT


def test_nothing_matches_nothing(world):
    blank = PatchMap(0.0, 0.0, 1.0, *(np.full((40, 40), np.nan) for _ in range(3)))
    flat = PatchMap(0.0, 0.0, 1.0, *(np.zeros((40, 40)) for _ in range(3)))
    for one in (blank, flat):
        for other in (blank, flat, cut(world, 0, 0)):
            assert not match(coarse(one, SPACING), coarse(other, SPACING)).score > SIGNIFICANT


def test_relief_of_any_size_matches(world):
    for factor in (1e-3, 1e3):
        scaled = [factor * w for w in world]
        found = match(
            coarse(cut(scaled, 0, 0, noise=0), SPACING),
            coarse(cut(scaled, 50, 9, noise=0), SPACING),
        )
        assert found.motion.translation_mm == pytest.approx([50, 9, 0], abs=1.5)
