from __future__ import annotations

import numpy as np
import pytest

from pipeline.errors import ImpastoError
from pipeline.formats.exr import write_exr
from pipeline.formats.range_image import RANGE, TEXTURE, RangeImage, Texture


@pytest.fixture
def workspace(tmp_path):
    (tmp_path / "scan").mkdir()
    return tmp_path


def test_points_come_back_exactly(workspace):
    rng = np.random.default_rng(0)
    points = rng.standard_normal((5, 7, 3)).astype(np.float32)
    sigma = rng.random((5, 7)).astype(np.float32)
    points[2, 3], sigma[2, 3] = np.nan, np.nan
    RANGE.save(workspace, RangeImage(points, sigma))
    loaded = RANGE.load(workspace)
    assert np.array_equal(loaded.points_mm, points, equal_nan=True)
    assert np.array_equal(loaded.sigma_mm, sigma, equal_nan=True)


@pytest.mark.parametrize("shape", [(4, 6), (4, 6, 3)])
@pytest.mark.parametrize("source", ["white", "fringes"])
def test_the_texture_comes_back_with_its_source(workspace, shape, source):
    radiance = np.random.default_rng(1).random(shape).astype(np.float32)
    TEXTURE.save(workspace, Texture(radiance, source))
    loaded = TEXTURE.load(workspace)
    assert np.array_equal(loaded.radiance, radiance)
    assert loaded.source == source


def test_files_of_something_else_are_refused(workspace):
    plane = np.zeros((3, 3), np.float32)
    write_exr(workspace / "scan/range.exr", {"X": plane, "Y": plane})
    with pytest.raises(ImpastoError):
        RANGE.load(workspace)
    write_exr(workspace / "scan/texture.exr", {"X": plane, "Y": plane})
    with pytest.raises(ImpastoError, match="expected Y, or R, G and B"):
        TEXTURE.load(workspace)
