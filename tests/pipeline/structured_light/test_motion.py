"""Shifts between pictures in even light."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy import ndimage

from pipeline.structured_light.motion import shift_between


def picture(dx=0.0, dy=0.0, gain=1.0, noise=0.004, seed=1):
    rng = np.random.default_rng(7)
    texture = cv2.GaussianBlur(rng.random((200, 260)).astype(np.float32), (0, 0), 2.0)
    texture = (texture - texture.min()) / np.ptp(texture)
    moved = ndimage.shift(texture, (dy, dx), order=5, mode="nearest")
    noisy = gain * (0.1 + moved) + noise * np.random.default_rng(seed).normal(size=texture.shape)
    return noisy[20:-20, 20:-20].astype(np.float32)


@pytest.mark.parametrize("shift", [(0.3, 0.0), (0.0, -0.5), (0.8, 0.6), (0.1, 0.1)])
@pytest.mark.parametrize("gain", [1.0, 0.4])
def test_small_shifts_are_measured(shift, gain):
    found = shift_between(picture(), picture(*shift, gain=gain, seed=2))
    assert found == pytest.approx(np.hypot(*shift), rel=0.1)


@pytest.mark.parametrize("shift", [3.0, 6.0])
def test_large_shifts_are_seen(shift):
    assert shift_between(picture(), picture(shift, seed=2)) > 1


@pytest.mark.parametrize("noise", [0.0, 0.004, 0.05])
@pytest.mark.parametrize("gain", [0.3, 1.0, 3.0])
def test_what_stood_still_did_not_move(noise, gain):
    found = shift_between(picture(noise=noise), picture(gain=gain, noise=noise, seed=3))
    assert found < 0.02


def test_unknown_parts_are_no_texture():
    first, second = picture(), picture(seed=2)
    second[40:80, 50:120] = np.nan
    assert shift_between(first, second) < 0.02
    second = picture(0.5, seed=2)
    second[40:80, 50:120] = np.nan
    assert shift_between(first, second) == pytest.approx(0.5, rel=0.1)


def test_nothing_to_see_is_no_motion():
    flat = np.full((80, 80), 0.5, np.float32)
    assert shift_between(flat, flat) == 0
    assert shift_between(np.full_like(flat, np.nan), flat) == 0
    assert shift_between(flat[:3, :3], flat[:3, :3]) == 0
    assert shift_between(flat, picture()[:80, :80]) < 0.5
