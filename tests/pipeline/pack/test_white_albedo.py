from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.formats.height_field import HeightField, Placement
from pipeline.geometry.camera import Camera, Lens
from pipeline.geometry.rigid import RigidTransform, rotation_about_axis
from pipeline.pack.white_albedo import (
    blended_albedo,
    fill_from_nearest,
    relative_albedo,
    scale_for,
    smooth_normals,
)

LAMP = np.array([120.0, -60.0, 20.0])


def albedo_at(x, y):
    return 0.5 + 0.3 * np.sin(x / 12) * np.cos(y / 9)


def scene(bump: float, shift: float = 0.0):
    """A Lambertian sheet 100 x 80 mm, tilted before a camera, lit from LAMP: field, picture."""
    tilt = rotation_about_axis(np.zeros(3), np.array([1.0, 1, 0]), 12)
    scan_from_canvas = (
        RigidTransform(np.diag([1.0, -1, -1]), np.array([-50.0 + shift, -40, 400])) @ tilt
    )
    rows, columns = 81, 101
    x, y = np.arange(columns), -np.arange(rows)[:, None]
    heights = (bump * np.sin(x / 8) * np.cos(y / 7)).astype(np.float32)
    field = HeightField(
        heights, np.full((rows, columns), 0.01, np.float32), np.zeros((rows, columns), bool),
        1.0, scan_from_canvas,
    )  # fmt: skip
    camera = Camera(Lens((500, 400), np.array([[1100.0, 0, 249.5], [0, 1100, 199.5], [0, 0, 1]])))
    lamp = scan_from_canvas.inverse().apply(LAMP)
    # The picture of the flat sheet, pixel by pixel.
    origin, rays = camera.rays(camera.lens.pixel_grid())
    o, d = scan_from_canvas.inverse().apply(origin), scan_from_canvas.inverse().rotate(rays)
    hit = o - d * (o[2] / d[..., 2:])
    to_lamp = lamp - hit
    r = np.linalg.norm(to_lamp, axis=-1)
    picture = albedo_at(hit[..., 0], hit[..., 1]) * to_lamp[..., 2] / r / (r / 1000) ** 2
    truth = np.broadcast_to(albedo_at(x, y), (rows, columns))
    return field, picture.astype(np.float32), camera, truth


def test_a_lambertian_sheet_loses_the_lamps_fall_off() -> None:
    field, picture, camera, truth = scene(0.0)
    found = relative_albedo(field, picture, camera, LAMP)
    assert found.shape == (*truth.shape, 3)
    assert found[..., 0] == pytest.approx(truth, rel=5e-3)
    assert np.array_equal(found[..., 0], found[..., 2])
    pixels = camera.project(field.scan_from_canvas.apply(field.canvas_points()))
    raw = picture[tuple(np.rint(pixels[..., ::-1]).astype(int).reshape(-1, 2).T)]
    ratio = raw.reshape(truth.shape) / truth
    assert ratio.max() / ratio.min() > 1.15  # so there was something to remove


def test_colour_stays_colour_and_what_is_not_seen_is_not_known() -> None:
    field, picture, camera, truth = scene(0.0)
    colour = picture[..., None] * np.array([1.0, 0.5, 0.25], np.float32)
    colour[:, :200] = np.nan
    found = relative_albedo(field, colour, camera, LAMP)
    known = np.isfinite(found).all(axis=-1)
    assert 0.4 < known.mean() < 0.9
    assert found[known][:, 1] == pytest.approx(0.5 * truth[known], rel=5e-3)


def test_pictures_of_two_placements_are_blended_to_one_exposure() -> None:
    field, left, camera, truth = scene(0.0, shift=60.0)
    other, right, _, _ = scene(0.0, shift=-60.0)
    alone = relative_albedo(field, left, camera, LAMP)
    assert 0.5 < np.isfinite(alone[..., 0]).mean() < 0.95  # neither shows the whole canvas
    whole = replace(
        field,
        placements=(
            Placement("first", field.scan_from_canvas),
            Placement("b", other.scan_from_canvas),
        ),
    )
    found = blended_albedo(whole, [left, 1.7 * right], camera, LAMP)[..., 0]
    assert found == pytest.approx(truth, rel=5e-3)


def test_pictures_that_do_not_overlap_keep_their_exposures() -> None:
    field, picture, camera, truth = scene(0.0)
    left, right = picture.copy(), 2 * picture
    left[:, 240:], right[:, :260] = np.nan, np.nan
    here = Placement("first", field.scan_from_canvas)
    found = blended_albedo(replace(field, placements=(here, here)), [left, right], camera, LAMP)
    ratio = found[..., 0] / truth
    assert ratio[:, 10] == pytest.approx(1, rel=5e-3)
    assert ratio[:, 90] == pytest.approx(2, rel=5e-3)
    assert np.isnan(ratio[40, 50])


def test_noise_of_the_heights_is_not_noise_of_the_colour() -> None:
    field, picture, camera, truth = scene(0.0)
    noisy = np.random.default_rng(0).normal(0, 0.3, truth.shape).astype(np.float32)
    rough = HeightField(noisy, np.full_like(noisy, 0.3), field.filled, 1.0, field.scan_from_canvas)
    found = relative_albedo(rough, picture, camera, LAMP)[..., 0]
    assert np.std(found / truth) < 0.06
    normals = smooth_normals(rough)
    assert np.std(normals[..., 0]) < 0.12


def test_scale() -> None:
    albedo = np.full((10, 10, 3), 4.0, np.float32)
    albedo[0, 0] = 400
    canvas = np.ones((10, 10), bool)
    assert scale_for(albedo, canvas, 90, 0.8) == pytest.approx(0.2)
    assert scale_for(np.zeros((3, 3, 3)), np.ones((3, 3), bool), 99, 0.8) == 1.0
    assert scale_for(np.full((3, 3, 3), np.nan), np.ones((3, 3), bool), 99, 0.8) == 1.0


def test_unknown_texels_take_the_nearest() -> None:
    image = np.zeros((4, 6, 3), np.float32)
    image[:, :3], image[:, 3:] = 1, 2
    image[1, 1] = image[2, 4] = np.nan
    canvas = np.ones((4, 6), bool)
    canvas[:, 5] = False
    filled, count = fill_from_nearest(image, canvas)
    assert count == 2
    assert filled[1, 1].tolist() == [1, 1, 1]
    assert filled[2, 4].tolist() == [2, 2, 2]
    assert not filled[:, 5].any()
    nothing, count = fill_from_nearest(np.full((2, 2, 3), np.nan, np.float32), canvas[:2, :2])
    assert count == 4
    assert not nothing.any()
