from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.errors import ImpastoError
from pipeline.geometry.camera import Camera, Lens
from pipeline.geometry.rigid import RigidTransform, rotation_about_axis
from pipeline.structured_light.coordinates import ProjectorCoordinates
from pipeline.structured_light.triangulate import triangulate

SIZE = (64, 48)


def lens(focal, size, distortion=(0.0,) * 5):
    K = np.array([[focal, 0.0, size[0] / 2 + 1.3], [0, 1.01 * focal, size[1] / 2 - 0.7], [0, 0, 1]])
    return Lens(size, K, np.array(distortion))


def rig(baseline_mm=(300.0, 40.0, 30.0), distorted=True, pose=None):
    bent = (-0.12, 0.1, 0.0006, -0.0004, 0.02) if distorted else (0.0,) * 5
    pose = RigidTransform() if pose is None else pose
    camera = Camera(lens(160, SIZE, bent), pose)
    turn = rotation_about_axis(np.zeros(3), np.array([0.05, 1.0, 0.02]), 17.0).rotation
    relative = RigidTransform(turn, np.array(baseline_mm))
    projector = Camera(lens(400, (256, 192), tuple(-0.8 * d for d in bent)), relative @ pose)
    return camera, projector


def seen(camera, projector, normal=(0.1, -0.2, -1.0), distance=900.0):
    """Points of a plane in the camera's frame, and the projector's pixels that light them."""
    rays = camera.lens.directions(camera.lens.pixel_grid())
    normal = np.array(normal)
    depth = normal[2] * distance / (rays @ normal)
    points = camera.pose.inverse().apply(rays * depth[..., None])
    return points, projector.project(points)


def coordinates(pixels, sigma=(0.02, 0.02), axes="xy"):
    images = {}
    for i, axis in enumerate("xy"):
        known = axis in axes
        images[axis] = pixels[..., i].astype(np.float32) if known else None
        spread = np.full(pixels.shape[:2], sigma[i], np.float32)
        images[f"sigma_{axis}"] = spread if known else None
    light = np.ones(pixels.shape[:2], np.float32)
    return ProjectorCoordinates(**images, radiance=light, radiance_source="white", statistics={})


@pytest.mark.parametrize("axes", ["x", "xy"])
@pytest.mark.parametrize("distorted", [False, True])
def test_a_plane_is_found_exactly_through_distorted_lenses(axes, distorted):
    pose = RigidTransform(
        rotation_about_axis(np.zeros(3), np.array([1.0, 0.2, 0.0]), 160.0).rotation,
        np.array([10.0, -20.0, 950.0]),
    )
    camera, projector = rig(distorted=distorted, pose=pose)
    points, pixels = seen(camera, projector)
    found = triangulate(coordinates(pixels, axes=axes), camera, projector)
    # float32 coordinates of 256 px are known to 1e-5 px, about 0.03 um here.
    assert np.nanmax(np.abs(found.points_mm - points)) < 1e-3
    assert np.isfinite(found.depth_mm).all()
    if axes == "xy":
        assert np.nanmax(np.abs(found.across_px)) < 1e-3
    else:
        assert np.isnan(found.across_px).all()


@pytest.mark.parametrize(("axes", "sigma"), [("x", (0.05, 0.05)), ("xy", (0.05, 0.2))])
def test_sigma_is_the_standard_deviation_along_the_ray(axes, sigma):
    camera, projector = rig(baseline_mm=(250.0, 180.0, 10.0))
    points, pixels = seen(camera, projector)
    rng = np.random.default_rng(1)
    errors = []
    for _ in range(4):
        noisy = pixels + rng.standard_normal(pixels.shape) * np.array(sigma)
        found = triangulate(coordinates(noisy, sigma, axes), camera, projector)
        along = found.points_mm - points
        signed = np.linalg.norm(along, axis=-1) * np.sign((along * points).sum(-1))
        errors.append(signed / found.sigma_mm)
    assert np.mean(np.square(errors)) == pytest.approx(1.0, abs=0.05)
    assert abs(np.mean(errors)) < 0.05


def test_the_residual_across_the_epipolar_line_is_the_error_across():
    camera, projector = rig()
    _, pixels = seen(camera, projector)
    found = triangulate(coordinates(pixels), camera, projector)
    moved = pixels + 0.7 * found.across
    again = triangulate(coordinates(moved), camera, projector)
    assert np.allclose(again.across_px, 0.7, atol=2e-3)
    assert np.allclose(again.depth_mm, found.depth_mm, rtol=1e-5)


def test_a_missing_axis_of_a_pixel_leaves_the_other():
    camera, projector = rig()
    points, pixels = seen(camera, projector)
    pixels[10, 10, 1] = np.nan
    pixels[11, 11, :] = np.nan
    found = triangulate(coordinates(pixels), camera, projector)
    assert np.allclose(found.points_mm[10, 10], points[10, 10], atol=1e-3)
    assert np.isnan(found.across_px[10, 10])
    assert np.isnan(found.points_mm[11, 11]).all()


def test_an_axis_along_the_baseline_is_refused():
    lens_c, lens_p = lens(160, SIZE), lens(400, (256, 192))
    camera = Camera(lens_c)
    above = Camera(lens_p, RigidTransform(np.eye(3), np.array([0.0, 300.0, 0.0])))
    _, pixels = seen(camera, above, normal=(0.0, 0.0, -1.0))
    with pytest.raises(ImpastoError, match="axis, x, lies along the baseline"):
        triangulate(coordinates(pixels, axes="x"), camera, above)
    both = triangulate(coordinates(pixels), camera, above)
    alone = triangulate(coordinates(pixels, axes="y"), camera, above)
    assert np.allclose(both.depth_mm, 900.0, rtol=1e-5)
    assert np.allclose(both.sigma_mm, alone.sigma_mm, rtol=1e-3)


def test_points_behind_the_devices_are_none():
    camera, projector = rig()
    _, pixels = seen(camera, projector, distance=-900.0)
    found = triangulate(coordinates(pixels, axes="x"), camera, projector)
    assert np.isnan(found.depth_mm).all()


def test_images_of_another_size():
    camera, projector = rig()
    with pytest.raises(ImpastoError, match="expected 64 x 48 px"):
        triangulate(coordinates(np.zeros((10, 10, 2))), camera, projector)


@settings(max_examples=20, deadline=None)
@given(st.floats(-3, 3))
def test_lengths_scale(power):
    scale = 10.0**power
    camera, projector = rig()
    big = Camera(
        projector.lens,
        RigidTransform(projector.pose.rotation, projector.pose.translation_mm * scale),
    )
    points, pixels = seen(camera, projector)
    found = triangulate(coordinates(pixels), camera, big)
    assert np.allclose(found.points_mm / scale, points, rtol=1e-4)
