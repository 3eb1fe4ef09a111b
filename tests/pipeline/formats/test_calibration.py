"""The rig, to and from ``calibrate/calibration.json``."""

from __future__ import annotations

import json

import numpy as np
import pytest

from pipeline.errors import ImpastoError
from pipeline.formats.calibration import CALIBRATION, Calibration, Light, Residuals, Turntable
from pipeline.geometry.camera import Camera, Lens
from pipeline.geometry.rigid import RigidTransform, rotation_about_axis

FILE = "calibrate/calibration.json"
K = np.array([[1500.0, 0, 322], [0, 1503, 236], [0, 0, 1]])
BENT = np.array([-0.1, 0.08, 0.0005, -0.0003, 0.01])
TURNED = rotation_about_axis(np.array([1.0, 2, 3]), np.array([0.2, -1.0, 0.4]), 40.0)


@pytest.fixture
def workspace(tmp_path):
    (tmp_path / "calibrate").mkdir()
    return tmp_path


def example(**changes):
    entries = {
        "frame": "rig",
        "scan_camera": "C0",
        "lenses": {"C0": Lens((640, 480), K, BENT), "C1": Lens((320, 240), K)},
        "poses": {"C0": TURNED},
        "projector": Camera(Lens((1024, 768), 2 * K), TURNED @ TURNED),
        "turntable": Turntable(np.array([1.0, 2, 3]), np.array([0.0, 0, 1])),
        "lights": {"L1": Light(np.array([300.0, 0, 500]), 2.5, False)},
        "residuals": {"C0": Residuals(0.02, 486, {"fx": 0.3})},
        "origin": {"C0": "calibrated", "projector": "given"},
        "scale_known": False,
    }
    return Calibration(**(entries | changes))


def test_round_trip_keeps_every_number(workspace):
    CALIBRATION.save(workspace, example())
    again = CALIBRATION.load(workspace)
    assert again.frame == "rig"
    assert not again.scale_known
    assert again.origin == {"C0": "calibrated", "projector": "given"}
    assert again.residuals["C0"] == Residuals(0.02, 486, {"fx": 0.3})
    assert again.poses.keys() == {"C0"}
    np.testing.assert_array_equal(again.lenses["C0"].K, K)
    np.testing.assert_array_equal(again.lenses["C0"].distortion, BENT)
    np.testing.assert_array_equal(again.poses["C0"].matrix, TURNED.matrix)
    np.testing.assert_array_equal(again.projector.pose.matrix, (TURNED @ TURNED).matrix)
    np.testing.assert_array_equal(again.turntable.axis_point_mm, [1, 2, 3])
    assert again.lights["L1"].intensity == 2.5
    assert not again.lights["L1"].intensity_known


def test_what_is_not_there_stays_away(workspace):
    CALIBRATION.save(workspace, example(projector=None, turntable=None, lights={}, residuals={}))
    again = CALIBRATION.load(workspace)
    assert again.projector is None
    assert again.turntable is None
    assert again.lights == {}
    assert again.residuals == {}


def test_the_projector_is_also_told_from_its_camera(workspace):
    CALIBRATION.save(workspace, example())
    entry = json.loads((workspace / FILE).read_text())["projector"]["from_camera"]
    seen = RigidTransform(np.array(entry["R"]), np.array(entry["t_mm"])) @ TURNED
    np.testing.assert_allclose(seen.matrix, (TURNED @ TURNED).matrix, atol=1e-9)


def test_a_camera_is_given_by_name_or_refused():
    assert example().camera("C0").lens.size_px == (640, 480)
    with pytest.raises(ImpastoError, match="'C7' is not calibrated"):
        example().camera("C7")
    with pytest.raises(ImpastoError, match="pose of camera 'C1' is not known"):
        example().camera("C1")


def put(*path):
    """Return a change of the document: the last entry of the path is the value."""
    *keys, value = path

    def change(document):
        for key in keys[:-1]:
            document = document[key]
        document[keys[-1]] = value

    return change


@pytest.mark.parametrize(
    ("change", "key"),
    [
        (lambda d: d.pop("cameras"), "cameras"),
        (put("version", 2), "version"),
        (put("format", "other"), "format"),
        (put("frame", "moon"), "frame"),
        (put("unknown", 1), "unknown"),
        (put("cameras", "C0", "size_px", [0, 480]), "size_px"),
        (put("cameras", "C0", "size_px", [-640, 480]), "size_px"),
        (put("cameras", "C0", "K", [[1, 0], [0, 1]]), "K"),
        (put("cameras", "C0", "distortion", [0.0] * 4), "distortion"),
        (put("cameras", "C0", "R", [[2.0, 0, 0], [0, 1, 0], [0, 0, 1]]), "C0.R"),
        (put("cameras", "C0", "R", [[1.0, 0, 0], [0, 1, 0], [0, 0, -1]]), "C0.R"),
        (put("cameras", "C0", "t_mm", ["far", 0, 0]), "t_mm"),
        (put("projector", "R", None), "projector"),
        (put("lights", "L1", "position_mm", [0, 0]), "position_mm"),
    ],
)
def test_a_hostile_document_is_refused_by_file_and_key(workspace, change, key):
    CALIBRATION.save(workspace, example())
    document = json.loads((workspace / FILE).read_text())
    change(document)
    (workspace / FILE).write_text(json.dumps(document))
    with pytest.raises(ImpastoError) as caught:
        CALIBRATION.load(workspace)
    assert FILE in str(caught.value)
    assert key in str(caught.value)


@pytest.mark.parametrize("text", ["", "{", "[]", '{"cameras": NaN}'])
def test_what_is_no_document_is_refused(workspace, text):
    (workspace / FILE).write_text(text)
    with pytest.raises(ImpastoError, match=r"calibration\.json"):
        CALIBRATION.load(workspace)


def test_numbers_that_are_none_are_never_written(workspace):
    with pytest.raises(ValueError, match="not JSON compliant"):
        CALIBRATION.save(workspace, example(residuals={"C0": Residuals(float("nan"))}))
