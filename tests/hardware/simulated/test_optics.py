from __future__ import annotations

import numpy as np
import pytest

from hardware.simulated.optics import (
    Sensor,
    lens_rays,
    open_eye,
    project,
    projected_image,
    reflected,
    see_by_lamp,
    see_by_projector,
    spread,
)
from hardware.simulated.subjects import Hits
from pipeline.formats.patterns import Black, Gray, Phase, Product, White, intensity
from pipeline.geometry.camera import Camera, Lens
from pipeline.geometry.rigid import RigidTransform

FACING_DOWN = np.diag([1.0, -1.0, -1.0])
RHO = 0.25


class Plate:
    """A flat, matte plate in the plane z = 0, without end."""

    def trace(self, origin_mm: np.ndarray, directions: np.ndarray) -> Hits:
        points = origin_mm - directions * (origin_mm[2] / directions[:, 2])[:, None]
        material = np.zeros((len(points), 12), np.float32)
        material[:, 2], material[:, 3:6], material[:, 9:] = 1, RHO, (-1, 1, 1)
        return Hits(points, material, np.full(len(points), 1, np.uint8))

    def lit(self, points_mm: np.ndarray, source_mm: np.ndarray) -> np.ndarray:
        return points_mm[:, 0] < 1e6


def standing_at(x: float, y: float, z: float, lens: Lens) -> Camera:
    return Camera(lens, RigidTransform(FACING_DOWN, -FACING_DOWN @ np.array([x, y, z])))


def lens(width: int, height: int, focal: float, *distortion: float) -> Lens:
    K = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1.0]])
    return Lens((width, height), K, np.array(distortion or (0.0,) * 5))


CAMERA = standing_at(10.0, -5.0, 400.0, lens(32, 24, 100.0, -0.1, 0.05, 0.001, -0.001, 0.0))
PROJECTOR = standing_at(-80.0, 20.0, 500.0, lens(64, 48, 150.0, 0.05, -0.04, 0.0003, 0.0002, 0.0))


def eye(samples: int = 1):
    return open_eye(CAMERA, lens_rays(CAMERA.lens, samples))


def test_rays_pass_through_their_pixels() -> None:
    looking = eye(1)
    points = looking.origin_mm + 300 * looking.directions
    expected = CAMERA.lens.pixel_grid().reshape(-1, 2)
    np.testing.assert_allclose(CAMERA.project(points), expected, atol=1e-9)


def test_samples_lie_evenly_in_their_pixel() -> None:
    looking = eye(2)
    pixels = CAMERA.project(looking.origin_mm + 300 * looking.directions).reshape(24, 32, 4, 2)
    np.testing.assert_allclose(
        pixels[7, 9] - [9, 7], [[-0.25, -0.25], [0.25, -0.25], [-0.25, 0.25], [0.25, 0.25]]
    )


def test_a_matte_plate_has_the_known_radiance() -> None:
    lamp = np.array([30.0, 40.0, 500.0])
    radiance = see_by_lamp(eye(1), Plate(), lamp, 2.5)
    points = Plate().trace(eye().origin_mm, eye().directions).points_mm
    away = np.linalg.norm(lamp - points, axis=1) / 1000
    expected = RHO * 2.5 * (0.5 / away) / away**2  # rho E, E = I cos / r^2
    np.testing.assert_allclose(radiance[..., 1].ravel(), expected, rtol=1e-5)


def one_hit(normal: np.ndarray, *material: float) -> Hits:
    row = np.array([[*normal, *material]], np.float32)
    return Hits(np.zeros((1, 3)), row, np.array([1], np.uint8))


