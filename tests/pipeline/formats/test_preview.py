from __future__ import annotations

import numpy as np

from pipeline.formats.asset import Asset
from pipeline.formats.boxes import Boxes
from pipeline.formats.preview import LONGEST_PX, shade_preview


def asset_of(normals: np.ndarray, mask: np.ndarray, albedo: float = 0.5) -> Asset:
    shape = (*mask.shape, 3)
    pairs = np.zeros((0, 2), np.int32)
    zeros = np.zeros(shape, np.float32)
    return Asset(
        "preview", 1.0, zeros[..., 0], normals.astype(np.float32), mask,
        np.full(shape, albedo / np.pi, np.float32), zeros, zeros,
        Boxes(0.0, 0.0, 8, pairs, pairs, np.zeros(0, np.float32), pairs), {},
    )  # fmt: skip


def test_light_comes_from_the_upper_left() -> None:
    normals = np.zeros((20, 60, 2))
    normals[:, :20] = -0.3, 0.3  # facing left and up
    normals[:, 40:] = 0.3, -0.3
    picture = shade_preview(asset_of(normals, np.ones((20, 60), bool)))
    assert picture[10, 10, 0] > picture[10, 30, 0] > picture[10, 50, 0]
    assert 230 < picture.max() <= 250


def test_size_is_bounded_and_outside_is_dark() -> None:
    mask = np.ones((1300, 900), bool)
    mask[:, :450] = False
    picture = shade_preview(asset_of(np.zeros((1300, 900, 2)), mask))
    assert max(picture.shape) <= LONGEST_PX
    assert picture.dtype == np.uint8
    assert picture[100, 10].max() < 70 < picture[100, -10].min()


def test_black_paint_and_no_canvas_are_black() -> None:
    flat = np.zeros((5, 5, 2))
    assert not shade_preview(asset_of(flat, np.ones((5, 5), bool), albedo=0)).any()
    assert (shade_preview(asset_of(flat, np.zeros((5, 5), bool))) < 70).all()
