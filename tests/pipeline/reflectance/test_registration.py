"""Cameras placed through the canvas: synthetic stations whose poses are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.formats.calibration import Turntable
from pipeline.formats.height_field import HeightField
from pipeline.geometry.camera import Camera, Lens
from pipeline.geometry.raycast import RayCaster
from pipeline.geometry.rigid import RigidTransform, rotation_about_axis
from pipeline.reflectance.axis_motion import AXIS_SIGMA, moved_axis
from pipeline.reflectance.registration import Registration, register
from pipeline.reflectance.reprojection import Known
from pipeline.reflectance.single_pose import Recording
from pipeline.reflectance.surface_points import Surface
from pipeline.structured_light.coordinates import ProjectorCoordinates

LENS = Lens(
    (200, 150),
    np.array([[420.0, 0, 101.3], [0, 421, 73.2], [0, 0, 1]]),
    np.array([-0.07, 0.05, 5e-4, -3e-4, 0]),
)
PROJECTOR_LENS = Lens((1024, 768), np.array([[2600.0, 0, 520], [0, 2600, 380], [0, 0, 1]]))
SCAN_FROM_CANVAS = RigidTransform(np.diag([1.0, -1.0, -1.0]), np.array([-125.0, -95.0, 1000.0]))
TABLE = Turntable(np.array([6.0, 4.0, 1000.0]), np.array([0.02, -0.01, -1.0]))
NOISE_PX = 0.05


def look_at(
    eye: tuple[float, float, float], up: tuple[float, float, float] = (0, 1, 0)
) -> RigidTransform:
    """Return canvas to camera, the camera looking at the canvas's middle from ``eye``."""
    middle = np.array([125.0, -95.0, 0.0])
    place = middle + np.array(eye)
    forward = middle - place
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    return RigidTransform(rotation, -rotation @ place)


PROJECTOR = Camera(PROJECTOR_LENS, look_at((-330.0, 60, 950)) @ SCAN_FROM_CANVAS.inverse())
EYES = {
    "front": (30.0, 20.0, 800.0),
    "left": (-450.0, 100.0, 650.0),
    "right": (520.0, -80.0, 600.0),
    "top": (60.0, 600.0, 500.0),
}


def canvas(relief_mm: float = 0.6) -> HeightField:
    rows, columns = np.mgrid[:191, :251].astype(float)
    heights = np.sin(rows / 7) * np.cos(columns / 9) + 0.5 * np.sin((rows + 2 * columns) / 5)
    heights = (relief_mm * heights).astype(np.float32)
    return HeightField(
        heights, np.full_like(heights, 0.02), np.zeros(heights.shape, bool), 1.0, SCAN_FROM_CANVAS
    )


def record(
    field: HeightField,
    pose: RigidTransform,
    *,
    table_deg: float = 0.0,
    noise_px: float = NOISE_PX,
    lens: Lens = LENS,
    seed: int = 0,
) -> ProjectorCoordinates:
    """Return what a camera (``pose``: scan's frame to camera) decodes of the turned canvas."""
    turned = _turn(table_deg) @ field.scan_from_canvas
    canvas_from_camera = (pose @ turned).inverse()
    rays = canvas_from_camera.rotate(lens.directions(lens.pixel_grid().reshape(-1, 2)))
    origin = canvas_from_camera.translation_mm
    hit = RayCaster(field.heights_mm, field.spacing_mm).first_hit(origin, rays)
    hit = np.where(np.isfinite(hit), hit, np.nan)
    points = origin + hit[:, None] * rays
    seen = PROJECTOR.project(turned.apply(points))
    seen += np.random.default_rng(seed).normal(0, noise_px, seen.shape)
    width, height = lens.size_px
    x, y = seen.T.reshape(2, height, width).astype(np.float32)
    sigma = np.full(x.shape, max(noise_px, 1e-3), np.float32)
    return ProjectorCoordinates(x, y, sigma, sigma, np.ones_like(x), "white", {})