def test_the_lobe_is_lafortune_s() -> None:
    v, light = np.array([0.3, -0.2, 0.8]), np.array([-0.5, 0.1, 1.2])
    rho_d, rho_s, c_xy, c_z, k = 0.1, 0.4, -0.9, 0.95, 12.0
    hits = one_hit(np.array([0, 0, 1.0]), *[rho_d] * 3, *[rho_s] * 3, c_xy, c_z, k)
    got = reflected(hits, v * 1000, light * 1000, 3.0)[0, 0]
    vn, ln = v / np.linalg.norm(v), light / np.linalg.norm(light)
    base = c_xy * (vn[0] * ln[0] + vn[1] * ln[1]) + c_z * vn[2] * ln[2]
    expected = (rho_d + rho_s * base**k) * 3.0 * ln[2] / (light @ light)
    assert got == pytest.approx(expected, rel=1e-5)


def test_reflection_turns_with_the_surface() -> None:
    tilt = np.array([[1, 0, 0], [0, 0.8, -0.6], [0, 0.6, 0.8]])
    v, light = np.array([0.3, -0.2, 0.8]) * 900, np.array([-0.5, 0.1, 1.2]) * 800
    flat = one_hit(np.array([0, 0, 1.0]), *[0.1] * 3, *[0.4] * 3, -1.0, 1.0, 30.0)
    turned = one_hit(tilt @ [0, 0, 1.0], *[0.1] * 3, *[0.4] * 3, -1.0, 1.0, 30.0)
    np.testing.assert_allclose(
        reflected(turned, tilt @ v, tilt @ light, 1.0), reflected(flat, v, light, 1.0), rtol=1e-4
    )


def test_a_mirror_direction_is_the_brightest() -> None:
    hits = one_hit(np.array([0, 0, 1.0]), *[0.0] * 3, *[1.0] * 3, -1.0, 1.0, 50.0)
    angles = np.deg2rad(np.arange(-80, 81, 5))
    light = 1000 * np.array([np.sin(0.5), 0.0, np.cos(0.5)])
    seen = [
        reflected(hits, 1000 * np.array([np.sin(a), 0.0, np.cos(a)]), light, 1.0)[0, 0]
        for a in angles
    ]
    assert np.degrees(angles[int(np.argmax(seen))]) == pytest.approx(-np.degrees(0.5), abs=5)


def test_light_from_behind_gives_nothing() -> None:
    hits = one_hit(np.array([0, 0, 1.0]), *[0.1] * 3, *[0.4] * 3, -1.0, 1.0, 30.0)
    assert not reflected(hits, np.array([0, 0, 9.0]), np.array([5.0, 0, -1.0]), 1.0).any()


def test_each_ray_s_projector_pixel_is_its_point_s_projection() -> None:
    projection = project(eye(), Plate(), PROJECTOR, 1.0, 0.0)
    points = Plate().trace(eye().origin_mm, eye().directions).points_mm
    np.testing.assert_allclose(projection.place_px, PROJECTOR.project(points), atol=1e-4)


def test_a_pattern_is_seen_where_it_falls() -> None:
    projection = project(eye(), Plate(), PROJECTOR, 1.0, 0.0)
    pattern = Phase(axis="x", period_px=40.0, step=1, steps=4)
    image = projected_image(pattern, (64, 48), gamma=1.0, defocus_px=0.0, black=0.0)
    got = see_by_projector(projection, image).ravel()
    x, y = projection.place_px.T.astype(float)
    expected = projection.light * intensity(pattern, x, y)
    # Linear interpolation between pixels of a period of 40 px: at most (pi / 40)^2 / 4.
    np.testing.assert_allclose(got, expected, atol=projection.light.max() * 0.0016)


def test_only_the_projector_s_field_is_lit() -> None:
    far = standing_at(-80.0, 20.0, 500.0, lens(8, 6, 600.0))
    projection = project(eye(), Plate(), far, 1.0, 0.01)
    place = projection.place_px
    outside = (place < -0.5).any(axis=1) | (place > [7.5, 5.5]).any(axis=1)
    assert outside.any()
    assert not projection.light[outside].any()
    assert projection.dark == pytest.approx(RHO * np.pi * 0.01, rel=1e-5)


