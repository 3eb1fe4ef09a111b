from __future__ import annotations

import numpy as np
import pytest

from pipeline.extract.resample import Grid, _bins, grid_around, resample


def scatter(seed: int, distance: float, side: float = 40.0) -> np.ndarray:
    """Jittered points about ``distance`` apart on a square."""
    rng = np.random.default_rng(seed)
    n = int(side / distance)
    x, y = np.meshgrid(np.arange(n) * distance, np.arange(n) * distance)
    points = np.stack([x, y], axis=-1).reshape(-1, 2)
    return points + rng.uniform(-0.3, 0.3, points.shape) * distance


def truth_at(grid: Grid, surface) -> np.ndarray:
    x = grid.left_mm + np.arange(grid.columns) * grid.spacing_mm
    y = grid.top_mm - np.arange(grid.rows) * grid.spacing_mm
    return surface(x[None, :], y[:, None])


def with_heights(points: np.ndarray, surface) -> np.ndarray:
    return np.column_stack([points, surface(points[:, 0], points[:, 1])])


def test_quadratics_are_reproduced_exactly() -> None:
    def surface(x, y):
        return 1 + 0.2 * x - 0.1 * y + 0.03 * x * x - 0.02 * x * y + 0.01 * y * y

    points = with_heights(scatter(0, 0.5), surface)
    grid = Grid(5.0, 30.0, 40, 45, 0.6)
    heights, sigma = resample(points, np.full(len(points), 0.1), grid, 0.45)
    assert heights == pytest.approx(truth_at(grid, surface), abs=1e-5)
    assert np.isfinite(sigma).all()


def test_a_wave_of_eight_samples_keeps_its_height() -> None:
    def surface(x, y):
        return np.sin(2 * np.pi * x / 4) + 0 * y

    points = with_heights(scatter(1, 0.5), surface)
    grid = Grid(5.0, 30.0, 40, 60, 0.5)
    heights, _ = resample(points, np.full(len(points), 0.1), grid, 0.75 * 0.5)
    error = heights - truth_at(grid, surface)
    assert np.sqrt(np.mean(error**2)) < 0.02  # a local line flattens it by a tenth


def test_sigma_tells_the_error() -> None:
    rng = np.random.default_rng(2)
    points = with_heights(scatter(2, 0.5), lambda x, y: 0.1 * x + 0 * y)
    sigma = rng.uniform(0.05, 0.2, len(points))
    points[:, 2] += sigma * rng.standard_normal(len(points))
    grid = Grid(2.0, 38.0, 36, 36, 1.0)
    heights, deviation = resample(points, sigma, grid, 0.375)
    normalised = (heights - truth_at(grid, lambda x, y: 0.1 * x + 0 * y)) / deviation
    assert np.sqrt(np.mean(normalised**2)) == pytest.approx(1, abs=0.1)


def test_weights_prefer_the_better_points() -> None:
    points = with_heights(scatter(3, 0.5), lambda x, y: 0 * x * y)
    bad = np.arange(len(points)) % 2 == 0
    points[bad, 2] += 1.0
    grid = Grid(5.0, 35.0, 20, 20, 1.0)
    heights, _ = resample(points, np.where(bad, 0.4, 0.1), grid, 0.8)
    assert np.median(heights) < 0.15  # weights 1 : 16


def test_a_coarse_grid_does_not_alias() -> None:
    def ripple(x, y):
        return np.sin(2 * np.pi * x / 1.1) + 0 * y

    points = with_heights(scatter(4, 0.2), ripple)
    grid = Grid(6.0, 34.0, 14, 14, 2.0)
    heights, _ = resample(points, np.ones(len(points)), grid, 1.5)
    assert np.abs(heights).max() < 0.05


