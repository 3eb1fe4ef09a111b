"""Extraction: kernel, spacing and noise against error on a framed canvas; SciPy's interpolation."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmarks.results import Result, Row, timed
from benchmarks.scene import Scene
from pipeline.extract.resample import grid_around, resample
from pipeline.extract.roughness import unresolved_variance

Array = NDArray[np.float64]


def measure(*, quick: bool = False) -> Result:
    """Resample scattered points of a known relief."""
    size = (240, 192) if quick else (480, 384)
    scene, dense = Scene(size), Scene((3 * size[0], 3 * size[1]))
    clean, axes = canvas_axes(scene.points)
    distance = float(np.sqrt(np.ptp(clean[:, 0]) * np.ptp(clean[:, 1]) / len(clean)))
    grid = grid_around(clean[:, :2] * 0.9, distance)
    fine, _ = canvas_axes(dense.points, axes)
    expected = griddata(fine, grid, "linear")
    rng, rows = np.random.default_rng(9), []
    for noise in (0.01,) if quick else (0.0, 0.01, 0.05):
        points = clean + np.array([0, 0, 1.0]) * rng.normal(0, noise, (len(clean), 1))
        sigma = np.full(len(points), max(noise, 1e-3))
        for width in (0.5, 0.75, 1.0, 1.5):
            seconds, (heights, deviation) = timed(
                lambda w=width, p=points, s=sigma: resample(p, s, grid, w * distance)
            )
            stated = np.sqrt(deviation**2 + unresolved_variance(heights, deviation))
            rows.append(row(f"kernel {width} samples, noise {noise} mm", seconds, heights, expected,
                            deviation=stated, default=width == 0.75))  # fmt: skip
        for method in ("linear", "cubic"):
            seconds, heights = timed(lambda m=method, p=points: griddata(p, grid, m), turns=1)
            rows.append(row(f"SciPy griddata {method}, noise {noise} mm", seconds, heights,
                            expected, peer=True))  # fmt: skip
    title = f"resampling {size[0] * size[1]} points of a relief"
    return Result("extract", title, "RMS error, um", rows)


def canvas_axes(points: Array, axes=None):  # type: ignore[no-untyped-def]
    """Return points (N, 3) in the axes of their own plane, or in given ones, and those axes."""
    flat = points.reshape(-1, 3)
    if axes is None:
        centre = flat.mean(axis=0)
        axes = centre, np.linalg.svd(flat[::7] - centre, full_matrices=False)[2]
    return (flat - axes[0]) @ axes[1].T, axes


def griddata(points: Array, grid, method: str) -> Array:  # type: ignore[no-untyped-def]
    """Interpolate with SciPy on the same grid."""
    from scipy.interpolate import griddata as interpolate

    x = grid.left_mm + np.arange(grid.columns) * grid.spacing_mm
    y = grid.top_mm - np.arange(grid.rows) * grid.spacing_mm
    return np.asarray(interpolate(points[:, :2], points[:, 2], tuple(np.meshgrid(x, y)), method))


def row(  # type: ignore[no-untyped-def]
    name, seconds, heights, expected, *, deviation=None, default=False, peer=False
) -> Row:
    """Compare with the truth."""
    error = heights - expected
    known = np.isfinite(error)
    figures: dict[str, float | str] = {"median um": 1000 * float(np.median(np.abs(error[known])))}
    if deviation is not None:
        figures["error / S"] = float(np.sqrt(np.mean((error[known] / deviation[known]) ** 2)))
    rms = 1000 * float(np.sqrt(np.mean(error[known] ** 2)))
    return Row(name, seconds, rms, default=default, peer=peer, figures=figures)
