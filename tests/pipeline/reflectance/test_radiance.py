"""Photographs to radiance: exposure, darks, flats, saturation."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pipeline.formats.bundle import Bundle
from pipeline.formats.capture import Capture, Correction
from pipeline.reflectance.radiance import closest, grow_by_one, radiance, relative_flat


class MemoryBundle(Bundle):
    """A bundle whose images are in memory."""

    def __init__(self, images: dict[str, NDArray[np.float32]], **document: Any) -> None:
        super().__init__(
            Path("nowhere"),
            Capture.model_validate(
                {
                    "format": "impasto-capture",
                    "version": 1,
                    "name": "memory",
                    "encoding": "linear",
                    **document,
                }
            ),
        )
        self.images = images

    def read(self, file: str) -> NDArray[np.float32]:
        return self.images[file]


CAMERAS = {
    "C1": {"size_px": [4, 3], "responsivity_per_s": 50.0},
    "C2": {"size_px": [4, 3], "lens_of": "C1"},
    "C3": {"size_px": [4, 3]},
}
PHOTO = {"file": "p", "camera": "C1", "light": "L", "exposure_s": 0.1}


def test_exposure_and_responsivity_are_divided_out() -> None:
    image = np.full((3, 4, 3), 0.5, np.float32)
    bundle = MemoryBundle({"p": image}, cameras=CAMERAS, photos=[PHOTO])
    np.testing.assert_allclose(radiance(bundle, bundle.capture.photos[0]), 0.1, rtol=1e-6)


def test_a_dark_is_subtracted_and_a_flat_divided_out() -> None:
    vignette = np.linspace(0.4, 0.8, 4, dtype=np.float32)[None, :].repeat(3, axis=0)
    image = (0.5 * vignette / 0.8 + 0.01).astype(np.float32)
    bundle = MemoryBundle(
        {"p": image, "dark": np.full((3, 4), 0.01, np.float32), "flat": vignette},
        cameras=CAMERAS,
        photos=[PHOTO],
        darks=[{"file": "dark", "camera": "C1"}],
        flats=[{"file": "flat", "camera": "C1"}],
    )
    result = radiance(bundle, bundle.capture.photos[0])
    assert result.shape == (3, 4, 3)
    np.testing.assert_allclose(result, 0.1, rtol=0.01)


def test_saturated_pixels_and_their_neighbours_are_missing() -> None:
    image = np.full((3, 5, 3), 0.2, np.float32)
    image[1, 1, 2] = 1.0
    bundle = MemoryBundle({"p": image}, cameras=CAMERAS, photos=[PHOTO])
    missing = np.isnan(radiance(bundle, bundle.capture.photos[0]))
    assert missing[:, :3].all()
    assert not missing[:, 3:].any()


def test_the_nearest_exposure_of_the_same_body_is_chosen() -> None:
    bundle = MemoryBundle({}, cameras=CAMERAS, photos=[{**PHOTO, "camera": "C2"}])
    photo = bundle.capture.photos[0]
    darks = tuple(
        Correction(file=name, camera=camera, exposure_s=exposure)
        for name, camera, exposure in (("a", "C1", 0.5), ("b", "C1", 0.08), ("c", "C3", 0.1))
    )
    chosen = closest(bundle.capture, darks, photo)
    assert chosen is not None
    assert chosen.file == "b"
    assert closest(bundle.capture, darks[2:], photo) is None


def test_what_a_flat_does_not_reach_is_missing() -> None:
    flat = np.ones((10, 10, 3), np.float32)
    flat[0, 0] = 0.001
    relative = relative_flat(flat)
    assert np.isnan(relative[0, 0]).all()
    assert np.isfinite(relative[1:]).all()


@pytest.mark.parametrize("shape", [(1, 1), (1, 4), (5, 5)])
def test_a_mask_grows_by_one_pixel(shape: tuple[int, int]) -> None:
    mask = np.zeros(shape, bool)
    mask[0, 0] = True
    grown = grow_by_one(mask)
    expected = np.zeros(shape, bool)
    expected[:2, :2] = True
    np.testing.assert_array_equal(grown, expected)