def station(eye: str) -> RigidTransform:
    """Return the scan's frame to the camera."""
    return look_at(EYES[eye]) @ SCAN_FROM_CANVAS.inverse()


def place(
    field: HeightField,
    recordings: dict[str, Recording],
    *,
    lens: Lens = LENS,
    table: Turntable | None = TABLE,
    known: Known | None = None,
) -> Registration:
    return register(recordings, {"C": lens}, PROJECTOR, Surface.of(field), table, known or Known())


def centre_error(found: RigidTransform, true: RigidTransform) -> float:
    return float(np.linalg.norm(found.inverse().translation_mm - true.inverse().translation_mm))


def angle_deg(found: RigidTransform, true: RigidTransform) -> float:
    turn = found.rotation @ true.rotation.T
    return float(np.degrees(np.linalg.norm(turn - turn.T) / (2 * np.sqrt(2))))


def _turn(angle_deg: float) -> RigidTransform:
    return rotation_about_axis(TABLE.axis_point_mm, TABLE.axis_direction, angle_deg)


@pytest.mark.parametrize("relief_mm", [0.6, 0.0], ids=["relief", "plane"])
def test_stations_are_found_to_a_few_of_their_stated_deviations(relief_mm: float) -> None:
    field = canvas(relief_mm)
    found = place(
        field,
        {eye: Recording(record(field, station(eye), seed=i), "C") for i, eye in enumerate(EYES)},
    )
    assert not found.left_out
    for eye, placed in found.placed.items():
        error = centre_error(placed.pose, station(eye))
        assert error < 4 * placed.sigma_mm
        assert placed.sigma_mm < 0.2
        assert angle_deg(placed.pose, station(eye)) < 4 * placed.sigma_deg
        assert placed.points > 2000
        assert placed.share > 0.9
        assert 0 < placed.rms_px < 0.1


def test_without_noise_the_pose_is_exact_to_the_coordinates_precision() -> None:
    field = canvas()
    found = place(field, {"left": Recording(record(field, station("left"), noise_px=0), "C")})
    # Coordinates are float32: 3e-5 px.
    assert centre_error(found.placed["left"].pose, station("left")) < 1e-3


@pytest.mark.parametrize("relief_mm", [0.6, 0.0], ids=["relief", "plane"])
def test_thirty_percent_of_wrong_coordinates_do_no_harm(relief_mm: float) -> None:
    field = canvas(relief_mm)
    coordinates = record(field, station("right"))
    rng = np.random.default_rng(3)
    wrong = rng.random(LENS.size_px[::-1]) < 0.3
    x, y = (
        np.where(wrong, rng.uniform(200, 800, wrong.shape), c).astype(np.float32)
        for c in (coordinates.x, coordinates.y)
    )
    found = place(field, {"right": Recording(replace(coordinates, x=x, y=y), "C")})
    placed = found.placed["right"]
    assert centre_error(placed.pose, station("right")) < max(4 * placed.sigma_mm, 0.1)
    assert placed.share == pytest.approx(0.7, abs=0.06)


def test_a_shifted_block_of_coordinates_does_no_harm() -> None:
    field = canvas()
    coordinates = record(field, station("front"))
    x = coordinates.x.copy()
    x[:, 140:] += 16  # one period
    found = place(field, {"front": Recording(replace(coordinates, x=x), "C")})
    assert centre_error(found.placed["front"].pose, station("front")) < 0.3
    assert found.placed["front"].share < 0.85


def test_a_station_that_saw_the_canvas_turned_is_placed_in_the_same_room() -> None:
    field = canvas()
    found = place(
        field,
        {
            "straight": Recording(record(field, station("left")), "C"),
            "turned": Recording(record(field, station("left"), table_deg=30, seed=1), "C", 30.0),
        },
    )
    for placed in found.placed.values():
        assert centre_error(placed.pose, station("left")) < max(4 * placed.sigma_mm, 0.1)