def test_outside_there_is_nothing_and_a_gap_stays() -> None:
    points = with_heights(scatter(5, 0.5), lambda x, y: 0 * x * y)
    gap = np.hypot(points[:, 0] - 20, points[:, 1] - 20) < 5
    points = points[~gap]
    grid = Grid(-10.0, 50.0, 121, 121, 0.5)
    heights, sigma = resample(points, np.ones(len(points)), grid, 0.375)
    assert np.array_equal(np.isnan(heights), np.isnan(sigma))
    x = grid.left_mm + 0.5 * np.arange(121)
    y = grid.top_mm - 0.5 * np.arange(121)
    away = np.maximum(np.abs(x - 19.75)[None], np.abs(y - 19.75)[:, None])
    assert np.isnan(heights[away > 20.6]).all()
    assert np.isfinite(heights[(away < 19) & (np.hypot(x[None] - 20, y[:, None] - 20) > 6)]).all()
    assert np.isnan(heights[np.hypot(x[None] - 20, y[:, None] - 20) < 4]).all()


def test_unknown_sigmas_count_as_the_median() -> None:
    points = with_heights(scatter(6, 0.5), lambda x, y: 0 * x + y)
    sigma = np.full(len(points), 0.1)
    sigma[::3] = np.nan
    sigma[1::7] = 0.0
    grid = Grid(5.0, 30.0, 10, 10, 1.0)
    heights, deviation = resample(points, sigma, grid, 0.4)
    reference = resample(points, np.full(len(points), 0.1), grid, 0.4)
    assert heights == pytest.approx(reference[0], abs=1e-5)
    assert deviation == pytest.approx(reference[1], rel=1e-6)


def test_the_same_bytes_again_and_far_from_the_origin() -> None:
    points = with_heights(scatter(7, 0.5), lambda x, y: np.sin(x) * np.cos(y))
    grid = Grid(5.0, 30.0, 50, 50, 0.5)
    sigma = np.full(len(points), 0.1)
    first, second = (resample(points, sigma, grid, 0.4) for _ in range(2))
    assert first[0].tobytes() == second[0].tobytes()
    assert first[1].tobytes() == second[1].tobytes()
    away = points + np.array([1e6, -1e6, 0])
    far = resample(away, sigma, Grid(1e6 + 5, 30 - 1e6, 50, 50, 0.5), 0.4)
    assert far[0] == pytest.approx(first[0], abs=1e-5)


def test_a_grid_is_centred_on_its_points() -> None:
    grid = grid_around(np.array([[0.0, 0.0], [10.0, 4.1]]), 1.0)
    assert (grid.rows, grid.columns) == (5, 11)
    assert grid.left_mm == pytest.approx(0)
    assert grid.top_mm == pytest.approx(2.05 + 2)
    single = grid_around(np.array([[3.0, 4.0]]), 1.0)
    assert (single.rows, single.columns, single.left_mm, single.top_mm) == (1, 1, 3.0, 4.0)


def test_a_kernel_must_have_a_width() -> None:
    with pytest.raises(ValueError, match="positive"):
        resample(np.zeros((3, 3)), np.ones(3), Grid(0, 0, 2, 2, 1.0), 0.0)


@pytest.mark.parametrize("rows", [49, 553, 241])
def test_a_grid_that_ends_on_a_bin_s_edge_stays_inside_the_bins(rows: int) -> None:
    """Which bin a sample on an edge falls in is a matter of rounding; all of them must exist."""
    rng = np.random.default_rng(rows)
    for _ in range(300):
        spacing = float(rng.uniform(0.1, 1))
        grid = Grid(float(rng.uniform(-200, 200)), float(rng.uniform(-200, 200)), rows, 2, spacing)
        side = 3.2 * 0.75 * spacing
        _, starts, shape = _bins(np.zeros((1, 3)), grid, side)
        bottom = grid.top_mm - (rows - 1) * spacing
        last = int((grid.top_mm - bottom) / side) + 1
        assert last + 1 < shape[0]
        assert (last + 1) * shape[1] + 1 + 2 < len(starts)
