from __future__ import annotations

import numpy as np
import pytest

from pipeline.errors import ImpastoError
from pipeline.formats.npz import write_npz
from pipeline.formats.placement_scans import PLACEMENTS, PlacementScan
from pipeline.formats.range_image import RangeImage, Texture


@pytest.fixture
def workspace(tmp_path):
    (tmp_path / "scan").mkdir()
    return tmp_path


def scan(name, source, channels, seed):
    rng = np.random.default_rng(seed)
    points = rng.standard_normal((5, 7, 3)).astype(np.float32)
    points[1, 2] = np.nan
    shape = (5, 7) if channels == 1 else (5, 7, channels)
    radiance = rng.random(shape).astype(np.float32)
    return PlacementScan(
        name, RangeImage(points, rng.random((5, 7)).astype(np.float32)), Texture(radiance, source)
    )


def test_placements_come_back_exactly(workspace):
    scans = (scan("links oben, ä", "white", 1, 0), scan("b", "fringes", 3, 1))
    PLACEMENTS.save(workspace, scans)
    before = (workspace / PLACEMENTS.files[0]).read_bytes()
    loaded = PLACEMENTS.load(workspace)
    for one, other in zip(scans, loaded, strict=True):
        assert one.name == other.name
        assert np.array_equal(
            one.range_image.points_mm, other.range_image.points_mm, equal_nan=True
        )
        assert np.array_equal(one.range_image.sigma_mm, other.range_image.sigma_mm)
        assert np.array_equal(one.texture.radiance, other.texture.radiance)
        assert one.texture.source == other.texture.source
    PLACEMENTS.save(workspace, loaded)
    assert (workspace / PLACEMENTS.files[0]).read_bytes() == before


def test_a_canvas_scanned_at_once_leaves_next_to_nothing(workspace):
    PLACEMENTS.save(workspace, ())
    assert PLACEMENTS.load(workspace) == ()
    assert (workspace / PLACEMENTS.files[0]).stat().st_size < 400


@pytest.mark.parametrize(
    "arrays",
    [
        {},
        {"count": np.array([17])},
        {"count": np.array([-1])},
        {"count": np.array([1])},
        {
            "count": np.array([1]),
            "name_0": np.zeros(1, np.uint8),
            "white_0": np.array([True]),
            "layers_0": np.zeros((6, 2, 2), np.float32),
        },
        {
            "count": np.array([1]),
            "name_0": np.zeros(9999, np.uint8),
            "white_0": np.array([True]),
            "layers_0": np.zeros((5, 2, 2), np.float32),
        },
    ],
)
def test_files_of_something_else_are_refused(workspace, arrays):
    write_npz(workspace / PLACEMENTS.files[0], arrays)
    with pytest.raises(ImpastoError):
        PLACEMENTS.load(workspace)
