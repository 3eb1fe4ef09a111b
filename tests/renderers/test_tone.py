from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.errors import ImpastoError, UsageError
from pipeline.formats.exr import read_exr
from renderers import tone


def grey(value: float, coverage: float = 1.0, size: int = 4) -> np.ndarray:
    image = np.full((size, size, 4), value, np.float32)
    image[..., 3] = coverage
    return image


@pytest.mark.parametrize(
    ("linear", "encoded"),
    [(0.0, 0.0), (1.0, 1.0), (0.0031308, 0.04045), (0.2140411, 0.5), (-1.0, 0.0), (7.0, 1.0)],
)
def test_srgb_known_values(linear, encoded):
    assert float(tone.encode_srgb(np.array(linear))) == pytest.approx(encoded, abs=2e-6)


@given(st.floats(0, 1))
def test_srgb_round_trip(value):
    back = float(tone.decode_srgb(tone.encode_srgb(np.array(value))))
    assert back == pytest.approx(value, abs=1e-6)


def test_automatic_exposure_takes_the_99th_percentile_of_covered_pixels_to_09():
    image = grey(0.0, 0.0, 20)
    image[:10, :, :3] = np.linspace(1, 3, 200).reshape(10, 20, 1)
    image[:10, :, 3] = 1
    image[15, 15, :3] = 1000  # not covered: no say
    factor = tone.automatic_exposure(image)
    assert factor * np.percentile(np.linspace(1, 3, 200), 99) == pytest.approx(0.9, rel=1e-5)


@pytest.mark.parametrize("image", [grey(0.0, 0.0), grey(0.0, 1.0)])
def test_empty_and_black_pictures_have_exposure_one(image):
    assert tone.automatic_exposure(image) == 1.0


def test_display_levels():
    assert (tone.to_display(grey(0.5), exposure=2.0) == 255).all()
    assert (tone.to_display(grey(0.2158605), exposure=1.0) == 128).all()
    assert (tone.to_display(grey(0.5), exposure=2.0, bits=16) == 65535).all()
    assert (tone.to_display(grey(0.0, 0.0), background=1.0) == 255).all()


def test_bright_edges_do_not_spill_into_the_background():
    half = grey(50.0, 0.5)  # premultiplied, far over-exposed
    shown = tone.decode_srgb(tone.to_display(half, exposure=1.0, background=0.0) / 255)
    np.testing.assert_allclose(shown, 0.5, atol=0.005)


def test_only_8_and_16_bits():
    with pytest.raises(UsageError, match="8 or 16"):
        tone.to_display(grey(1.0), bits=12)


@pytest.mark.parametrize(("bits", "kind"), [(8, np.uint8), (16, np.uint16)])
def test_png_holds_the_display_values(tmp_path, bits, kind):
    image = grey(0.3)
    image[0, :, 0] = 0.9  # red: the order of the channels shows
    tone.write_image(tmp_path / "a.png", image, exposure=1.0, bits=bits)
    read = cv2.imread(str(tmp_path / "a.png"), cv2.IMREAD_UNCHANGED)[..., ::-1]
    assert read.dtype == kind
    np.testing.assert_array_equal(read, tone.to_display(image, exposure=1.0, bits=bits))


def test_exr_holds_linear_radiance_and_coverage(tmp_path):
    image = np.random.default_rng(0).uniform(0, 50, (5, 7, 4)).astype(np.float32)
    tone.write_image(tmp_path / "new" / "a.exr", image, exposure=3.0)
    read = read_exr(tmp_path / "new" / "a.exr", ["R", "G", "B", "A"])
    np.testing.assert_array_equal(np.stack([read[n] for n in "RGBA"], axis=-1), image)


def test_same_picture_same_bytes(tmp_path):
    for name in ("a.png", "b.png", "a.exr", "b.exr"):
        tone.write_image(tmp_path / name, grey(0.3))
    for suffix in ("png", "exr"):
        a, b = (tmp_path / f"{stem}.{suffix}" for stem in "ab")
        assert a.read_bytes() == b.read_bytes()


def test_other_types_and_unwritable_places_are_refused(tmp_path):
    with pytest.raises(UsageError, match=r"\.png or \.exr"):
        tone.write_image(tmp_path / "a.jpg", grey(1.0))
    (tmp_path / "file").write_text("")
    with pytest.raises(ImpastoError, match="cannot be written"):
        tone.write_image(tmp_path / "file" / "a.png", grey(1.0))
