"""Which sequences are needed, and what photographs and lamps get from them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pipeline.errors import ImpastoError
from pipeline.formats.calibration import Calibration, Light, Residuals, Turntable
from pipeline.formats.capture import Capture, Photo
from pipeline.formats.height_field import HeightField
from pipeline.geometry.camera import Camera, Lens
from pipeline.geometry.raycast import RayCaster
from pipeline.geometry.rigid import RigidTransform
from pipeline.reflectance import places
from pipeline.reflectance.projection import LENS as PARAMETERS
from pipeline.reflectance.stations import stations
from pipeline.structured_light.coordinates import ProjectorCoordinates

LENS = Lens((160, 120), np.array([[300.0, 0, 80], [0, 300, 60], [0, 0, 1]]))
DOWN = np.diag([1.0, -1.0, -1.0])
SCAN_FROM_CANVAS = RigidTransform(DOWN, np.array([-60.0, -50.0, 600.0]))
PROJECTOR = Camera(
    Lens((640, 480), np.array([[1500.0, 0, 320], [0, 1500, 240], [0, 0, 1]])),
    RigidTransform(
        np.array([[0.96, 0, 0.28], [0, 1, 0], [-0.28, 0, 0.96]]), np.array([-168.0, 0, 24.0])
    ),
)


class Log:
    def __init__(self) -> None:
        self.metrics: dict[str, float | int | str] = {}
        self.warnings: list[str] = []
        self.left: dict[str, str] = {}

    def progress(self, done: float, total: float, what: str = "") -> None: ...

    def metric(self, name: str, value: float | int | str) -> None:
        self.metrics[name] = value

    def warning(self, text: str) -> None:
        self.warnings.append(text)

    def skipped(self, what: str, why: str) -> None:
        self.left[what] = why


def frames() -> list[dict[str, Any]]:
    return [{"file": "f.png", "pattern": {"type": "white"}}]


def capture(**changes: Any) -> Capture:
    document: dict[str, Any] = {
        "format": "impasto-capture",
        "version": 1,
        "name": "test",
        "encoding": "linear",
        "cameras": {
            "C0": {"size_px": [160, 120]},
            "C1": {"size_px": [160, 120], "lens_of": "C0"},
            "CL": {"size_px": [160, 120], "lens_of": "C0"},
        },
        "sequences": [
            {"name": "here", "purpose": "pose", "camera": "C1", "frames": frames()},
            {
                "name": "lamp",
                "purpose": "light",
                "camera": "CL",
                "light": "L",
                "frames": frames(),
            },
        ],
        "photos": [{"file": "p.png", "camera": "C1", "pose": "here", "light": "L"}],
        "lights": {"L": {"intensity": 3.0}},
    }
    return Capture.model_validate(document | changes)


class Bundle:
    def __init__(self, document: Capture) -> None:
        self.capture = document


def rig(**changes: Any) -> Calibration:
    fields: dict[str, Any] = {
        "frame": "camera",
        "scan_camera": "C0",
        "lenses": {"C0": LENS, "C1": LENS, "CL": LENS},
        "poses": {"C0": RigidTransform()},
        "projector": PROJECTOR,
        "turntable": Turntable(np.array([0.0, 0, 600]), np.array([0.0, 0, -1])),
    }
    return Calibration(**{**fields, **changes})


def canvas() -> HeightField:
    rows, columns = np.mgrid[:101, :121].astype(float)
    heights = (0.5 * np.sin(rows / 5) * np.cos(columns / 6)).astype(np.float32)
    return HeightField(
        heights, np.full_like(heights, 0.02), np.zeros(heights.shape, bool), 1.0, SCAN_FROM_CANVAS
    )


PLACES = {
    "here": RigidTransform(np.eye(3), np.array([40.0, 10.0, -80.0])),
    "lamp": RigidTransform(np.eye(3), np.array([-50.0, 30.0, 20.0])),
}


@pytest.fixture
def decoded(monkeypatch: pytest.MonkeyPatch) -> dict[str, RigidTransform]:
    """Let each sequence decode to what a camera at its place sees; without a place, to nothing."""
    where = dict(PLACES)

    def decode(bundle: object, sequence: Any) -> ProjectorCoordinates:
        if sequence.name not in where:
            raise ImpastoError("no pixel shows the patterns", where=sequence.name)
        field = canvas()
        back = (where[sequence.name] @ SCAN_FROM_CANVAS).inverse()
        rays = back.rotate(LENS.directions(LENS.pixel_grid().reshape(-1, 2)))
        hit = RayCaster(field.heights_mm, 1.0).first_hit(back.translation_mm, rays)
        hit = np.where(np.isfinite(hit), hit, np.nan)
        points = hit[:, None] * rays
        seen = PROJECTOR.project(SCAN_FROM_CANVAS.apply(points + back.translation_mm))
        x, y = seen.T.reshape(2, 120, 160).astype(np.float32)
        sigma = np.full_like(x, 0.02)
        return ProjectorCoordinates(x, y, sigma, sigma, np.ones_like(x), "white", {})

    monkeypatch.setattr(places, "decode_sequence", decode)
    return where


def find(
    document: Capture, calibration: Calibration, log: Log
) -> tuple[Calibration, places.Places]:
    return places.find_places(
        Bundle(document),  # type: ignore[arg-type]
        calibration,
        canvas(),
        None,
        worst_rms_px=1.0,
        refine_lenses=True,
        log=log,
    )


@pytest.mark.usefixtures("decoded")
def test_a_photograph_gets_its_camera_and_its_lamp_from_sequences() -> None:
    log = Log()
    calibration, found = find(capture(), rig(), log)
    (placed,), left_out = stations(capture().photos, calibration, SCAN_FROM_CANVAS, None, found)
    assert not left_out
    assert not log.warnings
    expected = PLACES["here"] @ SCAN_FROM_CANVAS
    np.testing.assert_allclose(placed.camera.pose.matrix, expected.matrix, atol=0.02)
    lamp = SCAN_FROM_CANVAS.inverse().apply(PLACES["lamp"].inverse().translation_mm)
    np.testing.assert_allclose(placed.light_mm, lamp, atol=0.02)
    assert placed.intensity == 3.0
    assert placed.intensity_known
    assert [(c.sequence, c.name, c.light) for c in found.cameras] == [
        ("here", "C1", None),
        ("lamp", "CL", "L"),
    ]
    np.testing.assert_allclose(found.cameras[0].camera.pose.matrix, expected.matrix, atol=0.02)
    places.report(found.cameras, log)
    assert log.metrics["registration_points_here"] == found.cameras[0].points > 1000
    assert 0 < log.metrics["registration_error_px"] < 0.05  # type: ignore[operator]


@pytest.mark.usefixtures("decoded")
def test_an_intensity_that_is_not_given_is_1_and_not_known() -> None:
    calibration, _ = find(capture(lights={"L": {}}), rig(), Log())
    assert calibration.lights["L"].intensity == 1.0
    assert not calibration.lights["L"].intensity_known


def test_what_the_bundle_gives_wins_and_the_sequences_are_skipped(
    decoded: dict[str, RigidTransform],
) -> None:
    decoded.clear()
    given = rig(
        poses={"C0": RigidTransform(), "C1": PLACES["here"]},
        lights={"L": Light(np.array([1.0, 2, 3]))},
    )
    log = Log()
    calibration, found = find(capture(), given, log)
    assert calibration == given
    assert not found.poses
    assert not found.cameras
    assert log.left == {"here": "the pose is given", "lamp": "the position is given"}


def test_sequences_that_no_photograph_needs_are_not_decoded(
    decoded: dict[str, RigidTransform],
) -> None:
    decoded.clear()
    log = Log()
    photos = [{"file": "p.png", "camera": "C0"}]
    _, found = find(capture(photos=photos), rig(), log)
    assert not log.warnings
    assert set(log.left) == {"here", "lamp"}
    assert not found.cameras


@pytest.mark.parametrize(
    ("missing", "reason"), [("here", "pose sequence here"), ("lamp", "sequence lamp")]
)
def test_photographs_of_a_sequence_that_does_not_fit_are_left_out_by_name(
    decoded: dict[str, RigidTransform], missing: str, reason: str
) -> None:
    del decoded[missing]
    log = Log()
    calibration, found = find(capture(), rig(), log)
    placed, left_out = stations(capture().photos, calibration, SCAN_FROM_CANVAS, None, found)
    assert not placed
    assert reason in left_out["p.png"]
    assert log.warnings == [f"{missing} is left out: no pixel shows the patterns"]


@pytest.mark.usefixtures("decoded")
@pytest.mark.parametrize(
    ("changes", "reason"),
    [({"projector": None}, "projector"), ({"lenses": {"C0": LENS}}, "lens of camera")],
)
def test_a_rig_that_is_not_calibrated_is_a_reason(changes: dict[str, Any], reason: str) -> None:
    log = Log()
    _, found = find(capture(), rig(**changes), log)
    assert not found.cameras
    assert all(reason in text for text in log.warnings)
    assert len(log.warnings) == 2


@pytest.mark.usefixtures("decoded")
def test_a_lens_far_from_what_the_canvas_shows_is_a_warning() -> None:
    K = LENS.K + np.array([[0, 0, 4.0], [0, 0, 0], [0, 0, 0]])
    wrong = Lens(LENS.size_px, K)
    sigma = dict.fromkeys(PARAMETERS, 1e-3) | {"cx": 0.5, "cy": 0.5, "fx": 0.5, "fy": 0.5}
    log = Log()
    calibration, _ = find(
        capture(),
        rig(
            lenses={"C0": wrong, "C1": wrong, "CL": wrong},
            residuals={"C0": Residuals(0.1, 10, sigma)},
        ),
        log,
    )
    assert any("cx of camera C0" in text for text in log.warnings)
    for name in ("C0", "C1", "CL"):
        np.testing.assert_allclose(calibration.lenses[name].K, LENS.K, atol=0.05)


def photo(**changes: Any) -> Photo:
    return Photo.model_validate({"file": "p.png", "camera": "C1", "turntable_deg": 45.0, **changes})


@pytest.mark.parametrize(
    ("angles", "named", "expected"),
    [
        ([0.0], None, "s0"),
        ([0.0, 45.0], None, "s1"),
        ([45.0, 45.0], None, ""),
        ([0.0, 90.0], None, ""),
        ([], None, ""),
        ([0.0, 45.0], "s0", "s0"),
    ],
)
def test_a_photograph_without_a_named_sequence_takes_the_only_one_that_fits(
    angles: list[float], named: str | None, expected: str
) -> None:
    sequences = [
        {
            "name": f"s{i}",
            "purpose": "pose",
            "camera": "C1",
            "turntable_deg": angle,
            "frames": frames(),
        }
        for i, angle in enumerate(angles)
    ]
    assert places.pose_sequence(photo(pose=named), capture(sequences=sequences)) == expected
