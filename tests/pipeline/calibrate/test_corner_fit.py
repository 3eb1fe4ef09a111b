"""Corners of known place, rendered at 16 x 16 points a pixel."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from pipeline.calibrate.corner_fit import fit_corners

FINE = 16


def corner_image(centre, angles=(0.2, 1.75), blur=0.5, size=41, tone=None):
    """Draw one corner: pixels are means over their squares of the blurred corner."""
    at = (np.arange(size * FINE) + 0.5) / FINE - 0.5
    x, y = np.meshgrid(at - centre[0], at - centre[1])
    sides = [y * np.cos(a) - x * np.sin(a) > 0 for a in angles]
    image = np.where(sides[0] == sides[1], 0.8 + 0.004 * x, 0.05).astype(np.float32)
    image = cv2.GaussianBlur(image, (0, 0), blur * FINE)
    image = image.reshape(size, FINE, size, FINE).mean(axis=(1, 3)).astype(np.float64)
    return image if tone is None else tone(image)


def fit(image, start, radius=9.0):
    found = fit_corners(image, np.array([start], float), radius)
    return found.pixels[0], found.sigma_px[0], found.blur_px[0]


@pytest.mark.parametrize("centre", [(20.0, 20.0), (20.37, 19.81), (19.55, 20.5)])
@pytest.mark.parametrize("angles", [(0.2, 1.75), (0.05, 1.1), (-0.7, 0.75), (1.2, 3.0)])
@pytest.mark.parametrize("blur", [0.35, 0.6, 1.5])
def test_finds_the_corner_to_hundredths(centre, angles, blur):
    pixels, sigma, found_blur = fit(corner_image(centre, angles, blur), (20, 20))
    np.testing.assert_allclose(pixels, centre, atol=0.012)
    assert sigma < 0.02
    # The pixel's own square widens the blur.
    assert found_blur == pytest.approx(np.hypot(blur, 12**-0.5), rel=0.12)


def test_beats_the_gradient_method_where_the_lens_is_sharp():
    ours, theirs = [], []
    for number in range(12):
        centre = 20 + 0.45 * np.array([np.cos(number), np.sin(1.7 * number)])
        image = corner_image(centre, (0.15 + 0.1 * number, 1.6 + 0.12 * number), 0.35)
        ours.append(np.linalg.norm(fit(image, (20, 20))[0] - centre))
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-4)
        start = np.array([[[20.0, 20.0]]], np.float32)
        gradient = cv2.cornerSubPix(image.astype(np.float32), start, (6, 6), (-1, -1), criteria)
        theirs.append(np.linalg.norm(gradient[0, 0] - centre))
    assert np.mean(ours) < 0.4 * np.mean(theirs)


def test_a_tone_curve_does_not_move_it():
    centre = (20.3, 19.8)
    image = corner_image(centre, (0.1, 1.3), 0.6, tone=lambda v: v ** (1 / 2.2))
    np.testing.assert_allclose(fit(image, (20, 20))[0], centre, atol=0.015)


def test_the_deviation_is_that_of_the_errors():
    rng, centre = np.random.default_rng(5), np.array([20.2, 19.9])
    clean = corner_image(centre, (0.3, 1.85), 0.8)
    normalised = []
    for _ in range(80):
        pixels, sigma, _ = fit(clean + rng.normal(0, 0.03, clean.shape), (20, 20))
        normalised.append((pixels - centre) / sigma)
    assert np.sqrt(np.mean(np.square(normalised))) == pytest.approx(1, abs=0.2)


def test_dirt_is_weighed_down():
    centre = (20.3, 19.8)
    image = corner_image(centre, (0.1, 1.6), 0.6)
    image[15:18, 22:25] = 0.4
    np.testing.assert_allclose(fit(image, (20, 20))[0], centre, atol=0.03)


def flat(image):
    return np.full_like(image, 0.5)


def one_edge(image):
    return np.where(np.arange(image.shape[1]) < 20, 0.1, 0.9) * np.ones_like(image)


def unknown(image):
    return np.where(image > 0.6, np.nan, image)


@pytest.mark.parametrize("spoil", [flat, one_edge, unknown])
def test_what_is_no_corner_is_not_found(spoil):
    pixels, sigma, _ = fit(spoil(corner_image((20, 20))), (20, 20))
    assert np.isnan(pixels).all()
    assert np.isnan(sigma)


def test_windows_that_leave_the_image_or_are_too_small_find_nothing():
    image = corner_image((20, 20))
    assert np.isnan(fit(image, (3, 20))[0]).all()
    assert np.isnan(fit(image, (20, 38))[0]).all()
    assert np.isnan(fit(image, (20, 20), radius=2.0)[0]).all()
    assert fit_corners(image, np.zeros((0, 2)), 9.0).pixels.shape == (0, 2)
