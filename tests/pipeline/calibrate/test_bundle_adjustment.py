"""The joint adjustment: known parameters, honest deviations, degenerate sets, outliers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.calibrate.bundle_adjustment import (
    LENS_PARAMETERS,
    POSE_PARAMETERS,
    Start,
    adjust,
    lens_vector,
    pose_vector,
    vector_lens,
    vector_pose,
)
from pipeline.calibrate.initial import board_pose, start_lens, start_projector
from pipeline.errors import ImpastoError

from .conftest import CAMERA, PROJECTOR


def start_of(views, **changes) -> Start:
    lens = start_lens([v.points for v in views], [v.camera_px for v in views], CAMERA.size_px, "C0")
    boards = tuple(board_pose(lens, v.points, v.camera_px) for v in views)
    projector = start_projector(views, boards, None, PROJECTOR.lens.size_px)
    return replace(Start(lens, projector, boards), **changes)


def test_without_noise_every_parameter_is_found(make_views) -> None:
    views, poses = make_views(noise_px=0.0)
    found = adjust(views, start_of(views))
    np.testing.assert_allclose(lens_vector(found.camera)[:4], lens_vector(CAMERA)[:4], atol=1e-3)
    np.testing.assert_allclose(found.projector.lens.K, PROJECTOR.lens.K, atol=2e-3)
    np.testing.assert_allclose(
        found.projector.pose.translation_mm, PROJECTOR.pose.translation_mm, atol=1e-3
    )
    np.testing.assert_allclose(found.boards[2].matrix, poses[2].matrix, atol=1e-3)
    assert found.camera_rms_px < 1e-5


@pytest.mark.slow
def test_errors_over_their_stated_deviations_have_unit_variance(make_views) -> None:
    normalised = []
    for seed in range(12):
        views, _ = make_views(seed=seed)
        found = adjust(views, start_of(views))
        for lens, truth, deviation in (
            (found.camera, CAMERA, found.camera_deviation),
            (found.projector.lens, PROJECTOR.lens, found.projector_deviation),
        ):
            error = lens_vector(lens) - lens_vector(truth)
            normalised += [
                e / deviation[n] for n, e in zip(LENS_PARAMETERS, error, strict=True) if n != "k3"
            ]
        error = pose_vector(found.projector.pose) - pose_vector(PROJECTOR.pose)
        normalised += [
            e / found.projector_deviation[n] for n, e in zip(POSE_PARAMETERS, error, strict=True)
        ]
    # 264 values, correlated within a seed: the RMS of so many is within a fifth of 1.
    assert 0.8 < np.sqrt(np.mean(np.square(normalised))) < 1.25


def test_what_is_given_is_held(make_views) -> None:
    views, _ = make_views()
    start = replace(start_of(views), camera=CAMERA, camera_given=True)
    found = adjust(views, start)
    np.testing.assert_array_equal(lens_vector(found.camera), lens_vector(CAMERA))
    assert found.camera_deviation == {}
    held = replace(start, projector=PROJECTOR, projector_given=True, projector_pose_given=True)
    found = adjust(views, held)
    np.testing.assert_array_equal(found.projector.pose.matrix, PROJECTOR.pose.matrix)
    assert found.projector_deviation == {}


def test_outlying_corners_hardly_move_the_result(make_views) -> None:
    views, _ = make_views()
    spoilt = views[0].camera_px.copy()
    spoilt[::9] += 4.0
    views[0] = replace(views[0], camera_px=spoilt)
    clean = adjust(*(lambda v: (v, start_of(v)))(make_views()[0]))
    found = adjust(views, start_of(views))
    assert abs(found.camera.K[0, 0] - clean.camera.K[0, 0]) < clean.camera_deviation["fx"]
    assert found.view_rms_px["board-0"] > 3 * found.view_rms_px["board-1"]


def test_boards_that_are_all_parallel_are_refused_with_advice(make_views) -> None:
    views, poses = make_views(6, tilt_deg=0.0)
    start = Start(CAMERA, PROJECTOR, tuple(poses))
    with pytest.raises(ImpastoError, match="do not determine the calibration") as problem:
        adjust(views, start)
    assert "tilted" in str(problem.value)


def test_too_few_boards_are_refused_with_advice(make_views) -> None:
    views, _ = make_views(2)
    with pytest.raises(ImpastoError, match="cannot be calibrated from 2 board views"):
        start_of(views)


def test_corners_that_were_not_decoded_are_left_out(make_views) -> None:
    views, _ = make_views()
    holes = views[3].projector_px.copy()
    holes[::2] = np.nan
    views[3] = replace(views[3], projector_px=holes)
    found = adjust(views, start_of(views))
    assert np.isfinite(list(found.projector_deviation.values())).all()
    assert found.projector_rms_px < 0.12


def test_vectors_round_trip() -> None:
    lens = vector_lens(lens_vector(CAMERA), CAMERA.size_px)
    np.testing.assert_array_equal(lens.K, CAMERA.K)
    pose = vector_pose(pose_vector(PROJECTOR.pose))
    np.testing.assert_allclose(pose.matrix, PROJECTOR.pose.matrix, atol=1e-12)