def test_without_a_pattern_only_the_room_s_light_is_seen() -> None:
    projection = project(eye(2), Plate(), PROJECTOR, 1.0, 0.02)
    assert see_by_projector(projection, None) == pytest.approx(RHO * np.pi * 0.02, rel=1e-5)


@pytest.mark.parametrize("pattern", [Gray(axis="y", bit=2, bits=4, cell_px=3), White(), Black()])
def test_projected_light_follows_gamma_and_black_level(pattern: Gray | White | Black) -> None:
    image = projected_image(pattern, (64, 48), gamma=2.2, defocus_px=0.0, black=0.01)
    assert image.shape == (48, 64)
    drive = intensity(pattern, np.arange(64)[None], np.arange(48)[:, None])
    np.testing.assert_allclose(image, 0.01 + 0.99 * drive**2.2, rtol=1e-6)


def test_a_product_of_patterns_varies_both_ways() -> None:
    pattern = Product(
        of=(Gray(axis="x", bit=0, bits=1, cell_px=32), Gray(axis="y", bit=0, bits=1, cell_px=24))
    )
    image = projected_image(pattern, (64, 48), gamma=1.0, defocus_px=0.0, black=0.0)
    np.testing.assert_array_equal(
        image, intensity(pattern, np.arange(64)[None], np.arange(48)[:, None])
    )


def test_defocus_keeps_light_and_softens_edges() -> None:
    sharp, soft = (
        projected_image(
            Gray(axis="x", bit=0, bits=1, cell_px=32), (64, 48), gamma=1.0, defocus_px=d, black=0.0
        )
        for d in (0.0, 1.5)
    )
    assert soft.mean() == pytest.approx(sharp.mean(), rel=1e-5)
    assert 0.2 < soft[0, 32] < 0.8
    # The profile is that of a Gaussian of this width.
    slope = np.diff(soft[20])
    place = np.arange(63) + 0.5
    assert np.average((place - 31.5) ** 2, weights=slope) == pytest.approx(1.5**2, rel=0.05)


def test_point_spread_keeps_light() -> None:
    image = np.zeros((21, 21), np.float32)
    image[10, 10] = 1
    blurred = spread(image, 0.8)
    assert blurred.sum() == pytest.approx(1, rel=1e-5)
    rows = np.arange(21) - 10
    assert (blurred.sum(axis=1) * rows**2).sum() == pytest.approx(0.64, rel=0.05)
    assert spread(image, 0.0) is image


def test_noise_has_the_variance_of_photons_and_reading() -> None:
    sensor = Sensor(responsivity_per_s=50.0, full_well_e=10000.0, read_noise_e=6.0, bits=16)
    for level in (0.01, 0.2, 0.6):
        radiance = np.full((400, 500), level / 50.0, np.float32)
        image = sensor.record(radiance, 1.0, np.random.default_rng(1))
        electrons = image / 65535 * 10000
        assert electrons.mean() == pytest.approx(level * 10000, rel=2e-3)
        assert electrons.var() == pytest.approx(level * 10000 + 36, rel=0.02)


def test_the_ideal_sensor_is_linear_until_it_saturates() -> None:
    sensor = Sensor(responsivity_per_s=10.0)
    radiance = np.array([[0.0, 0.01, 0.05, 0.1, 0.2]], np.float32)
    image = sensor.record(radiance, 1.0, None)
    assert image.tolist() == [[0, 6554, 32768, 65535, 65535]]
    assert image.dtype == np.uint16


def test_stored_values_are_the_converter_s() -> None:
    sensor = Sensor(bits=3)
    image = sensor.record(
        np.linspace(0, 0.03, 500, dtype=np.float32)[None], 1.0, np.random.default_rng(0)
    )
    assert set(np.unique(image)) <= {round(i * 65535 / 7) for i in range(8)}
    assert image.max() == 65535
