from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.errors import UsageError
from renderers.view import arc_light, canvas_corners, direction, orbit_view


@pytest.mark.parametrize(
    ("azimuth", "elevation", "expected"),
    [
        (0, 0, [1, 0, 0]),
        (90, 0, [0, 1, 0]),
        (180, 0, [-1, 0, 0]),
        (33, 90, [0, 0, 1]),
        (-90, 45, [0, -(0.5**0.5), 0.5**0.5]),
    ],
)
def test_azimuth_turns_from_right_to_top_and_elevation_rises_from_the_canvas(
    azimuth, elevation, expected
):
    np.testing.assert_allclose(direction(azimuth, elevation), expected, atol=1e-15)


def test_frontal_picture_is_upright():
    view = orbit_view((200.0, 100.0), size_px=(400, 300))
    top_left, bottom_right = view.camera.project(np.array([[0, 0, 0], [200, -100, 0]], float))
    assert top_left[0] < bottom_right[0]
    assert top_left[1] < bottom_right[1]
    centre = view.camera.project(np.array([100.0, -50.0, 0.0]))
    np.testing.assert_allclose(centre, [199.5, 149.5], atol=1e-9)


@given(
    azimuth=st.floats(-360, 360),
    elevation=st.floats(1, 90),
    width=st.floats(10, 1000),
    height=st.floats(10, 1000),
    size=st.tuples(st.integers(16, 2000), st.integers(16, 2000)),
    fov=st.floats(1, 120),
)
def test_framed_view_holds_the_whole_canvas_and_touches_the_margin(
    azimuth, elevation, width, height, size, fov
):
    view = orbit_view(
        (width, height),
        azimuth_deg=azimuth,
        elevation_deg=elevation,
        size_px=size,
        field_of_view_deg=fov,
    )
    camera = view.camera
    corners = canvas_corners((width, height))
    assert (camera.depth(corners) > 0).all()
    half = np.array(size) / 2
    reach = np.abs(camera.project(corners) - (half - 0.5)) / half
    assert reach.max() <= 1.0
    np.testing.assert_allclose(camera.pose.rotation @ camera.pose.rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(camera.pose.rotation) > 0


def test_distance_in_framings_and_in_mm():
    framed = orbit_view((200.0, 100.0), elevation_deg=40)
    far = orbit_view((200.0, 100.0), elevation_deg=40, distance=3)
    given_mm = orbit_view((200.0, 100.0), elevation_deg=40, distance_mm=777)
    centre = np.array([100.0, -50.0, 0.0])

    def away(view):
        return np.linalg.norm(view.camera.centre_mm - centre)

    assert away(far) == pytest.approx(3 * away(framed))
    assert away(given_mm) == pytest.approx(777)


def test_relief_counts_in_the_framing(make_asset):
    heights = np.zeros((40, 60))
    heights[20, 30] = 30.0
    view = orbit_view(make_asset(heights, spacing=1.0), elevation_deg=30, size_px=(200, 200))
    peak = view.camera.project(np.array([30.0, -20.0, 30.0]))
    assert (peak >= -0.5).all()
    assert (peak <= 199.5).all()


def test_vertical_field_of_view_spans_the_outer_edges_of_the_pixels():
    view = orbit_view((10.0, 10.0), field_of_view_deg=60, size_px=(100, 80))
    ray = view.camera.lens.directions(np.array([49.5, -0.5]))
    assert np.degrees(np.arctan2(-ray[1], ray[2])) == pytest.approx(30)


def test_arc_light_stands_where_it_is_told():
    light = arc_light((200.0, 100.0), azimuth_deg=180, elevation_deg=30, distance_mm=500)
    expected = [100 - 500 * np.cos(np.pi / 6), -50, 250]
    np.testing.assert_allclose(light.position_mm, expected, atol=1e-9)


@pytest.mark.parametrize(
    "arguments",
    [
        {"elevation_deg": 0},
        {"elevation_deg": 91},
        {"elevation_deg": float("nan")},
        {"field_of_view_deg": 0},
        {"field_of_view_deg": 180},
        {"distance": 0},
        {"distance": float("nan")},
        {"distance_mm": -5},
        {"distance_mm": float("inf")},
        {"size_px": (0, 10)},
    ],
)
def test_impossible_views_are_refused(arguments):
    with pytest.raises(UsageError, match="expected"):
        orbit_view((10.0, 10.0), **arguments)


@pytest.mark.parametrize(
    "arguments", [{"elevation_deg": -1}, {"distance_mm": 0}, {"intensity": -1}]
)
def test_impossible_lamps_are_refused(arguments):
    with pytest.raises(UsageError, match="expected"):
        arc_light((10.0, 10.0), **arguments)


def test_camera_nearly_along_the_canvas_y_axis_has_a_pose():
    view = orbit_view((10.0, 10.0), azimuth_deg=90, elevation_deg=1e-12, distance_mm=100)
    assert np.isfinite(view.camera.pose.matrix).all()
