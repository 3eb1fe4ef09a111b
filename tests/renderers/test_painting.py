"""The GPU painter against analytic radiance and against the exact CPU reference.

Away from silhouettes and shadow edges, where one pixel sees either of two things, the two must
agree; ``calm`` picks those pixels: the reference's 3 x 3 neighbourhood spans less than a tenth of
the picture's brightest value and is covered throughout.
"""

from __future__ import annotations

import time

import numpy as np
import pytest
from scipy import ndimage

from pipeline.errors import UsageError
from renderers import pipelines
from renderers.adapter import Adapter, GpuUnavailable, open_adapter
from renderers.adaptive import Adaptive
from renderers.painting import METHODS, Painting, PaintOptions
from renderers.reference import render_reference
from renderers.view import Light, arc_light, orbit_view

pytestmark = pytest.mark.gpu

SIZE = (160, 120)
PLAIN = PaintOptions(shadows=False)
EVERY_BOX = PaintOptions(adaptive=None)


@pytest.fixture(scope="module")
def adapter() -> Adapter:
    return open_adapter()


def strokes(rows: int = 97, columns: int = 129, spacing: float = 0.5) -> np.ndarray:
    """Ridged strokes of 1 to 3 mm on a gently waving ground."""
    rng = np.random.default_rng(3)
    y, x = np.mgrid[:rows, :columns] * spacing
    heights = 0.2 * np.sin(x / 7) * np.cos(y / 9)
    for _ in range(12):
        cx, cy = rng.uniform(5, columns * spacing - 5), rng.uniform(5, rows * spacing - 5)
        a = rng.uniform(0, np.pi)
        u = (x - cx) * np.cos(a) + (y - cy) * np.sin(a)
        v = -(x - cx) * np.sin(a) + (y - cy) * np.cos(a)
        heights += rng.uniform(1, 2) * np.exp(-((u / 8) ** 4) - (v / 3) ** 2)
    return heights


def calm(reference: np.ndarray) -> np.ndarray:
    radiance = reference[..., :3].max(axis=-1)
    span = ndimage.maximum_filter(radiance, 3) - ndimage.minimum_filter(radiance, 3)
    return (span < 0.1 * radiance.max()) & (ndimage.minimum_filter(reference[..., 3], 3) == 1)


def psnr(image: np.ndarray, reference: np.ndarray) -> float:
    error = np.mean((image[..., :3].astype(float) - reference[..., :3]) ** 2)
    return float(10 * np.log10(float(reference[..., :3].max()) ** 2 / error))


def analytic_plane(asset, view, lights, height: float) -> np.ndarray:
    """Radiance of a flat field at ``height``, shaded at the centre of every pixel."""
    origin, rays = view.camera.rays(view.camera.lens.pixel_grid())
    point = origin + rays * ((height - origin[2]) / rays[..., 2])[..., None]
    column, row = point[..., 0] / asset.spacing_mm, -point[..., 1] / asset.spacing_mm
    rows, columns = asset.heights_mm.shape
    inside = (column >= 0) & (column <= columns - 1) & (row >= 0) & (row <= rows - 1)
    places = [row.ravel(), column.ravel()]

    def at(image: np.ndarray) -> np.ndarray:
        channels = [
            ndimage.map_coordinates(image[..., i].astype(float), places, order=1, mode="nearest")
            for i in range(3)
        ]
        return np.stack(channels, axis=-1).reshape(point.shape)

    v = (origin - point) / np.linalg.norm(origin - point, axis=-1, keepdims=True)
    radiance = np.zeros(point.shape)
    for light in lights:
        towards = light.position_mm - point
        r = np.linalg.norm(towards, axis=-1, keepdims=True)
        lv = towards / r
        lobe = at(asset.lobe)
        base = (
            lobe[..., 0] * (v[..., :2] * lv[..., :2]).sum(-1)
            + lobe[..., 1] * v[..., 2] * lv[..., 2]
        )
        f = (
            at(asset.diffuse)
            + at(asset.specular) * (np.maximum(base, 0) ** lobe[..., 2])[..., None]
        )
        radiance += f * light.intensity * light.colour * lv[..., 2:] / (r * 1e-3) ** 2
    return np.concatenate([radiance, np.ones_like(v[..., :1])], axis=-1) * inside[..., None]


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("elevation", [90, 25])
def test_flat_field_has_the_analytic_radiance(make_asset, adapter, method, elevation):
    asset = make_asset(np.full((41, 61), 1.0), d0=0.0 if method == "hybrid" else 1.0)
    view = orbit_view(asset, elevation_deg=elevation, size_px=SIZE)
    lights = [
        arc_light(asset, azimuth_deg=90, elevation_deg=40, distance_mm=300),
        Light(np.array([-50.0, 10.0, 80.0]), 0.7, np.array([1.0, 0.5, 0.2])),
    ]
    image = Painting(asset, adapter).draw(view, lights, method, EVERY_BOX)
    expected = analytic_plane(asset, view, lights, 1.0)
    # hybrid: where the box covers the plane below it; the plane stays visible at its rim.
    inner = ndimage.minimum_filter(expected[..., 3], 5) == 1
    assert np.count_nonzero(inner) > 2000
    np.testing.assert_allclose(image[inner], expected[inner], rtol=1e-3, atol=1e-4)
    if method != "hybrid":
        assert np.count_nonzero((image[..., 3] > 0) != (expected[..., 3] > 0)) <= 20


