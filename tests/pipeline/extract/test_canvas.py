"""Finding canvases: with frames higher and lower, strokes, holes, tilt, deep relief, noise."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.errors import ImpastoError
from pipeline.extract.canvas import find_canvas, ray_factor


def shares(scene, found) -> tuple[float, float]:
    """Return the share of the canvas that was kept, and the share of what was kept that is not."""
    mask = found.region.mask
    return float(mask[scene.on_canvas].mean()), float((~scene.on_canvas)[mask].mean())


def turn(scene, found) -> tuple[float, float]:
    """Return the angles (degrees) between the normals, and in the plane."""
    relative = (scene.scan_from_truth.inverse() @ found.scene_from_canvas).rotation
    return (
        float(np.rad2deg(np.arccos(min(1.0, relative[2, 2])))),
        float(np.rad2deg(np.arctan2(relative[1, 0], relative[0, 0]))),
    )


@pytest.mark.parametrize("relief", ["flat", "impasto"])
@pytest.mark.parametrize("frame", [20.0, 8.0, 3.0, -6.0, None])
def test_frames_are_cut_off(make_scene, reliefs, relief, frame) -> None:
    scene = make_scene(reliefs[relief], frame=frame)
    found = find_canvas(scene.points, scene.sigma, scene.camera, 2)
    kept, wrong = shares(scene, found)
    assert kept > 0.985
    assert wrong < 0.002
    normal, angle = turn(scene, found)
    assert normal < 0.1
    assert abs(angle) < 0.1


@pytest.mark.parametrize(
    "options",
    [
        {"tilt_deg": (30, -20)},
        {"tilt_deg": (0, 50)},
        {"tilt_deg": (45, 0), "frame": -8.0},
        {"noise": 0.3},
        {"holes": 300},
        {"shift_mm": (40, 25)},
        {"pixels": (120, 100)},
        {"noise": 0.0},
    ],
    ids=str,
)
def test_strokes_neither_stop_nor_tear_it(make_scene, reliefs, options) -> None:
    scene = make_scene(reliefs["impasto"], **options)
    found = find_canvas(scene.points, scene.sigma, scene.camera, 2)
    kept, wrong = shares(scene, found)
    assert kept > 0.98
    assert wrong < 0.003
    assert turn(scene, found)[0] < 0.1


@pytest.mark.parametrize("floor", [False, True])
def test_deep_relief_is_kept_whole(make_scene, reliefs, floor) -> None:
    scene = make_scene(reliefs["deep"], frame=None, floor=floor)
    found = find_canvas(scene.points, scene.sigma, scene.camera, 2)
    kept, wrong = shares(scene, found)
    assert kept > 0.98
    assert wrong < 0.003
    heights = found.points[:, 2]
    assert np.percentile(heights, 99.5) - np.percentile(heights, 0.5) > 50


@pytest.mark.parametrize("roll", [3.0, -40.0, 90.0, 180.0])
def test_the_canvas_comes_out_straight(make_scene, reliefs, roll) -> None:
    """The sides lie along the axes, and up is the side that was nearest to the picture's up."""
    scene = make_scene(reliefs["impasto"], roll_deg=roll)
    found = find_canvas(scene.points, scene.sigma, scene.camera, 2)
    _, angle = turn(scene, found)
    quarter = round((angle) / 90) * 90
    assert angle - quarter == pytest.approx(0, abs=0.15)
    up = scene.camera.pose.rotate(found.scene_from_canvas.rotation[:, 1])
    assert up @ np.array([0, -1, 0]) > np.cos(np.deg2rad(46))


def test_not_straightened_it_hangs_as_it_hung(make_scene) -> None:
    scene = make_scene(roll_deg=10)
    found = find_canvas(scene.points, scene.sigma, scene.camera, 2, straighten=False)
    assert found.skew_deg == pytest.approx(10, abs=0.1)
    assert turn(scene, found)[1] == pytest.approx(-10, abs=0.1)


def test_a_hole_through_the_canvas_stays_one(make_scene) -> None:
    scene = make_scene(hole_mm=30.0)
    found = find_canvas(scene.points, scene.sigma, scene.camera, 2)
    truth = scene.truth_points
    bottom = np.hypot(truth[..., 0] - 20, truth[..., 1] + 10) < 13
    assert not found.region.mask[bottom].any()
    assert shares(scene, found)[0] > 0.99


def test_spikes_are_left_out(make_scene) -> None:
    scene = make_scene()
    rng = np.random.default_rng(3)
    where = np.argwhere(scene.on_canvas)
    spikes = where[rng.choice(len(where), 60, replace=False)]
    away = scene.points - scene.camera.centre_mm
    points = scene.points.copy()
    points[tuple(spikes.T)] -= 0.004 * away[tuple(spikes.T)]
    found = find_canvas(points, scene.sigma, scene.camera, 2)
    assert found.region.mask[tuple(spikes.T)].mean() < 0.1
    assert shares(scene, found)[0] > 0.985


def test_the_same_at_another_scale(make_scene, reliefs) -> None:
    scene = make_scene(reliefs["impasto"])
    found = find_canvas(scene.points, scene.sigma, scene.camera, 2)
    for scale in (1e-3, 1e3):
        pose = type(scene.camera.pose)(
            scene.camera.pose.rotation, scene.camera.pose.translation_mm * scale
        )
        camera = type(scene.camera)(scene.camera.lens, pose)
        other = find_canvas(scene.points * scale, scene.sigma * scale, camera, 2)
        assert (other.region.mask == found.region.mask).mean() > 0.9999


@pytest.mark.parametrize("measured", [0, 50])
def test_nothing_in_the_picture_is_said(make_scene, measured) -> None:
    scene = make_scene()
    points = np.full_like(scene.points, np.nan)
    points[100, 100 : 100 + measured] = scene.points[100, 100 : 100 + measured]
    with pytest.raises(ImpastoError, match="points"):
        find_canvas(points, scene.sigma, scene.camera, 2)


def test_a_cloud_of_noise_is_no_canvas(make_scene) -> None:
    scene = make_scene(noise=200.0)
    with pytest.raises(ImpastoError, match="surface"):
        find_canvas(scene.points, np.full_like(scene.sigma, 0.01), scene.camera, 2)


def test_the_ray_factor_of_a_slope() -> None:
    x = np.arange(20) * 0.5
    heights = np.broadcast_to(0.4 * x, (20, 20))
    points = np.stack([*np.meshgrid(x, -x), heights], axis=-1)
    overhead = ray_factor(heights, 0.5, points, np.array([0, 0, 1e6]))
    assert overhead == pytest.approx(1, abs=1e-4)
    oblique = ray_factor(heights, 0.5, points, np.array([-1e6, 0, 1e6]))
    assert oblique == pytest.approx((1 + 0.4) / np.sqrt(2), rel=1e-4)
