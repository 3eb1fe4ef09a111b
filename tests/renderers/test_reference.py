"""The exact CPU reference against closed forms: it is what everything else is held against."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.geometry.camera import Camera
from renderers.reference import reference_depth, render_reference
from renderers.view import Light, View, arc_light, orbit_view

SIZE = (96, 72)
RHO = np.array([0.9, 0.5, 0.1])


@pytest.fixture
def matte(make_asset):
    """Heights -> asset of one colour without gloss."""

    def make(heights: np.ndarray, **more):
        asset = make_asset(heights, specular=0.0, **more)
        diffuse = np.broadcast_to((RHO / np.pi).astype(np.float32), asset.diffuse.shape)
        return replace(asset, diffuse=diffuse)

    return make


def on_plane(view: View, height: float) -> np.ndarray:
    """Where the ray of every pixel meets the plane z = height, (h, w, 3) mm."""
    origin, rays = view.camera.rays(view.camera.lens.pixel_grid())
    return origin + rays * ((height - origin[2]) / rays[..., 2])[..., None]


def lambertian(points: np.ndarray, light: Light) -> np.ndarray:
    """rho/pi I cos / r^2 of a plane of constant z, r in metres."""
    to_light = light.position_mm - points
    r = np.linalg.norm(to_light, axis=-1, keepdims=True)
    return RHO / np.pi * light.intensity * light.colour * (to_light[..., 2:] / r) / (r * 1e-3) ** 2


@pytest.mark.parametrize("elevation", [90, 20])
def test_flat_lambertian_plane_under_a_near_lamp(matte, elevation):
    asset = matte(np.full((41, 61), 1.25))
    view = orbit_view(asset, azimuth_deg=-70, elevation_deg=elevation, size_px=SIZE)
    lamp = Light(np.array([10.0, -4.0, 21.0]), 2.5, np.array([1.0, 0.5, 0.25]))
    image = render_reference(asset, view, [lamp])
    points = on_plane(view, 1.25)
    inside = (points[..., 0] > 0) & (points[..., 0] < 30) & (points[..., 1] < 0)
    inside &= points[..., 1] > -20
    assert inside.sum() > 400
    np.testing.assert_array_equal(image[..., 3], inside)
    np.testing.assert_allclose(
        image[inside][:, :3], lambertian(points, lamp)[inside], rtol=1e-5, atol=0
    )
    assert (image[~inside] == 0).all()


def test_depth_of_a_plane_is_the_cameras_distance(matte):
    asset = matte(np.full((41, 61), 1.25))
    view = orbit_view(asset, distance_mm=80, size_px=SIZE)
    depth = reference_depth(asset, view)
    there = np.isfinite(depth)
    assert there[36, 48]
    np.testing.assert_allclose(depth[there], view.camera.centre_mm[2] - 1.25, rtol=1e-9)


def test_tilted_plane_takes_the_cosine_of_its_own_normal(matte):
    x = np.arange(61) * 0.5
    asset = matte(np.broadcast_to(0.75 * x, (41, 61)))  # the normal is (-0.6, 0, 0.8)
    view = orbit_view(asset, size_px=SIZE)
    lamp = Light(np.array([15.0, -10.0, 11.25]) + 1e6 * np.array([-0.6, 0, 0.8]), 1e6)
    image = render_reference(asset, view, [lamp])
    np.testing.assert_allclose(image[36, 48, :3], RHO / np.pi * 1e6 / 1e6, rtol=1e-4)
    away = replace(lamp, position_mm=lamp.position_mm * [-1, 1, 0.2])
    assert (render_reference(asset, view, [away])[..., :3] == 0).all()


@pytest.mark.parametrize("lamp_height", [30.0, 12.0])
def test_the_shadow_of_a_step_ends_at_the_analytic_place(matte, lamp_height):
    heights = np.zeros((41, 161))
    heights[:, :41] = 4.0  # the edge is at x = 20, the foot at 20.5
    asset = matte(heights)
    view = orbit_view(asset, size_px=(400, 20))
    lamp = Light(np.array([2.0, -10.0, lamp_height]), 1.0)
    image = render_reference(asset, view, [lamp])
    points = on_plane(view, 0.0)
    ground = (points[..., 0] > 21) & (image[..., 3] == 1)
    end = 20 + 4 * (20 - 2) / (lamp_height - 4)
    assert 21.5 < end < 75
    lit = image[..., 0] > 0
    np.testing.assert_array_equal(lit[ground], points[ground][:, 0] > end)
    bare = render_reference(asset, view, [lamp], shadows=False)
    assert (bare[ground][:, 0] > 0).all()
    np.testing.assert_array_equal(bare[lit], image[lit])


def test_light_goes_from_the_lamp_to_the_surface_to_the_eye_and_no_further(matte):
    """A brightly lit wall throws nothing on the ground before it, nor into its own shadow."""
    heights = np.zeros((41, 161))
    heights[:, 80:] = 10.0
    asset = matte(heights)
    view = orbit_view(asset, size_px=(320, 20))
    lamp = Light(np.array([0.0, -10.0, 40.0]), 1.0)
    image = render_reference(asset, view, [lamp])
    points = on_plane(view, 0.0)
    before = (points[..., 0] > 1) & (points[..., 0] < 38) & (image[..., 3] == 1)
    expected = lambertian(points, lamp)[before]
    np.testing.assert_allclose(image[before][:, :3], expected, rtol=1e-5)
    behind = replace(lamp, position_mm=np.array([120.0, -10.0, 15.0]))
    dark = (points[..., 0] > 25) & (points[..., 0] < 38)
    assert (render_reference(asset, view, [behind])[dark][:, :3] == 0).all()


def test_lamps_add_up(make_asset):
    rng = np.random.default_rng(2)
    asset = make_asset(rng.uniform(0, 2, (21, 31)))
    view = orbit_view(asset, elevation_deg=40, size_px=SIZE)
    lamps = [arc_light(asset, azimuth_deg=a, elevation_deg=20) for a in (10, 130, 250)]
    together = render_reference(asset, view, lamps)
    alone = sum(render_reference(asset, view, [lamp])[..., :3] for lamp in lamps)
    np.testing.assert_allclose(together[..., :3], alone, rtol=1e-5, atol=1e-6)


def test_without_light_the_painting_is_black_but_there(make_asset):
    asset = make_asset(np.zeros((21, 31)))
    image = render_reference(asset, orbit_view(asset, size_px=SIZE), [])
    assert (image[..., :3] == 0).all()
    assert image[36, 48, 3] == 1
    assert image[0, 0, 3] == 0


def test_holes_have_no_coverage_and_no_colour(matte):
    """A NaN and a sample off the mask open all patches they are a corner of, and no others."""
    heights = np.zeros((41, 61))
    heights[10, 15] = np.nan
    mask = np.ones(heights.shape, bool)
    mask[30, 40] = False
    asset = matte(np.nan_to_num(heights), mask=mask)
    asset = replace(asset, heights_mm=np.where(np.isnan(heights), np.nan, asset.heights_mm))
    view = orbit_view(asset, distance=0.9, size_px=(240, 180))
    image = render_reference(asset, view, [arc_light(asset)])
    points = on_plane(view, 0.0)
    column, row = points[..., 0] / 0.5, -points[..., 1] / 0.5
    on_canvas = (column > 0) & (column < 60) & (row > 0) & (row < 40)
    nan_hole = (np.abs(column - 15) < 1) & (np.abs(row - 10) < 1)
    mask_hole = (np.abs(column - 40) < 1) & (np.abs(row - 30) < 1)
    assert min(nan_hole.sum(), mask_hole.sum()) > 10
    np.testing.assert_array_equal(image[..., 3], on_canvas & ~nan_hole & ~mask_hole)
    assert np.isfinite(image).all()
    assert (image[image[..., 3] == 0] == 0).all()
    assert (image[image[..., 3] == 1][:, :3] > 0).all()


@pytest.mark.parametrize("shape", [(1, 1), (1, 20), (20, 1)])
@pytest.mark.parametrize("size", [(32, 24), (33, 25)])
def test_a_field_without_patches_has_no_area(make_asset, shape, size):
    asset = make_asset(np.full(shape, 0.2))
    view = orbit_view((4.0, 4.0), size_px=size)
    image = render_reference(asset, view, [arc_light((4.0, 4.0))])
    assert image.shape == (size[1], size[0], 4)
    assert np.isfinite(image).all()
    assert (image == 0).all()


def test_the_smallest_patch_is_seen(make_asset):
    asset = make_asset(np.zeros((2, 2)))
    image = render_reference(asset, orbit_view(asset, size_px=(33, 25)), [arc_light(asset)])
    assert image[12, 16, 3] == 1
    assert image[12, 16, 0] > 0


def test_an_empty_canvas_is_an_empty_picture(make_asset):
    asset = make_asset(np.zeros((9, 9)), mask=np.zeros((9, 9), bool))
    image = render_reference(asset, orbit_view((4.0, 4.0), size_px=SIZE), [arc_light((4.0, 4.0))])
    assert (image == 0).all()


def test_samples_are_the_mean_of_a_finer_picture(make_asset):
    rng = np.random.default_rng(4)
    asset = make_asset(rng.uniform(0, 2, (21, 31)))
    lights = [arc_light(asset)]
    coarse, fine = (
        orbit_view(asset, elevation_deg=30, size_px=size) for size in ((80, 60), (160, 120))
    )
    four = render_reference(asset, coarse, lights, samples=4)
    mean = render_reference(asset, fine, lights).reshape(60, 2, 80, 2, 4).mean(axis=(1, 3))
    np.testing.assert_allclose(four, mean, atol=1e-5)


def test_pictures_taller_than_one_batch_have_no_seam(matte):
    asset = matte(np.zeros((41, 61)))
    view = orbit_view(asset, distance_mm=40, size_px=(9, 300))
    lamp = arc_light(asset)
    image = render_reference(asset, view, [lamp])
    points = on_plane(view, 0.0)
    covered = image[..., 3] == 1
    np.testing.assert_allclose(image[covered][:, :3], lambertian(points, lamp)[covered], rtol=1e-5)
    assert covered[100:200].any(axis=1).all()  # the batches meet at row 128


def test_lens_distortion_bends_the_picture(matte):
    asset = matte(np.zeros((41, 61)))
    view = orbit_view(asset, size_px=SIZE)
    lens = replace(view.camera.lens, distortion=np.array([0.2, 0.0, 0, 0, 0]))
    bent = View(Camera(lens, view.camera.pose))
    lamp = arc_light(asset)
    image = render_reference(asset, bent, [lamp])
    points = on_plane(bent, 0.0)
    covered = image[..., 3] == 1
    assert (image[..., 3] != render_reference(asset, view, [lamp])[..., 3]).any()
    np.testing.assert_allclose(image[covered][:, :3], lambertian(points, lamp)[covered], rtol=1e-5)
