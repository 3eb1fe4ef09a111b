"""Extraction: kernel, spacing and noise against error on a framed canvas; SciPy's interpolation."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmarks.results import Result, Row, timed
from benchmarks.scene import Scene
from pipeline.extract.resample import grid_around, resample

Array = NDArray[np.float64]


def measure(*, quick: bool = False) -> Result:
    """Resample scattered points of a known relief."""
    size = (320, 256) if quick else (640, 512)
    rows = []
    for noise in (0.01,) if quick else (0.0, 0.01, 0.05):
        points, truth, distance = scattered(size, noise)
        sigma = np.full(len(points), max(noise, 1e-3))
        inside = grid_around(points[:, :2] * 0.9, distance)
        expected = truth(inside)
        for width in (0.5, 0.75, 1.0, 1.5):
            seconds, (heights, deviation) = timed(
                lambda w=width, p=points, s=sigma, g=inside, d=distance: resample(p, s, g, w * d)
            )
            rows.append(row(f"kernel {width} samples, noise {noise} mm", seconds, heights, expected,
                            deviation=deviation, default=width == 0.75))  # fmt: skip
        for method in ("linear", "cubic"):
            seconds, heights = timed(
                lambda m=method, p=points, g=inside: griddata(p, g, m), turns=1
            )
            rows.append(row(f"SciPy griddata {method}, noise {noise} mm", seconds, heights,
                            expected, peer=True))  # fmt: skip
    title = f"resampling {size[0] * size[1]} points of a relief"
    return Result("extract", title, "RMS error, um", rows)


def scattered(size, noise):  # type: ignore[no-untyped-def]
    """Return points of a scan in the canvas plane's axes, the truth, the spacing."""
    scene = Scene(size)
    flat = scene.points.reshape(-1, 3)
    centre = flat.mean(axis=0)
    axes = np.linalg.svd(flat[::7] - centre, full_matrices=False)[2]
    local = (flat - centre) @ axes.T
    rng = np.random.default_rng(9)
    points = local + np.array([0, 0, 1.0]) * rng.normal(0, noise, (len(local), 1))
    area = np.ptp(local[:, 0]) * np.ptp(local[:, 1])
    dense = Scene((size[0] * 3, size[1] * 3))
    dense_local = (dense.points.reshape(-1, 3) - centre) @ axes.T

    def truth(grid) -> Array:  # type: ignore[no-untyped-def]
        return griddata(dense_local, grid, "linear")

    return points, truth, float(np.sqrt(area / len(local)))


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
