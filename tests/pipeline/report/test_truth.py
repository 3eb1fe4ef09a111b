from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pipeline.errors import ImpastoError
from pipeline.formats.height_field import HeightField
from pipeline.formats.reflectance_maps import ReflectanceMaps
from pipeline.geometry.rigid import RigidTransform, rotation_about_axis
from pipeline.report.truth import TruthErrors, errors_against_truth

SPACING = 0.5
X, Y = np.arange(-30, 30.1, SPACING), np.arange(-20, 20.1, SPACING)
RIG_FROM_CANVAS = RigidTransform(np.eye(3), np.array([4.0, -3.0, 12.0])) @ rotation_about_axis(
    np.zeros(3), np.array([0.1, 0.2, 1.0]), 5.0
)
CAMERA_FROM_RIG = RigidTransform(np.diag([1.0, -1.0, -1.0]), np.array([1.0, 2.0, 500.0]))


def relief(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return 0.8 * np.sin(x / 2.1) * np.cos(y / 1.7) + 0.4 * np.sin(0.9 * x + 1.3 * y)


def rho(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.stack([0.1 + 0.05 * np.sin(x), 0.2 + 0 * x, 0.1 + 0.05 * np.cos(y)], axis=-1)


@pytest.fixture
def truth(tmp_path: Path) -> Path:
    x, y = np.meshgrid(X, Y)
    np.savez(
        tmp_path / "surface.npz",
        x_mm=X,
        y_mm=Y,
        height_mm=relief(x, y),
        mask=np.ones(x.shape, bool),
    )
    np.savez(tmp_path / "brdf.npz", rho_d=rho(x, y))
    document = {
        "rig_from_canvas": RIG_FROM_CANVAS.matrix.tolist(),
        "cameras": {
            "C0": {
                "R": CAMERA_FROM_RIG.rotation.tolist(),
                "t_mm": CAMERA_FROM_RIG.translation_mm.tolist(),
            }
        },
    }
    (tmp_path / "truth.json").write_text(json.dumps(document))
    return tmp_path


def measured(
    moved: RigidTransform | None = None,
    error: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None,
    frame: RigidTransform = RIG_FROM_CANVAS,
) -> HeightField:
    """Return the field that a scan would give: row 0 at the top, origin at its corner."""
    moved = moved or RigidTransform()
    canvas_from_field = RigidTransform(np.eye(3), np.array([X[0], Y[-1], 0.0]))
    x, y = np.meshgrid(X, Y[::-1])
    heights = relief(x, y) + (0 if error is None else error(x, y))
    nothing = np.zeros(heights.shape, np.float32)
    return HeightField(
        heights.astype(np.float32),
        nothing,
        nothing.astype(bool),
        SPACING,
        moved @ frame @ canvas_from_field,
    )


def maps(factor: float) -> ReflectanceMaps:
    x, y = np.meshgrid(X, Y[::-1])
    diffuse = (factor * rho(x, y)).astype(np.float32)
    flat = np.zeros(x.shape, np.float32)
    return ReflectanceMaps(
        diffuse,
        diffuse * 0,
        diffuse * 0,
        flat,
        flat.astype(np.int32),
        flat.astype(bool),
        absolute=False,
    )


def test_the_exact_field_has_no_error(truth: Path) -> None:
    errors = errors_against_truth(measured(), truth)
    assert errors.rms_mm < 1e-6
    assert np.isnan(errors.normalised_rms)
    assert errors.coverage > 0.95
    assert errors.rotation_deg < 1e-5
    assert errors.translation_mm < 1e-5


def test_a_camera_s_frame_is_recognised(truth: Path) -> None:
    errors = errors_against_truth(measured(frame=CAMERA_FROM_RIG @ RIG_FROM_CANVAS), truth)
    assert errors.rms_mm < 1e-6


@pytest.mark.parametrize("axis", [[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0], [1.0, -2.0, 0.5]])
def test_a_rigid_motion_is_aligned_away_and_told(truth: Path, axis: list[float]) -> None:
    turn = rotation_about_axis(RIG_FROM_CANVAS.translation_mm, np.array(axis), 0.6)
    shift = RigidTransform(np.eye(3), np.array([0.3, -0.2, 0.9]))
    errors = errors_against_truth(measured(shift @ turn), truth)
    # Bilinear interpolation of the relief between samples leaves some micrometres.
    assert errors.median_mm < 0.012
    assert errors.rotation_deg == pytest.approx(0.6, abs=0.01)
    assert errors.translation_mm == pytest.approx(np.linalg.norm([0.3, -0.2, 0.9]), abs=0.02)
    assert errors.coverage > 0.9


def test_a_bump_is_reported_where_it_is(truth: Path) -> None:
    errors = errors_against_truth(
        measured(error=lambda x, y: 0.5 * ((np.abs(x - 10) < 3) & (np.abs(y - 8) < 3))), truth
    )
    image = errors.error_mm
    rows, columns = image.shape
    row, column = round((20 - 8) / SPACING), round((10 + 30) / SPACING)  # row 0 is the top
    assert image[row, column] == pytest.approx(0.5, abs=0.01)
    assert abs(image[rows - 1 - row, column]) < 0.01
    assert abs(image[row, columns - 1 - column]) < 0.01
    assert errors.median_mm < 0.005
    assert errors.p99_mm == pytest.approx(0.5, abs=0.02)
    share = float(np.mean(np.abs(image[np.isfinite(image)]) > 0.25))
    assert errors.bias_mm == pytest.approx(0.5 * share, rel=0.1)


def test_noise_gives_its_own_percentiles(truth: Path) -> None:
    random = np.random.default_rng(3)
    field = measured(error=lambda x, y: random.normal(0, 0.05, x.shape))
    field.sigma_mm[:] = 0.025
    errors = errors_against_truth(field, truth)
    assert errors.normalised_rms == pytest.approx(2.0, rel=0.05)
    assert errors.rms_mm == pytest.approx(0.05, rel=0.05)
    assert errors.median_mm == pytest.approx(0.6745 * 0.05, rel=0.05)
    assert errors.p95_mm == pytest.approx(1.96 * 0.05, rel=0.05)
    assert errors.p99_mm == pytest.approx(2.576 * 0.05, rel=0.08)


def test_a_hole_costs_coverage_but_no_error(truth: Path) -> None:
    field = measured()
    field.heights_mm[: field.heights_mm.shape[0] // 2] = np.nan
    errors = errors_against_truth(field, truth)
    assert errors.coverage == pytest.approx(0.5, abs=0.03)
    assert errors.rms_mm < 1e-6


def test_outliers_do_not_pull_the_alignment(truth: Path) -> None:
    errors = errors_against_truth(measured(error=lambda x, y: 5.0 * (x > 25)), truth)
    assert errors.median_mm < 1e-4
    assert errors.translation_mm < 1e-3


def test_diffuse_albedo_is_compared_up_to_its_scale(truth: Path) -> None:
    diffuse = errors_against_truth(measured(), truth, maps=maps(2.5)).diffuse
    assert diffuse is not None
    assert diffuse.scale == pytest.approx(2.5, rel=1e-5)
    assert diffuse.median < 1e-5

    wrong = maps(1.0)
    wrong.diffuse[..., 1] *= 1.1
    diffuse = errors_against_truth(measured(), truth, maps=wrong).diffuse
    assert diffuse is not None
    assert diffuse.scale == pytest.approx(1.0, rel=1e-5)
    assert diffuse.p95 == pytest.approx(0.1, rel=1e-3)


def test_without_true_albedo_there_is_none_to_compare(truth: Path) -> None:
    (truth / "brdf.npz").unlink()
    assert errors_against_truth(measured(), truth, maps=maps(1.0)).diffuse is None


def test_the_table_has_a_row_for_each_figure(truth: Path) -> None:
    errors = errors_against_truth(measured(), truth, maps=maps(1.0))
    assert isinstance(errors, TruthErrors)
    rows = errors.rows()
    assert len(rows) == 12
    assert all(len(row) == 3 for row in rows)


def test_another_capture_s_truth_is_refused(truth: Path) -> None:
    elsewhere = RigidTransform(np.eye(3), np.array([300.0, 0.0, 0.0]))
    with pytest.raises(ImpastoError, match="the truth of this capture"):
        errors_against_truth(measured(elsewhere), truth)


def test_nothing_measured_is_refused(truth: Path) -> None:
    field = measured()
    field.heights_mm[:] = np.nan
    with pytest.raises(ImpastoError, match="lies where the truth"):
        errors_against_truth(field, truth)


def test_a_flat_surface_cannot_be_aligned(truth: Path) -> None:
    x, _ = np.meshgrid(X, Y)
    np.savez(truth / "surface.npz", x_mm=X, y_mm=Y, height_mm=0 * x, mask=np.ones(x.shape, bool))
    with pytest.raises(ImpastoError, match="leave a direction"):
        errors_against_truth(measured(), truth)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"x_mm": X[::-1]}, "ascending"),
        ({"x_mm": X[:-1]}, "shape"),
        ({"x_mm": X[:1]}, "axes"),
        ({"mask": np.zeros((len(Y), len(X)), bool)}, "empty"),
        ({"height_mm": np.array([None])}, "cannot be read"),
    ],
)
def test_a_malformed_surface_is_named(truth: Path, change: dict, match: str) -> None:
    with np.load(truth / "surface.npz") as archive:
        arrays = dict(archive)
    np.savez(truth / "surface.npz", **(arrays | change))
    with pytest.raises(ImpastoError, match=match) as caught:
        errors_against_truth(measured(), truth)
    assert "surface.npz" in str(caught.value)


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"rig_from_canvas": 3, "cameras": {}}'])
def test_a_malformed_document_is_named(truth: Path, text: str) -> None:
    (truth / "truth.json").write_text(text)
    with pytest.raises(ImpastoError, match=r"truth\.json"):
        errors_against_truth(measured(), truth)


def test_an_absent_truth_is_named(tmp_path: Path) -> None:
    with pytest.raises(ImpastoError, match=r"surface\.npz: the file does not exist"):
        errors_against_truth(measured(), tmp_path)
