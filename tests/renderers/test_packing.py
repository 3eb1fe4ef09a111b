from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import renderers
from renderers import packing
from renderers.view import Light, arc_light, orbit_view

WGSL = Path(renderers.__file__).parent


@pytest.mark.parametrize("shape", [(2, 2), (9, 20), (33, 17)])
def test_bounds_hold_what_their_cells_hold(make_asset, shape):
    rng = np.random.default_rng(1)
    mask = rng.random(shape) < 0.9
    asset = make_asset(rng.normal(size=shape), mask=mask)
    bounds, levels = packing.pack_bounds(asset)
    assert bounds.dtype == np.float32
    assert levels.dtype == np.uint32
    assert np.isfinite(bounds).all()
    known = np.where(mask, asset.heights_mm, np.nan)
    corners = np.stack([known[:-1, :-1], known[1:, :-1], known[:-1, 1:], known[1:, 1:]])
    whole = np.isfinite(corners).all(axis=0)
    for level in range(1, len(levels)):
        first, columns = (int(n) for n in levels[level])
        for row, column in np.argwhere(whole):
            cell = bounds[first + (row >> level) * columns + (column >> level)]
            assert cell[1] <= corners[:, row, column].min()
            assert corners[:, row, column].max() <= cell[0]
    assert levels[-1].tolist() == [len(bounds) - 1, 1]  # the last is one cell: everything
    if whole.any():
        assert bounds[-1, 0] == corners[:, whole].max()
        assert bounds[-1, 1] == corners[:, whole].min()


def test_cells_without_surface_are_never_entered(make_asset):
    asset = make_asset(np.zeros((9, 9)), mask=np.zeros((9, 9), bool))
    bounds, _ = packing.pack_bounds(asset)
    assert (bounds[:, 0] < -1e20).all()
    assert (bounds[:, 1] > 1e20).all()


@pytest.mark.parametrize(("record", "name"), [("FRAME", "Frame"), ("LAMP", "Lamp"), ("BOX", "Box")])
def test_records_have_the_fields_of_the_wgsl_in_order(record, name):
    source = "".join((WGSL / f).read_text() for f in ("painting.wgsl", "shading.wgsl"))
    body = re.search(rf"struct {name} \{{(.*?)\n\}}", source, re.DOTALL)[1]
    fields = re.findall(r"^\s*(\w+):", body, re.MULTILINE)
    dtype = getattr(packing, record)
    assert [n for n in dtype.names if not n.startswith("padding")] == fields
    assert dtype.itemsize % 16 == 0
    for field in fields:
        kind, offset = dtype.fields[field][0], dtype.fields[field][1]
        if kind.shape:  # vec3f and mat4x4f stand at multiples of 16, vec2f of 8
            assert offset % (8 if kind.shape == (2,) else 16) == 0


def test_projection_puts_points_where_the_camera_does(make_asset):
    asset = make_asset(np.zeros((21, 31)))
    view = orbit_view(asset, azimuth_deg=20, elevation_deg=30, size_px=(90, 70))
    frame = packing.pack_frame(asset, view, (0.25, -0.125), 0, shadows=False)
    points = np.random.default_rng(0).uniform([0, -10, -1], [15, 0, 1], (50, 3))
    clip = np.c_[points, np.ones(50)] @ frame["clip_from_canvas"].astype(float)
    ndc = clip[:, :3] / clip[:, 3:]
    pixel = np.stack([(ndc[:, 0] + 1) * 45, (1 - ndc[:, 1]) * 35], axis=-1) - 0.5
    expected = view.camera.project(points) - [0.25, -0.125]
    np.testing.assert_allclose(pixel, expected, atol=1e-3)
    np.testing.assert_allclose(clip[:, 3], view.camera.depth(points), rtol=1e-5)
    np.testing.assert_allclose(ndc[:, 2], packing.NEAR_MM / clip[:, 3], rtol=1e-6)
    ray = pixel[:, :1] * frame["ray_column"] + pixel[:, 1:] * frame["ray_row"] + frame["ray_first"]
    back = frame["camera"] + clip[:, 3:] * ray
    np.testing.assert_allclose(back, points, atol=2e-3)


def test_lamps_scale_by_a_power_of_two_to_at_most_one(make_asset):
    asset = make_asset(np.zeros((21, 31)))
    lights = [arc_light(asset, intensity=5e7), Light(np.array([0.0, 0.0, 2.0]), 3e-9)]
    lamps, scale = packing.pack_lamps(asset, lights)
    assert np.log2(scale) == np.rint(np.log2(scale))
    assert lamps["radiant_intensity"].max() * scale == pytest.approx(5e13)
    assert packing.pack_lamps(asset, [])[1] == 1.0
    assert packing.pack_lamps(asset, [arc_light(asset, intensity=0)])[1] == 1.0


def test_one_box_around_the_whole_field(make_asset):
    heights = np.zeros((21, 31))
    heights[3, 4] = 2.5
    heights[5, 6] = -1.5
    (box,) = packing.pack_whole_box(make_asset(heights, spacing=2.0))
    np.testing.assert_allclose(box["low"], [0, -40, -1.502], atol=1e-5)
    np.testing.assert_allclose(box["high"], [60, 0, 2.502], atol=1e-5)


def test_boxes_whose_surface_lies_below_d0_are_left_out(make_asset):
    heights = np.zeros((33, 33))
    heights[4, 4] = 1.0
    asset = make_asset(heights, d0=0.5, cell=16)
    view = orbit_view(asset)
    for top, expected in ((1.0, 1.0), (0.5, 0.0), (-np.inf, 0.0)):
        assert packing.drawn_alphas(asset, np.array([top]), view, None) == [expected]


def test_opaque_patches_are_those_of_opaque_boxes(make_asset):
    heights = np.zeros((17, 33))
    heights[4, 4] = heights[4, 25] = 1.0
    asset = make_asset(heights, d0=0.5, cell=16)
    marked = packing.opaque_patches(asset, np.array([1.0, 0.7], np.float32))
    expected = np.zeros((17, 33), np.uint8)
    expected[:16, :16] = 255
    np.testing.assert_array_equal(marked, expected)
    marked = packing.opaque_patches(asset, np.array([0.0, 1.0], np.float32))
    np.testing.assert_array_equal(marked, np.roll(expected, 16, axis=1))
