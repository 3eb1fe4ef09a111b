"""Where cameras and lamps stand, seen from a canvas that the table turns."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.formats.calibration import Calibration, Light, Turntable
from pipeline.formats.capture import Photo
from pipeline.geometry.camera import Camera, Lens
from pipeline.geometry.rigid import RigidTransform, rotation_about_axis
from pipeline.reflectance.stations import stations

LENS = Lens((400, 300), np.array([[500.0, 0, 200], [0, 500, 150], [0, 0, 1]]))
LOOKS_DOWN = RigidTransform(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 900.0]))
CANVAS = rotation_about_axis(np.zeros(3), np.array([0.1, 0.2, 1.0]), 20.0)


def rig(**changes: object) -> Calibration:
    fields: dict[str, object] = {
        "frame": "rig",
        "scan_camera": "C1",
        "lenses": {"C1": LENS},
        "poses": {"C1": LOOKS_DOWN},
        "projector": None,
        "turntable": Turntable(np.array([5.0, -3.0, 0.0]), np.array([0.0, 0.0, 2.0])),
        "lights": {"L": Light(np.array([300.0, 100.0, 700.0]), 2.0)},
    }
    return Calibration(**{**fields, **changes})  # type: ignore[arg-type]


def photo(**changes: object) -> Photo:
    return Photo.model_validate(
        {"file": "p.png", "camera": "C1", "light": "L", "turntable_deg": 30.0, **changes}
    )


@pytest.mark.parametrize("start", [None, 0.0, 15.0])
def test_a_point_of_the_canvas_is_seen_where_the_table_took_it(start: float | None) -> None:
    (station,), left_out = stations([photo()], rig(), CANVAS, start)
    assert not left_out
    point = np.array([40.0, -25.0, 1.5])
    table = rotation_about_axis(np.array([5.0, -3, 0]), np.array([0.0, 0, 1]), 30 - (start or 0))
    turned = table.apply(CANVAS.apply(point))
    expected = Camera(LENS, LOOKS_DOWN).project(turned)
    np.testing.assert_allclose(station.camera.project(point), expected, atol=1e-9)
    lamp = np.array([300.0, 100.0, 700.0])
    assert np.linalg.norm(station.light_mm - point) == pytest.approx(np.linalg.norm(lamp - turned))
    assert station.intensity == 2.0


def test_an_angle_that_is_not_given_means_that_the_table_did_not_turn() -> None:
    (station,), _ = stations([photo(turntable_deg=None)], rig(turntable=None), CANVAS, 15.0)
    np.testing.assert_allclose(station.light_mm, CANVAS.inverse().apply([300.0, 100.0, 700.0]))


@pytest.mark.parametrize(
    ("changes", "missing", "reason"),
    [
        ({"camera": "C9"}, {}, "lens of camera C9"),
        ({}, {"poses": {}}, "pose of camera C1"),
        ({"light": None}, {}, "names no lamp"),
        ({"light": "L7"}, {}, "lamp L7"),
        ({}, {"turntable": None}, "axis"),
    ],
)
def test_a_photograph_that_cannot_be_placed_is_named_with_its_reason(
    changes: dict[str, object], missing: dict[str, object], reason: str
) -> None:
    placed, left_out = stations([photo(**changes)], rig(**missing), CANVAS, 0.0)
    assert placed == []
    assert reason in left_out["p.png"]
