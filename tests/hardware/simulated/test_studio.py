from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from hardware.acquisition import Coding, coded
from hardware.simulated.layout import BOARD, lay_out
from hardware.simulated.optics import lens_rays, open_eye
from hardware.simulated.painting import paint
from hardware.simulated.rig import Physics
from hardware.simulated.studio import Setting, photo_plans, record
from hardware.simulated.subjects import PaintedCanvas, PaintingOnTable
from pipeline.errors import ImpastoError
from pipeline.formats.bundle import open_bundle
from pipeline.geometry.camera import Camera, Lens
from pipeline.geometry.rigid import RigidTransform

SETTING = Setting(
    scan_px=(80, 60),
    photo_px=(64, 48),
    projector_px=(128, 96),
    spacing_mm=1.0,
    boards=0,
    photos=3,
    patterns=coded(Coding("x", bits=4, cell_px=8, periods_px=(16,), steps=4)),
    exposures=(1.0,),
    tests=1,
    physics=Physics(samples=1),
)


def silent(_what: str, _done: int, _total: int) -> None:
    pass


@pytest.fixture(scope="module")
def captured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("studio")
    record(SETTING, folder / "bundle", folder / "truth", silent)
    return folder


@pytest.fixture(scope="module")
def truth(captured: Path) -> dict:
    return json.loads((captured / "truth" / "truth.json").read_text())


def test_the_bundle_is_valid_and_complete(captured: Path) -> None:
    bundle = open_bundle(captured / "bundle")
    assert [s.name for s in bundle.sequences("scan")] == ["front"]
    assert len(bundle.capture.photos) == 3
    for file in bundle.files("scan", "photos"):
        image = bundle.read(file)
        assert image.max() <= 1


def test_nothing_in_the_bundle_points_to_the_truth(captured: Path) -> None:
    assert "truth" not in (captured / "bundle" / "capture.json").read_text()
    names = {path.name for path in (captured / "bundle").rglob("*") if path.is_file()}
    assert {Path(name).suffix for name in names} == {".png", ".json"}


