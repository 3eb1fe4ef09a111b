"""The calibration's section: plots, and advice that follows from what was photographed."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.formats.board_residuals import BoardResiduals, Correlation, ViewResiduals
from pipeline.formats.calibration import Calibration, Residuals
from pipeline.geometry.camera import Lens
from pipeline.geometry.rigid import RigidTransform
from pipeline.report.calibration import advise, calibration, empty_cells, strongest

SIZE = (400, 300)


def rig():
    lens = Lens(SIZE, np.array([[500.0, 0, 200], [0, 500, 150], [0, 0, 1]]), np.zeros(5))
    return Calibration(
        "camera",
        "C0",
        {"C0": lens},
        {"C0": RigidTransform()},
        None,
        residuals={"C0": Residuals(0.02, 9, {"fx": 0.5})},
        origin={"C0": "calibrated"},
    )


def view(number, tilt=25.0, distance=500.0, low=(0, 0), high=SIZE):
    x, y = np.meshgrid(
        np.linspace(low[0] + 5, high[0] - 5, 9), np.linspace(low[1] + 5, high[1] - 5, 6)
    )
    pixels = np.stack([x.ravel(), y.ravel()], axis=1)
    return ViewResiduals(f"board-{number}", "C0", pixels, 0.01 * pixels / 100, distance, tilt)


def good():
    return [view(i, tilt=5 + 5 * i, distance=400 + 20 * i) for i in range(8)]


def test_good_boards_need_no_advice():
    assert advise(rig(), BoardResiduals(tuple(good())), "C0") == []


@pytest.mark.parametrize(
    ("views", "expected"),
    [
        ([*good()[:3], view(9, tilt=40)], "only 4 boards"),
        (
            [view(i, tilt=5 * i, distance=400 + 20 * i, low=(150, 100)) for i in range(8)],
            "no corner lies in the top left",
        ),
        ([view(i, tilt=3, distance=400 + 20 * i) for i in range(8)], "tilt by 3 to 3 degrees"),
        ([view(i, tilt=5 * i) for i in range(8)], "equally far"),
    ],
)
def test_advice_says_what_is_missing(views, expected):
    (line,) = [x for x in advise(rig(), BoardResiduals(tuple(views)), "C0") if expected in x]
    assert line.startswith("C0: ")


def test_empty_cells_are_those_without_corners():
    assert len(empty_cells(np.array([[0.0, 0.0]]), SIZE)) == 15
    assert empty_cells(view(0).pixels, SIZE) == []
    # Corners on or beyond the border count for the nearest part.
    assert (3, 3) not in empty_cells(np.array([[400.0, 310.0]]), SIZE)


def test_only_strong_correlations_are_named():
    matrix = np.array([[1, 0.99, 0.2], [0.99, 1, -0.97], [0.2, -0.97, 1]])
    assert strongest(Correlation(("a", "b", "c"), matrix)) == [("a", "b", 0.99), ("b", "c", -0.97)]


def test_the_section_draws_every_corner_and_names_what_was_left_out():
    fit = BoardResiduals(tuple(good()), (), (("board-<x>", "its board was not found"),))
    page = calibration(rig(), fit)
    assert page.count("<circle") == 8 * 54
    assert "board-&lt;x&gt;" in page
    assert "board-<x>" not in page
    assert "500.00 ± 0.50" in page


def test_given_devices_are_listed_without_plots():
    page = calibration(rig(), BoardResiduals())
    assert "nothing was calibrated" in page
    assert "<svg" not in page
