"""Texels looked up in a photograph: radiometry, borders, occlusion."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pipeline.formats.capture import Photo
from pipeline.geometry.camera import Camera, Lens
from pipeline.geometry.raycast import RayCaster
from pipeline.geometry.rigid import RigidTransform
from pipeline.reflectance.sampling import (
    drop_occluded,
    may_be_blocked,
    sample_photo,
    steepest_slope,
)
from pipeline.reflectance.stations import Station

SPACING = 0.5
UP = np.array([0.0, 0.0, 1.0], np.float32)


def station(light: tuple[float, float, float], intensity: float = 3.0) -> Station:
    lens = Lens((201, 161), np.array([[2000.0, 0, 100], [0, 2000, 80], [0, 0, 1]]))
    pose = RigidTransform(np.diag([1.0, -1.0, -1.0]), np.array([-10.0, -8.0, 1000.0]))
    photo = Photo(file="p.png", camera="C")
    return Station(photo, Camera(lens, pose), np.array(light), intensity, True)


def grid(heights: NDArray[np.float64]) -> NDArray[np.float64]:
    rows, columns = heights.shape
    x, y = np.meshgrid(np.arange(columns) * SPACING, -np.arange(rows) * SPACING)
    return np.stack([x, y, heights], axis=-1)


def test_a_lambertian_plane_gives_its_reflectance_everywhere() -> None:
    points = grid(np.zeros((33, 41)))
    normals = np.broadcast_to(UP, points.shape).astype(np.float32)
    place = station((60.0, 40.0, 500.0))
    # The image of a plane of reflectance 0.2 under that lamp, pixel by pixel.
    origin, rays = place.camera.rays(place.camera.lens.pixel_grid())
    hit = origin + rays * (-origin[2] / rays[..., 2])[..., None]
    way = place.light_mm - hit
    r2 = (way**2).sum(axis=-1)
    image = 0.2 * place.intensity * way[..., 2] / np.sqrt(r2) / (r2 * 1e-6)
    samples = sample_photo(
        np.repeat(image[..., None], 3, axis=2).astype(np.float32), place, points, normals
    )
    np.testing.assert_allclose(samples, 0.2, rtol=1e-4)


def test_texels_outside_the_picture_or_behind_the_light_are_missing() -> None:
    points = grid(np.zeros((3, 3)))
    normals = np.broadcast_to(UP, points.shape).astype(np.float32)
    image = np.ones((161, 201, 3), np.float32)
    assert np.isnan(sample_photo(image, station((0, 0, -500.0)), points, normals)).all()
    far = points + np.array([5000.0, 0, 0])
    assert np.isnan(sample_photo(image, station((0, 0, 500.0)), far, normals)).all()
    behind = points + np.array([0, 0, 3000.0])
    assert np.isnan(sample_photo(image, station((0, 0, 9000.0)), behind, normals)).all()
    missing = points.copy()
    missing[1, 1] = np.nan
    samples = sample_photo(image, station((0, 0, 500.0)), missing, normals)
    assert np.isnan(samples[1, 1]).all()
    assert np.isfinite(samples[0, 0]).all()


def test_an_invalid_pixel_spreads_no_further_than_its_neighbours() -> None:
    points = grid(np.zeros((33, 41)))
    normals = np.broadcast_to(UP, points.shape).astype(np.float32)
    image = np.ones((161, 201, 3), np.float32)
    image[80, 100] = np.nan
    missing = np.isnan(sample_photo(image, station((10, -8, 600.0)), points, normals)[..., 0])
    assert missing[16, 20]
    assert np.count_nonzero(missing) <= 9


def test_a_wall_shades_the_ground_behind_it() -> None:
    heights = np.zeros((21, 41))
    heights[:, 20] = 2.0
    points = grid(heights)
    samples = np.ones((21, 41, 3), np.float32)
    light = np.array([-1000.0, -5.0, 1000.0])  # from the left, 45 degrees
    count = drop_occluded(samples, points, light, RayCaster(heights, SPACING), 0.01)
    shaded = np.isnan(samples[10, :, 0])
    assert count == np.count_nonzero(np.isnan(samples[..., 0]))
    assert not shaded[:20].any()
    assert shaded[21:24].all()  # 2 mm high: a shadow of 2 mm, four samples
    assert not shaded[26:].any()


def test_the_steepest_slope_bounds_every_pair_of_samples() -> None:
    heights = np.random.default_rng(0).normal(size=(12, 9))
    slope = steepest_slope(heights, SPACING)
    points = grid(heights).reshape(-1, 3)
    run = np.hypot(*(points[:, None, :2] - points[None, :, :2]).transpose(2, 0, 1))
    rise = np.abs(points[:, None, 2] - points[None, :, 2])
    assert np.all(rise <= slope * run + 1e-9)
    assert steepest_slope(np.zeros((4, 4)), SPACING) == 0.0
    assert steepest_slope(np.zeros((1, 1)), SPACING) == 0.0
    assert steepest_slope(np.array([[0.0, np.nan], [0.0, 0.0]]), SPACING) == np.inf


@pytest.mark.parametrize(("height", "blocked"), [(1000.0, False), (20.0, True)])
def test_lights_above_the_steepest_slope_need_no_test(height: float, blocked: bool) -> None:
    points = grid(np.zeros((5, 5)))
    assert may_be_blocked(points, np.array([100.0, 0.0, height]), 0.5) is blocked
    assert may_be_blocked(points, np.array([0.0, 0.0, 1e6]), float("inf")) is True
