from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.errors import UsageError
from renderers.adaptive import Adaptive, box_alphas
from renderers.packing import BOX, box_tops, drawn_alphas, pack_boxes
from renderers.view import orbit_view


def bump(height: float = 2.0) -> np.ndarray:
    heights = np.zeros((33, 33))
    heights[16, 16] = height
    return heights


def listed(asset, view, adaptive):
    tops = box_tops(asset)
    return pack_boxes(asset, tops, drawn_alphas(asset, tops, view, adaptive), view)


@given(
    azimuth=st.floats(0, 360),
    elevation=st.floats(5, 90),
    distance=st.floats(60, 5000),
    K=st.floats(1, 1000),
)
def test_alpha_is_the_published_formula(make_asset, azimuth, elevation, distance, K):
    asset = make_asset(bump(), d0=0.5)
    view = orbit_view(asset, azimuth_deg=azimuth, elevation_deg=elevation, distance_mm=distance)
    C = view.camera.centre_mm
    top = np.array([8.0, -8.0, 2.0])
    on_plane = C + (top - C) * (C[2] - 0.5) / (C[2] - 2.0)  # the ray C I goes on to z = d0
    r = np.linalg.norm(top - on_plane) / np.linalg.norm(C - top)
    expected = np.clip((K * r - 0.3) / (0.9 - 0.3), 0, 1)
    alpha = box_alphas(asset.boxes, 0.5, view, Adaptive(K=K, e_min=0.3, e_max=0.9))
    np.testing.assert_allclose(alpha, expected, atol=1e-5)


def test_far_and_frontal_leaves_out_what_near_or_grazing_draws(make_asset):
    asset = make_asset(bump(), d0=0.5)
    options = Adaptive(K=100.0, e_min=0.5, e_max=1.0)

    def alphas(**where):
        return box_alphas(asset.boxes, 0.5, orbit_view(asset, **where), options)

    assert (alphas(distance_mm=1000) == 0).all()
    assert (alphas(distance_mm=1000, elevation_deg=5) == 1).all()
    assert (alphas(distance_mm=60) == 1).all()
    between = alphas(distance_mm=200)
    assert ((between > 0) & (between < 1)).all()


def test_relief_at_or_above_the_camera_is_drawn(make_asset):
    asset = make_asset(bump(30.0), d0=0.5)
    view = orbit_view(asset, elevation_deg=5, distance_mm=100)
    assert view.camera.centre_mm[2] < 30
    assert (box_alphas(asset.boxes, 0.5, view, Adaptive()) == 1).all()


def test_no_boxes(make_asset):
    asset = make_asset(np.zeros((9, 9)), d0=1.0)
    view = orbit_view(asset)
    assert len(box_alphas(asset.boxes, 0.5, view, Adaptive())) == 0
    assert listed(asset, view, Adaptive()).dtype == BOX


def test_blended_boxes_follow_the_opaque_ones_from_far_to_near(make_asset):
    heights = np.zeros((33, 129))
    heights[16, 8::16] = np.linspace(0.6, 4.0, 8)
    asset = make_asset(heights, d0=0.5)
    view = orbit_view(asset, azimuth_deg=0, elevation_deg=30, distance_mm=200)
    drawn = listed(asset, view, Adaptive(K=100, e_min=0.1, e_max=2.0))
    blended = drawn["alpha"] < 1
    assert blended.any()
    assert not blended.all()
    assert (np.diff(blended.astype(int)) >= 0).all()
    centre = (drawn["low"] + drawn["high"])[blended] / 2
    assert (np.diff(np.linalg.norm(centre - view.camera.centre_mm, axis=-1)) <= 0).all()


def test_box_tops_take_in_the_shared_border(make_asset):
    heights = np.zeros((17, 33))
    heights[8, 16] = 5.0  # on the border between two cells
    asset = make_asset(heights, d0=1.0)
    np.testing.assert_array_equal(box_tops(asset), [5.0, 5.0])


@pytest.mark.parametrize(
    "arguments", [{"K": 0}, {"K": float("nan")}, {"e_min": 1.0, "e_max": 1.0}, {"e_min": -1}]
)
def test_impossible_sensitivities_are_refused(arguments):
    with pytest.raises(UsageError):
        Adaptive(**arguments)