def test_bump_on_a_flat_field_equals_the_reference(make_asset, adapter):
    asset = make_asset(np.zeros((41, 61)))
    view = orbit_view(asset, elevation_deg=35, azimuth_deg=20, size_px=SIZE)
    lights = [arc_light(asset)]
    image = Painting(asset, adapter).draw(view, lights, "bump")
    reference = render_reference(asset, view, lights)
    inner = ndimage.minimum_filter(reference[..., 3], 3) == 1
    np.testing.assert_allclose(image[inner], reference[inner], rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("method", ["relief", "mesh", "hybrid"])
@pytest.mark.parametrize(("azimuth", "elevation"), [(-90, 90), (-90, 25), (30, 15)])
def test_methods_agree_with_the_reference(make_asset, adapter, method, azimuth, elevation):
    heights = strokes()
    # hybrid: the whole field above d0, so that all of it is relief and none is approximated
    asset = make_asset(heights, d0=float(heights.min()) - 0.01)
    view = orbit_view(asset, azimuth_deg=azimuth, elevation_deg=elevation, size_px=SIZE)
    lights = [arc_light(asset, azimuth_deg=160, elevation_deg=35)]
    image = Painting(asset, adapter).draw(view, lights, method, EVERY_BOX)
    reference = render_reference(asset, view, lights)
    assert np.isfinite(image).all()
    away = calm(reference)
    error = np.abs(image - reference)[away][:, :3] / reference[..., :3].max()
    assert np.count_nonzero(away) > 500
    assert np.percentile(error, 99) < 1e-3
    assert psnr(image[away], reference[away]) > 60
    covered = (image[..., 3] > 0.5) == (reference[..., 3] > 0.5)
    assert covered.mean() > 0.99


@pytest.mark.parametrize("method", ["relief", "hybrid"])
def test_all_relief_in_raking_light_is_drawn_in_bounded_time(make_asset, adapter, method):
    """Boxes as tall as the canvas is wide, long shadows: the work must not grow with the way."""
    rows, columns = 301, 401
    y, x = np.mgrid[:rows, :columns] * 0.5
    rng = np.random.default_rng(7)
    heights = 30 * np.sin(x / 19) * np.cos(y / 23) + rng.normal(0, 0.2, x.shape)
    asset = make_asset(heights, d0=float(heights.min()) - 0.01, cell=16)
    view = orbit_view(asset, elevation_deg=15)  # 1280 x 720
    lights = [arc_light(asset, azimuth_deg=180, elevation_deg=8)]
    painting = Painting(asset, adapter)
    painting.draw(orbit_view(asset, size_px=(16, 16)), lights, method, EVERY_BOX)  # compiles
    start = time.perf_counter()
    image = painting.draw(view, lights, method, EVERY_BOX)
    elapsed_s = time.perf_counter() - start
    reference = render_reference(asset, view, lights)
    error = np.abs(image - reference)[..., :3].max(axis=-1) / reference[..., :3].max()
    there = reference[..., 3] == 1
    shadowed = there & (reference[..., :3] == 0).all(axis=-1)
    assert 0.2 < shadowed.sum() / there.sum() < 0.95
    assert (error > 1e-2).mean() < 2e-3  # silhouettes and shadow edges, where rounding decides
    assert np.percentile(error[there & ~shadowed], 95) < 1e-4
    assert ((image[..., 3] > 0.5) == there).mean() > 0.9999
    assert elapsed_s < 10  # on a software adapter and a busy machine


def test_thin_walls_are_met_however_far_the_ray_has_come(make_asset, adapter):
    """One row of samples stands up; rays along the canvas cross it in a small part of a texel."""
    heights = np.zeros((65, 257))
    heights[:, 128] = 4.0
    asset = make_asset(heights, d0=-0.01, cell=16, specular=0.0)
    view = orbit_view(asset, azimuth_deg=180, elevation_deg=8, size_px=SIZE)
    lights = [arc_light(asset, azimuth_deg=180, elevation_deg=40)]
    reference = render_reference(asset, view, lights)
    for method in ("relief", "hybrid"):
        image = Painting(asset, adapter).draw(view, lights, method, EVERY_BOX)
        different = np.abs(image - reference).max(axis=-1) > 0.01 * reference[..., :3].max()
        assert different.sum() <= 10


def test_hybrid_leaves_no_hole_and_no_seam_between_boxes(make_asset, adapter):
    heights = strokes()
    asset = make_asset(heights, d0=0.5, cell=8)
    view = orbit_view(asset, elevation_deg=12, azimuth_deg=-60, size_px=(256, 192))
    lights = [arc_light(asset, azimuth_deg=100, elevation_deg=60)]
    painting = Painting(asset, adapter)
    small = painting.draw(view, lights, "hybrid", PaintOptions(adaptive=None, shadows=False))
    large_cells = Painting(make_asset(heights, d0=0.5, cell=200), adapter)
    whole = large_cells.draw(view, lights, "hybrid", PaintOptions(adaptive=None, shadows=False))
    holes = ndimage.binary_fill_holes(small[..., 3] > 0) & (small[..., 3] == 0)
    assert not holes.any()
    different = np.abs(small - whole).max(axis=-1) > 0.02 * whole[..., :3].max()
    assert different.mean() < 0.002


def test_lamp_on_the_left_brightens_slopes_that_face_left(make_asset, adapter):
    x = np.arange(129)
    ridge = np.broadcast_to(4 - np.abs(x - 64) / 16, (97, 129))
    asset = make_asset(ridge, d0=-1, specular=0.0)
    view = orbit_view(asset, size_px=SIZE)
    left = arc_light(asset, azimuth_deg=180, elevation_deg=30)
    painting = Painting(asset, adapter)
    for method in METHODS:
        image = painting.draw(view, [left], method, PLAIN)
        assert image[60, 60, 0] > 1.2 * image[60, 99, 0]


def test_lamp_at_the_top_brightens_slopes_that_face_up(make_asset, adapter):
    row = np.arange(97)[:, None]
    ridge = np.broadcast_to(4 - np.abs(row - 48) / 12, (97, 129))
    asset = make_asset(ridge, d0=-1, specular=0.0)
    view = orbit_view(asset, size_px=SIZE)
    top = arc_light(asset, azimuth_deg=90, elevation_deg=30)
    for method in METHODS:
        image = Painting(asset, adapter).draw(view, [top], method, PLAIN)
        assert image[35, 50, 0] > 1.2 * image[85, 50, 0]


def test_a_wall_throws_a_shadow_of_the_right_length(make_asset, adapter):
    heights = np.zeros((61, 121))
    heights[:, 30:32] = 5.0
    asset = make_asset(heights, d0=0.1, spacing=0.5, specular=0.0)
    view = orbit_view(asset, size_px=(240, 120))
    far = Light(np.array([15.5, -15.0, 0]) + 1e5 * np.array([-1.0, 0, 1]), 1e4)  # 45 degrees
    image = Painting(asset, adapter).draw(view, [far], "hybrid", EVERY_BOX)
    dark = image[60, :, 0] < 1e-6
    points = np.stack([np.linspace(0, 60, 400), np.full(400, -15.0), np.zeros(400)], axis=-1)
    columns = np.rint(view.camera.project(points)[:, 0]).astype(int)
    shadowed = dark[columns]
    # The wall's top ends at x = 15.5, its foot at 16, its shadow at 20.5; a pixel is 0.3 mm.
    assert shadowed[(points[:, 0] > 16.5) & (points[:, 0] < 20.3)].all()
    assert not shadowed[(points[:, 0] > 20.7) & (points[:, 0] < 59)].any()
    assert not shadowed[(points[:, 0] > 1) & (points[:, 0] < 14)].any()


@pytest.mark.parametrize("method", METHODS)
def test_holes_of_the_mask_stay_empty(make_asset, adapter, method):
    mask = np.ones((49, 65), bool)
    mask[20:30, 25:40] = False
    asset = make_asset(np.full(mask.shape, 0.5), mask=mask, d0=0.0 if method == "hybrid" else 0.5)
    view = orbit_view(asset, size_px=SIZE)
    image = Painting(asset, adapter).draw(view, [arc_light(asset)], method, EVERY_BOX)
    hole, canvas = view.camera.project(np.array([[16.0, -12.5, 0.5], [5.0, -5.0, 0.5]])).round()
    assert (image[int(hole[1]), int(hole[0])] == 0).all()
    assert image[int(canvas[1]), int(canvas[0]), 3] == 1
    edge = view.camera.project(np.array([[12.3, -12.5, 0.5], [19.7, -12.5, 0.5]]))[:, 0].round()
    row = image[int(hole[1]), :, 3]
    assert (row[int(edge[0]) : int(edge[1]) + 1] == 0).all()


@pytest.mark.parametrize("method", METHODS)
def test_an_empty_canvas_is_an_empty_picture(make_asset, adapter, method):
    asset = make_asset(np.zeros((9, 9)), mask=np.zeros((9, 9), bool), d0=1.0)
    view = orbit_view((4.0, 4.0), size_px=(32, 24))
    image = Painting(asset, adapter).draw(view, [arc_light((4.0, 4.0))], method)
    assert (image == 0).all()


@pytest.mark.parametrize("shape", [(1, 1), (1, 20), (20, 1), (2, 2)])
@pytest.mark.parametrize("method", METHODS)
def test_tiny_fields(make_asset, adapter, shape, method):
    asset = make_asset(np.full(shape, 0.2))
    view = orbit_view((1.0, 1.0), size_px=(32, 24), target_mm=np.array([0.25, -0.25, 0]))
    image = Painting(asset, adapter).draw(view, [arc_light((10.0, 10.0))], method, EVERY_BOX)
    assert image.shape == (24, 32, 4)
    assert np.isfinite(image).all()
    assert image[..., 3].any() == (min(shape) > 1)


def test_without_light_the_painting_is_black_but_there(make_asset, adapter):
    asset = make_asset(strokes())
    image = Painting(asset, adapter).draw(orbit_view(asset, size_px=SIZE), [])
    assert (image[..., :3] == 0).all()
    assert image[60, 80, 3] == 1


def test_adaptive_hybrid_is_bump_when_far_and_frontal_and_relief_when_grazing(make_asset, adapter):
    asset = make_asset(strokes(), d0=0.5)
    painting = Painting(asset, adapter)
    lights = [arc_light(asset)]
    options = PaintOptions(adaptive=Adaptive(K=60, e_min=0.8, e_max=2.0))

    def three(**where):
        view = orbit_view(asset, size_px=SIZE, **where)
        return (
            painting.draw(view, lights, "hybrid", options),
            painting.draw(view, lights, "bump", options),
            painting.draw(view, lights, "hybrid", EVERY_BOX),
        )

    adaptive, bump, relief = three(distance=5, field_of_view_deg=5)
    np.testing.assert_array_equal(adaptive, bump)
    adaptive, bump, relief = three(elevation_deg=6)
    assert np.abs(relief - bump).max() > 0.05
    np.testing.assert_allclose(adaptive, relief, atol=2e-3 * relief.max())


def test_alpha_between_blends_relief_over_the_plane(make_asset, adapter):
    heights = np.zeros((33, 33))
    heights[8:25, 8:25] = 2.0
    asset = make_asset(heights, d0=0.5, cell=64)  # one box
    assert len(asset.boxes) == 1
    painting = Painting(asset, adapter)
    lights = [arc_light(asset)]
    view = orbit_view(asset, elevation_deg=40, size_px=SIZE)
    C_z = view.camera.centre_mm[2]
    half = Adaptive(K=(C_z - 2.0) / 1.5, e_min=0.75, e_max=1.25 + 1e-6)  # K r = 1, alpha = 0.5
    bump = painting.draw(view, lights, "bump")
    relief = painting.draw(view, lights, "hybrid", EVERY_BOX)
    blend = painting.draw(view, lights, "hybrid", PaintOptions(adaptive=half))
    np.testing.assert_allclose(blend, (bump + relief) / 2, rtol=2e-3, atol=1e-3)


def test_supersampling_is_the_mean_of_shifted_pictures(make_asset, adapter):
    asset = make_asset(strokes())
    view = orbit_view(asset, elevation_deg=30, size_px=(80, 60))
    lights = [arc_light(asset)]
    painting = Painting(asset, adapter)
    fine = orbit_view(asset, elevation_deg=30, size_px=(160, 120))
    four = painting.draw(view, lights, "relief", PaintOptions(samples=4))
    doubled = painting.draw(fine, lights, "relief")
    mean = doubled.reshape(60, 2, 80, 2, 4).mean(axis=(1, 3))
    assert np.percentile(np.abs(four - mean), 99) < 1e-3


def test_huge_and_tiny_lamps_only_scale_the_picture(make_asset, adapter):
    asset = make_asset(strokes(), d0=0.5)
    view = orbit_view(asset, elevation_deg=30, size_px=SIZE)
    painting = Painting(asset, adapter)
    blended = PaintOptions(adaptive=Adaptive(e_min=0.5, e_max=500.0))  # float16 picture
    one = painting.draw(view, [arc_light(asset, intensity=1.0)], "hybrid", blended)
    for factor in (2.0**-30, 2.0**30):
        lamp = arc_light(asset, intensity=factor)
        image = painting.draw(view, [lamp], "hybrid", blended)
        np.testing.assert_allclose(image[..., :3] / factor, one[..., :3], rtol=1e-6)


@pytest.mark.parametrize("method", METHODS)
def test_same_frame_same_bytes(make_asset, adapter, method):
    asset = make_asset(strokes(), d0=0.5)
    view = orbit_view(asset, elevation_deg=20, size_px=SIZE)
    first, second = (
        Painting(asset, adapter).draw(view, [arc_light(asset)], method) for _ in range(2)
    )
    assert first.tobytes() == second.tobytes()


def test_camera_inside_a_box_still_sees_the_relief(make_asset, adapter):
    heights = np.zeros((65, 65))
    heights[:10] = 20.0  # a high wall at the top makes the boxes there high
    heights[40:42] = 3.0
    asset = make_asset(heights, d0=0.5, cell=64)
    view = orbit_view(asset, elevation_deg=25, distance_mm=14, size_px=SIZE)
    assert view.camera.centre_mm[2] < 20
    lights = [arc_light(asset, elevation_deg=70)]
    painting = Painting(asset, adapter)
    image = painting.draw(view, lights, "relief", PLAIN)
    reference = render_reference(asset, view, lights, shadows=False)
    away = calm(reference)
    assert psnr(image[away], reference[away]) > 40


def test_a_shader_that_does_not_compile_says_so(adapter, monkeypatch):
    import wgpu

    source = pipelines.shader_source()
    monkeypatch.setattr(pipelines, "shader_source", lambda: source + "\nfn broken( {")
    pipelines.painting_pipelines.cache_clear()
    with pytest.raises(wgpu.GPUError, match="broken"):
        pipelines.painting_pipelines(adapter, False)


def test_what_the_adapter_cannot_hold_is_refused(make_asset, adapter):
    asset = make_asset(np.zeros((9, 9)))
    view = orbit_view(asset, size_px=(adapter.largest_texture + 1, 1))
    with pytest.raises(GpuUnavailable, match="picture is"):
        Painting(asset, adapter).draw(view, [])


def test_lens_distortion_is_left_to_the_reference(make_asset, adapter):
    from dataclasses import replace

    asset = make_asset(np.zeros((9, 9)))
    view = orbit_view(asset, size_px=(16, 16))
    lens = replace(view.camera.lens, distortion=np.array([0.1, 0, 0, 0, 0]))
    bent = replace(view, camera=replace(view.camera, lens=lens))
    with pytest.raises(GpuUnavailable, match="distortion"):
        Painting(asset, adapter).draw(bent, [])


@pytest.mark.parametrize("samples", [0, -4, 2, 3, 257, 289])
def test_samples_must_fill_a_grid(samples):
    with pytest.raises(UsageError, match="square"):
        PaintOptions(samples=samples)


@pytest.mark.parametrize("method", ["hybrid", "relief"])
def test_nothing_is_seen_beyond_a_ragged_edge(make_asset, adapter, method):
    """Rays that pass under an open edge must meet neither walls, nor the plane, nor the rim."""
    rng = np.random.default_rng(5)
    heights = strokes() + rng.normal(0, 0.05, (97, 129))
    mask = ndimage.gaussian_filter(rng.normal(size=heights.shape), 3) > -0.15
    mask[:9] = mask[:, :5] = mask[-7:] = mask[:, -8:] = False
    asset = make_asset(heights, mask=mask, d0=float(heights.min()) - 0.01, cell=8)
    view = orbit_view(asset, azimuth_deg=-60, elevation_deg=15, size_px=(240, 180))
    lights = [arc_light(asset)]
    image = Painting(asset, adapter).draw(view, lights, method, EVERY_BOX)
    reference = render_reference(asset, view, lights)
    seen, there = image[..., 3] > 0.5, reference[..., 3] > 0.5
    assert np.count_nonzero(seen & ~there) <= 2
    assert np.count_nonzero(there & ~seen) < 0.02 * np.count_nonzero(there)