def test_turned_canvases_correct_an_axis_that_was_calibrated_a_little_wrong() -> None:
    field = canvas(1.2)
    point, direction = moved_axis(
        TABLE.axis_point_mm, TABLE.axis_direction, np.array([2e-4, -2e-4, 0.04, -0.05])
    )
    recordings = {
        eye: Recording(record(field, station(eye), table_deg=angle, seed=i), "C", angle)
        for i, (eye, angle) in enumerate(zip(EYES, (0.0, 25.0, -30.0, 160.0), strict=True))
    }
    off = Turntable(point, direction)
    found = place(field, recordings, table=off, known=Known(axis=AXIS_SIGMA))
    assert found.turntable is not None

    def error(table: Turntable) -> float:
        return float(
            np.linalg.norm(
                np.cross(table.axis_direction, TABLE.axis_direction)
                / np.linalg.norm(TABLE.axis_direction)
            )
        )

    assert error(found.turntable) < 0.4 * error(off)
    kept = place(field, recordings, table=off)
    assert kept.turntable == off


def test_views_from_all_sides_correct_the_lens_that_they_share() -> None:
    field = canvas()
    sigma = np.array([1.0, 1.0, 2.0, 2.0, 0.02, 0.2, 1e-3, 1e-3])
    wrong = Lens(
        LENS.size_px, LENS.K + np.array([[0.8, 0, 1.5], [0, 0.7, -1.0], [0, 0, 0]]), LENS.distortion
    )
    recordings = {
        eye: Recording(record(field, station(eye), seed=i), "C") for i, eye in enumerate(EYES)
    }
    plain = place(field, recordings, lens=wrong)
    found = place(field, recordings, lens=wrong, known=Known({"C": sigma}))
    assert np.abs(found.lenses["C"].K - LENS.K).max() < 0.4
    assert plain.lenses["C"] == wrong
    for eye in EYES:
        error = centre_error(found.placed[eye].pose, station(eye))
        assert error < 4 * found.placed[eye].sigma_mm
    worst = max(centre_error(plain.placed[eye].pose, station(eye)) for eye in EYES)
    assert max(centre_error(found.placed[eye].pose, station(eye)) for eye in EYES) < 0.5 * worst


def test_what_does_not_fit_is_left_out_by_name_and_the_others_stay() -> None:
    field = canvas()
    good = record(field, station("front"))
    nothing = np.full_like(good.x, np.nan)
    rng = np.random.default_rng(0)
    noise = rng.uniform(300, 700, (2, *good.x.shape)).astype(np.float32)
    beside = np.full_like(good.x, -5000.0)
    found = place(
        field,
        {
            "dark": Recording(replace(good, x=nothing, y=nothing), "C"),
            "noise": Recording(replace(good, x=noise[0], y=noise[1]), "C"),
            "elsewhere": Recording(replace(good, x=beside, y=beside), "C"),
            "columns": Recording(replace(good, y=None, sigma_y=None), "C"),
            "good": Recording(good, "C"),
        },
    )
    assert set(found.placed) == {"good"}
    assert "show the canvas" in found.left_out["dark"]
    assert "show the canvas" in found.left_out["elsewhere"]
    assert "one axis only" in found.left_out["columns"]
    assert found.left_out["noise"]


def test_a_turned_table_without_an_axis_is_a_reason() -> None:
    field = canvas()
    found = place(field, {"a": Recording(record(field, station("left")), "C", 10.0)}, table=None)
    assert "axis" in found.left_out["a"]


def test_a_recording_of_another_surface_misses_and_is_left_out() -> None:
    field = canvas()
    other = record(canvas(15.0), station("left"))
    found = place(field, {"other": Recording(other, "C")})
    assert not found.placed
    assert "px" in found.left_out["other"] or "agree" in found.left_out["other"]


def test_nothing_to_place_gives_nothing() -> None:
    assert place(canvas(), {}) == Registration({}, {}, {"C": LENS}, TABLE)
