from __future__ import annotations

import numpy as np

from pipeline.scan.outliers import specks, straddling

PITCH = 1e-3


def surface(rows=20, columns=30):
    v, u = np.mgrid[0:rows, 0:columns].astype(np.float64)
    return 1000 + 0.8 * u - 0.5 * v, np.full((rows, columns), 0.01, np.float32)


def test_a_slope_is_no_step():
    depth, sigma = surface()
    assert not straddling(depth, sigma, PITCH).any()
    assert not specks(depth, sigma, PITCH, 25).any()
    # Noise alone never makes one, however large.
    rng = np.random.default_rng(1)
    noisy = depth + 20 * rng.standard_normal(depth.shape)
    assert straddling(noisy, np.full(depth.shape, 20.0, np.float32), PITCH).mean() < 0.01


def test_the_pixel_between_two_surfaces_goes_and_its_neighbours_stay():
    depth, sigma = surface()
    depth[:, 15:] += 30
    depth[5:10, 15] -= 14
    mixed = straddling(depth, sigma, PITCH)
    assert mixed[6:9, 15].all()
    assert not mixed[6:9, 14].any()
    assert not mixed[6:9, 16].any()


def test_a_step_without_a_pixel_between_loses_both_sides():
    depth, sigma = surface()
    depth[:, 15:] += 30
    mixed = straddling(depth, sigma, PITCH)
    assert mixed[1:-1, 14:16].all()
    assert not mixed[:, :14].any()
    assert not mixed[:, 16:].any()


def test_small_pieces_are_specks():
    depth, sigma = surface()
    depth[5:8, 5:8] += 50
    depth[12:18, 20:26] += 50
    depth[0, :] = np.nan
    found = specks(depth, sigma, PITCH, 25)
    assert found[5:8, 5:8].all()
    assert np.count_nonzero(found) == 9


def test_nothing_and_one_pixel():
    empty = np.full((3, 3), np.nan)
    assert not specks(empty, np.ones((3, 3), np.float32), PITCH, 2).any()
    assert not straddling(empty, np.ones((3, 3), np.float32), PITCH).any()
    one = np.array([[5.0]])
    assert specks(one, np.ones((1, 1), np.float32), PITCH, 2).all()
    assert not specks(one, np.ones((1, 1), np.float32), PITCH, 1).any()
    assert not straddling(one, np.ones((1, 1), np.float32), PITCH).any()
