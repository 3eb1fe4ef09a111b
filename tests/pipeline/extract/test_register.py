from __future__ import annotations

import numpy as np
import pytest

from pipeline.extract.patch import PatchMap
from pipeline.extract.register import register
from pipeline.geometry.rigid import RigidTransform, rotation_about_axis

SPACING = 0.5


def relief(x, y):
    return 0.3 * np.sin(x / 2.1) * np.cos(y / 2.7) + 0.5 * np.sin(x / 9 + 1) * np.sin(y / 7)


def albedo(x, y):
    return 0.3 * np.cos(x / 1.9 + 2) * np.sin(y / 2.3) + 0.2 * np.sin((x + y) / 5)


def patch(x0, y0, motion, relief=relief, albedo=albedo, noise=0.01, seed=0, rows=120, columns=140):
    """Return the map, in axes that ``motion`` takes to the world's, of what lies there."""
    x, y = np.meshgrid(x0 + np.arange(columns) * SPACING, y0 - np.arange(rows) * SPACING)
    z = np.zeros_like(x)
    for _ in range(30):  # where the surface cuts the patch's own vertical
        world = motion.apply(np.stack([x, y, z], axis=-1))
        z = z - (world[..., 2] - relief(world[..., 0], world[..., 1])) / motion.rotation[2, 2]
    rng = np.random.default_rng(seed)
    shape = x.shape
    return PatchMap(
        x0,
        y0,
        SPACING,
        z + noise * rng.standard_normal(shape),
        np.full(shape, noise),
        albedo(world[..., 0], world[..., 1]) + 0.02 * rng.standard_normal(shape),
    )


def motion(x, y, z, turn, tilt):
    turned = rotation_about_axis(np.zeros(3), np.array([0, 0, 1.0]), turn)
    tilted = rotation_about_axis(np.zeros(3), np.array([1.0, 0.3, 0]), tilt)
    return RigidTransform((turned @ tilted).rotation, np.array([x, y, z]))


TRUE = [RigidTransform(), motion(40, 3, 0.5, 4, 0.5), motion(5, -40, -1, -3, -0.4)]


def off(found, true):
    """Return the error of a motion as turn (rad) and shift (mm) at the patch's own middle."""
    centre = np.array([0.0, 0, 0])
    turn = found.rotation @ true.rotation.T
    skew = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    return skew / 2, found.apply(centre) - true.apply(centre)


def rough(true, seed):
    """Return a start a millimetre and half a degree off, without any tilt or lift."""
    rng = np.random.default_rng(seed)
    angle = np.arctan2(true.rotation[1, 0], true.rotation[0, 0])
    turn = rotation_about_axis(
        np.zeros(3), np.array([0, 0, 1.0]), np.rad2deg(angle) + rng.uniform(-0.5, 0.5)
    )
    return RigidTransform(
        turn.rotation, np.array([*(true.translation_mm[:2] + rng.uniform(-0.7, 0.7, 2)), 0])
    )


@pytest.mark.parametrize("seed", range(3))
def test_all_overlaps_are_solved_at_once(seed):
    maps = [patch(-35, 30, m, seed=10 * seed + i) for i, m in enumerate(TRUE)]
    start = [TRUE[0], *(rough(m, seed) for m in TRUE[1:])]
    found = register(maps, start)
    assert [(o.first, o.second) for o in found.overlaps] == [(0, 1), (0, 2), (1, 2)]
    assert all(o.agrees for o in found.overlaps)
    for k in (1, 2):
        turn, shift = off(found.motions[k], TRUE[k])
        assert np.abs(shift).max() < 0.01
        assert np.abs(turn).max() < 3e-4
    # 10 um each, no more than the bilinear look-up averages away.
    assert 0.010 < found.overlaps[0].rms_mm < 0.0145
    assert found.overlaps[0].expected_mm == pytest.approx(0.01 * np.sqrt(2))


def test_the_covariance_is_of_the_errors_size():
    ratios = []
    for seed in range(6):
        maps = [patch(-35, 30, m, seed=100 + 10 * seed + i) for i, m in enumerate(TRUE[:2])]
        found = register(maps, [TRUE[0], rough(TRUE[1], seed)])
        turn, _ = off(found.motions[1], TRUE[1])
        at = found.centre_mm
        back = TRUE[1].inverse().apply(at)
        shift = found.motions[1].apply(back) - at
        deviation = np.sqrt(np.diag(found.covariances[1]))
        ratios.append(np.concatenate([turn, shift]) / deviation)
    spread = np.sqrt(np.mean(np.square(ratios)))
    assert 0.2 < spread < 1.5  # samples are taken to share errors; these do not
    assert not found.covariances[0].any()


def test_a_featureless_plane_cannot_be_registered():
    flat = [
        patch(-35, 30, TRUE[0], lambda x, y: 0 * x, lambda x, y: 0 * x, noise=0.0) for _ in range(2)
    ]
    bare = [
        PatchMap(m.left_mm, m.top_mm, SPACING, 0 * m.heights, m.sigma + 0.01, 0 * m.detail)
        for m in flat
    ]
    with pytest.raises(ValueError, match="neither relief nor albedo"):
        register(bare, [TRUE[0], RigidTransform(np.eye(3), np.array([20.0, 0, 0]))])


def test_without_overlap_nothing_holds():
    maps = [patch(-35, 30, TRUE[0]) for _ in range(2)]
    with pytest.raises(ValueError, match="neither relief nor albedo"):
        register(maps, [TRUE[0], RigidTransform(np.eye(3), np.array([500.0, 0, 0]))])


def test_two_surfaces_that_are_not_one_do_not_agree():
    first = patch(-35, 30, TRUE[0])
    other = patch(-35, 30, TRUE[0], lambda x, y: relief(y + 3, 1.1 * x), seed=1)
    found = register([first, other], [TRUE[0], TRUE[0]])
    assert not found.overlaps[0].agrees