def test_the_same_setting_gives_the_same_bytes(captured: Path, tmp_path: Path) -> None:
    record(SETTING, tmp_path / "bundle", tmp_path / "truth", silent)
    first = {p.relative_to(captured): p.read_bytes() for p in captured.rglob("*") if p.is_file()}
    again = {p.relative_to(tmp_path): p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    assert first == again


def test_a_bundle_is_never_overwritten(captured: Path, tmp_path: Path) -> None:
    with pytest.raises(ImpastoError, match="holds a"):
        record(SETTING, captured / "bundle", tmp_path, silent)


def test_white_paint_is_exposed_just_below_saturation(captured: Path) -> None:
    bundle = open_bundle(captured / "bundle")
    white = bundle.read(bundle.sequences("scan")[0].frames[0].file)
    assert 0.7 < np.quantile(white, 0.995) < 0.95


def device(entry: dict) -> Camera:
    return Camera(
        Lens(tuple(entry["size_px"]), np.array(entry["K"]), np.array(entry["distortion"])),
        RigidTransform(np.array(entry["R"]), np.array(entry["t_mm"])),
    )


def test_true_depth_is_that_of_the_true_surface(captured: Path, truth: dict) -> None:
    camera = device(truth["cameras"]["C0"])
    with np.load(captured / "truth" / "scan.npz") as scan:
        depth_mm, kind = scan["depth_um"] / 1000, scan["object"]
    canvas_from_rig = RigidTransform.from_matrix(truth["rig_from_canvas"]).inverse()
    origin, directions = camera.rays(camera.lens.pixel_grid())
    points = canvas_from_rig.apply(origin + directions * depth_mm[..., None])
    with np.load(captured / "truth" / "surface.npz") as surface:
        x, y, heights, mask = (surface[k] for k in ("x_mm", "y_mm", "height_mm", "mask"))
    assert heights.shape == mask.shape == (len(y), len(x))
    assert (np.diff(y) > 0).all()
    on_canvas = points[kind == 1]
    assert len(on_canvas) > 1000
    from scipy.interpolate import RegularGridInterpolator

    expected = RegularGridInterpolator((y, x), heights)(on_canvas[:, 1::-1])
    # Depths are stored in micrometres.
    np.testing.assert_allclose(on_canvas[:, 2], expected, atol=0.002)
    # The table is the plane z = 0 of the rig.
    table = (origin + directions * depth_mm[..., None])[kind == 3]
    np.testing.assert_allclose(table[:, 2], 0, atol=0.001)


def test_true_reflectance_is_on_the_same_grid(captured: Path) -> None:
    with (
        np.load(captured / "truth" / "surface.npz") as surface,
        np.load(captured / "truth" / "brdf.npz") as brdf,
    ):
        shape = surface["height_mm"].shape
        assert brdf["rho_d"].shape == brdf["rho_s"].shape == brdf["C"].shape == (*shape, 3)
        assert brdf["k"].shape == shape
        np.testing.assert_array_equal(brdf["C"][..., 0], brdf["C"][..., 1])
        # The sky, at the largest y, is the last row here.
        blue = brdf["rho_d"][..., 2].astype(float) - brdf["rho_d"][..., 0]
        assert blue[-20:-5].mean() > blue[5:20].mean()


def test_the_projector_is_told_as_the_bundle_wants_it(captured: Path, truth: dict) -> None:
    entry = open_bundle(captured / "bundle").capture.projector
    assert entry is not None
    camera, projector = (device(e) for e in (truth["cameras"]["C0"], truth["projector"]))
    point = np.array([10.0, 20.0, 15.0])
    seen = camera.pose.apply(point)
    got = np.array(entry.R) @ seen + np.array(entry.t_mm)
    np.testing.assert_allclose(got, projector.pose.apply(point), atol=1e-9)
    np.testing.assert_allclose(truth["projector"]["relative_to_C0"]["R"], entry.R)


def test_a_test_photo_is_the_painting_seen_from_its_pose(captured: Path, truth: dict) -> None:
    (entry,) = truth["test_photos"]
    camera, lamp = device(entry), np.array(entry["light_mm"])  # in canvas coordinates
    image = cv2.imread(str(captured / "truth" / entry["file"]), cv2.IMREAD_UNCHANGED)[..., ::-1]
    painting = paint(SETTING.seed, SETTING.spacing_mm)
    raised = RigidTransform(np.eye(3), np.array([0.0, 0.0, 500.0]))  # away from the table
    subject = PaintingOnTable(PaintedCanvas(painting), raised)
    in_air = Camera(camera.lens, camera.pose @ raised.inverse())
    from hardware.simulated.optics import see_by_lamp, spread

    seen = see_by_lamp(
        open_eye(in_air, lens_rays(camera.lens, 1)), subject, raised.apply(lamp), 1.0
    )
    value = spread(seen, SETTING.physics.spread_px)
    value = np.clip(value * entry["exposure_s"] * entry["responsivity_per_s"], 0, 1)
    middle = np.s_[14:34, 18:46]
    np.testing.assert_allclose(image[middle] / 65535, value[middle], atol=1.5 / 65535 + 1e-4)


def test_boards_are_found_where_the_truth_has_them(tmp_path: Path) -> None:
    setting = Setting(
        scan_px=(320, 240),
        photo_px=(16, 12),
        projector_px=(64, 48),
        spacing_mm=1.0,
        boards=2,
        photos=0,
        patterns=coded(),
        exposures=(1.0,),
        tests=0,
    )
    record(setting, tmp_path / "bundle", tmp_path / "truth", silent)
    bundle = open_bundle(tmp_path / "bundle")
    assert bundle.capture.cameras["C0"].K is None
    assert bundle.capture.projector is not None
    assert bundle.capture.projector.K is None
    boards = json.loads((tmp_path / "truth" / "truth.json").read_text())["boards"]
    for sequence in bundle.sequences("calibrate"):
        image = bundle.read_stored(sequence.frames[0].file)
        found, corners = cv2.findChessboardCornersSB(image, BOARD.inner_corners)
        assert found
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-4)
        corners = cv2.cornerSubPix(image, corners, (5, 5), (-1, -1), criteria)
        expected = np.array(boards[sequence.name]["corners_px"])
        got = corners.reshape(-1, 2)
        if np.linalg.norm(got[0] - expected[0]) > 20:
            got = got[::-1]
        np.testing.assert_allclose(got, expected, atol=0.2)
        assert np.sqrt(np.mean((got - expected) ** 2)) < 0.06
        assert np.abs(np.mean(got - expected, axis=0)).max() < 0.02


def test_photographs_cover_all_pairs_of_station_and_stop() -> None:
    layout = lay_out((64, 48), (64, 48), (64, 48), boards=0)
    plans = photo_plans(Setting(photos=40), layout)
    pairs = {(plan.camera, plan.stop) for plan in plans}
    assert len(pairs) == 20
    assert len({plan.turntable_deg for plan in plans}) == 8
    assert len(set(plans)) == 40
