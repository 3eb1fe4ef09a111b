"""Residuals of the boards, to and from a file."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from pipeline.errors import ImpastoError
from pipeline.formats.board_residuals import (
    BOARD_RESIDUALS,
    BoardResiduals,
    Correlation,
    ViewResiduals,
)

FILE = "calibrate/residuals.json"


@pytest.fixture
def workspace(tmp_path):
    (tmp_path / "calibrate").mkdir()
    return tmp_path


def example():
    view = ViewResiduals(
        "board-0", "C0", np.array([[1.5, 2.0], [30.0, 4.25]]), np.full((2, 2), 0.01), 500.0, 21.5
    )
    nothing = ViewResiduals("board-1", "C0", np.zeros((0, 2)), np.zeros((0, 2)), 400.0, 3.0)
    matrix = np.array([[1.0, 0.25], [0.25, 1.0]])
    return BoardResiduals(
        (view, nothing), (Correlation(("camera.fx", "camera.cx"), matrix),), (("b", "not found"),)
    )


@pytest.mark.parametrize("residuals", [example(), BoardResiduals()])
def test_round_trip(workspace, residuals):
    BOARD_RESIDUALS.save(workspace, residuals)
    again = BOARD_RESIDUALS.load(workspace)
    assert again.left_out == residuals.left_out
    for old, new in zip(residuals.views, again.views, strict=True):
        np.testing.assert_array_equal(old.pixels, new.pixels)
        np.testing.assert_array_equal(old.residuals, new.residuals)
        assert replace(old, pixels=None, residuals=None) == replace(
            new, pixels=None, residuals=None
        )
    for old, new in zip(residuals.correlations, again.correlations, strict=True):
        assert old.parameters == new.parameters
        np.testing.assert_array_equal(old.matrix, new.matrix)


@pytest.mark.parametrize(
    ("change", "what"),
    [
        (lambda d: d["views"][0]["residuals"].pop(), "1 residuals of 2 corners"),
        (lambda d: d["views"][0]["pixels"].append([1]), "pixels"),
        (lambda d: d["views"][0].update(tilt_deg="far"), "tilt_deg"),
        (lambda d: d["correlations"][0]["matrix"].pop(), "not 2 x 2"),
        (lambda d: d.pop("left_out"), "left_out"),
    ],
)
def test_a_malformed_file_is_named(workspace, change, what):
    BOARD_RESIDUALS.save(workspace, example())
    document = json.loads((workspace / FILE).read_text())
    change(document)
    (workspace / FILE).write_text(json.dumps(document))
    with pytest.raises(ImpastoError, match=what) as caught:
        BOARD_RESIDUALS.load(workspace)
    assert FILE in str(caught.value)
