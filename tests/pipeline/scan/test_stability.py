"""Scaled, moved away, with a narrow baseline, in ever more noise: errors grow as sigma says."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.errors import ImpastoError
from pipeline.geometry.camera import Camera, Lens
from pipeline.geometry.rigid import RigidTransform, rotation_about_axis
from pipeline.scan.points import measure
from pipeline.structured_light.coordinates import ProjectorCoordinates
from pipeline.structured_light.decode import decode_sequence
from pipeline.structured_light.triangulate import triangulate


def decoded(made, noise_px=0.02, seed=1):
    """Coordinates with noise, without images."""
    rng = np.random.default_rng(seed)
    seen = made.projector.project(made.points)
    seen = (seen + noise_px * rng.standard_normal(seen.shape)).astype(np.float32)
    sigma = np.full(seen.shape[:2], max(noise_px, 1e-4), np.float32)
    radiance = np.ones(seen.shape[:2], np.float32)
    return ProjectorCoordinates(
        seen[..., 0], seen[..., 1], sigma, sigma.copy(), radiance, "white", {}
    )


def scaled(made, factor):
    pose = made.projector.pose
    return made.camera, Camera(
        made.projector.lens, RigidTransform(pose.rotation, factor * pose.translation_mm)
    )


@pytest.mark.parametrize("factor", [1e-3, 1.0, 1e3])
def test_everything_scales(rig, factor):
    made = rig()
    coordinates = decoded(made)
    plain = measure(coordinates, *scaled(made, 1.0))
    other = measure(coordinates, *scaled(made, factor))
    np.testing.assert_allclose(other.points_mm, factor * plain.points_mm, rtol=2e-6)
    np.testing.assert_allclose(other.sigma_mm, factor * plain.sigma_mm, rtol=1e-4)


@pytest.mark.parametrize("away_mm", [0.0, 1e3, 1e6])
def test_a_frame_far_away_costs_what_sigma_says(rig, away_mm):
    made = rig()
    move = RigidTransform(np.eye(3), np.array([away_mm, -away_mm, 0.5 * away_mm]))
    camera = Camera(made.camera.lens, made.camera.pose @ move.inverse())
    projector = Camera(made.projector.lens, made.projector.pose @ move.inverse())
    measured = measure(decoded(made, 0.005), camera, projector)
    apart = measured.points_mm.astype(np.float64) - move.apply(made.points)
    along = (apart * made.rays).sum(axis=-1) / np.linalg.norm(made.rays, axis=-1)
    normalised = along / measured.sigma_mm
    assert np.sqrt(np.nanmean(normalised**2)) == pytest.approx(1, abs=0.25)
    assert np.isfinite(along).mean() > 0.99


@pytest.mark.parametrize("angle_deg", [2.0, 5.0, 16.0])
def test_a_narrow_baseline_is_less_certain_and_says_so(rig, angle_deg):
    made = rig()
    distance = 900.0
    turn = rotation_about_axis(np.zeros(3), np.array([0.0, 1.0, 0.0]), angle_deg)
    place = np.array([-distance * np.sin(np.radians(angle_deg)), 0.0, 0.0])
    made.projector = Camera(made.projector.lens, RigidTransform(turn.rotation, place))
    measured = measure(decoded(made), made.camera, made.projector)
    along = measured.points_mm[..., 2] - made.depth
    normalised = np.nanstd(along / measured.sigma_mm)
    assert normalised == pytest.approx(1, abs=0.25)
    expected = 0.02 / 640 * distance / np.sin(np.radians(angle_deg))
    assert np.nanmedian(measured.sigma_mm) == pytest.approx(expected, rel=0.3)


def test_noise_until_failure_is_told(rig):
    made, errors = rig(), []
    for electrons in (20000, 2000, 400, 100, 20):
        bundle = made.bundle(made.patterns())
        rng = np.random.default_rng(5)
        for name, image in bundle.images.items():
            value = image / 65535 * electrons
            noisy = rng.poisson(value) + 4 * rng.standard_normal(value.shape)
            bundle.images[name] = np.clip(np.rint(noisy / electrons * 65535), 0, 65535).astype(
                np.uint16
            )
        camera = bundle.capture.cameras["C0"].model_copy(update={"full_well_e": electrons})
        bundle.capture.cameras["C0"] = camera
        try:
            coordinates = decode_sequence(bundle, bundle.sequences("scan")[0])
        except ImpastoError:
            break  # "no pixel shows the patterns"
        measured = measure(coordinates, made.camera, made.projector)
        off = measured.points_mm[..., 2] - made.depth
        known = np.isfinite(off)
        if known.mean() < 0.02:
            break  # it says that it measured nothing
        errors.append(float(np.median(np.abs(off[known]))))
        normalised = off[known] / measured.sigma_mm[known]
        assert 1.4826 * np.median(np.abs(normalised)) < 1.4, electrons
        assert np.mean(np.abs(normalised) > 6) < 0.02, electrons
    assert len(errors) >= 3
    assert errors == sorted(errors)


@settings(max_examples=60, deadline=None)
@given(st.floats(300, 5000), st.floats(0.03, 0.6), st.floats(-8, 8), st.floats(1e-3, 1e3))
def test_a_plane_is_found_by_any_rig(depth, spread, tilt_deg, scale):
    size, projector_size = (8, 6), (256, 192)
    bent = np.array([-0.1, 0.05, 0.001, -0.001, 0.01])
    K = np.array([[40.0, 0, 3.5], [0, 41.0, 2.5], [0, 0, 1]])
    camera = Camera(Lens(size, K, bent))
    turn = rotation_about_axis(
        np.zeros(3), np.array([0.02, 1.0, 0.0]), np.degrees(np.arctan(spread)) + tilt_deg
    )
    place = scale * turn.apply(np.array([-spread * depth, 0.05 * depth, 0.02 * depth]))
    K = np.array([[300.0, 0, 127.0], [0, 302.0, 95.0], [0, 0, 1]])
    projector = Camera(Lens(projector_size, K, -0.5 * bent), RigidTransform(turn.rotation, place))
    points = camera.lens.directions(camera.lens.pixel_grid()) * (scale * depth)
    seen = projector.project(points)
    sigma = np.full(size[::-1], 0.02)
    found = triangulate(
        ProjectorCoordinates(seen[..., 0], seen[..., 1], sigma, sigma, sigma, "white", {}),
        camera,
        projector,
    )
    np.testing.assert_allclose(found.depth_mm, scale * depth, rtol=1e-9)
    assert (found.sigma_mm > 0).all()
