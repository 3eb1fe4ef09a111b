"""Synthetic canvases seen by a camera: exact range images with known truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
import scipy.special
from numpy.typing import NDArray

from pipeline.geometry.camera import Camera, Lens
from pipeline.geometry.raycast import RayCaster
from pipeline.geometry.rigid import RigidTransform, rotation_about_axis

FLOOR_MM = -20.0
STEP_MM = 0.5
Array = NDArray[np.float64]
Relief = Callable[[Array, Array], Array]


@dataclass(frozen=True)
class Scene:
    """A range image and what it shows.

    ``points`` (rows, columns, 3) and ``camera`` are in the scan's frame; ``scan_from_truth`` takes
    the canvas's own axes (origin in its middle) there; ``on_canvas`` tells the pixels' truth.
    """

    points: Array
    sigma: NDArray[np.float32]
    camera: Camera
    scan_from_truth: RigidTransform
    on_canvas: NDArray[np.bool_]
    relief: Relief

    @property
    def truth_points(self) -> Array:
        return self.scan_from_truth.inverse().apply(self.points)


def flat(x: Array, y: Array) -> Array:
    return np.zeros(np.broadcast_shapes(x.shape, y.shape))


def impasto(x: Array, y: Array) -> Array:
    """Smooth ground with steep-walled ridges and blobs up to 3 mm high."""
    step = scipy.special.expit
    ground = 0.3 * np.sin(x / 30) * np.cos(y / 25)
    ridge = 2.5 * step(6 * (1.5 - np.abs(y - 20 - 8 * np.sin(x / 15))))
    blob = 3.0 * step(-4 * (np.hypot(x + 40, y + 30) - 12))
    edge = 2.0 * step(-5 * (np.hypot(x - 98, y + 20) - 10))
    return ground + ridge + blob + edge


def deep(x: Array, y: Array) -> Array:
    """A plaque's relief of about 60 mm with slopes up to 60 degrees and a fold."""
    dome = 30 * np.exp(-((x - 25) ** 2 + (y + 20) ** 2) / (2 * 28**2))
    dale = -32 * np.exp(-((x + 30) ** 2 + (y - 15) ** 2) / (2 * 22**2))
    fold = 8 * scipy.special.expit((y + 45 - 6 * np.sin(x / 18)) / 1.2)
    return dome + dale + fold


@pytest.fixture(scope="session")
def make_scene() -> Callable[..., Scene]:
    """Give a factory of scenes: canvas of ``size`` mm, frame of ``frame`` mm height or none."""

    def make(
        relief: Relief = flat,
        *,
        size: tuple[float, float] = (200.0, 160.0),
        frame: float | None = 8.0,
        floor: bool = True,
        tilt_deg: tuple[float, float] = (0.0, 0.0),
        roll_deg: float = 0.0,
        noise: float = 0.03,
        holes: int = 0,
        hole_mm: float = 0.0,
        seed: int = 0,
        pixels: tuple[int, int] = (300, 250),
        shift_mm: tuple[float, float] = (0.0, 0.0),
    ) -> Scene:
        half = np.array(size) / 2
        reach = half + 60
        columns, rows = (2 * reach / STEP_MM).astype(int) + 1
        x = -reach[0] + STEP_MM * np.arange(columns)
        y = reach[1] - STEP_MM * np.arange(rows)
        inside = (np.abs(x)[None] <= half[0]) & (np.abs(y)[:, None] <= half[1])
        heights = np.where(inside, relief(x[None], y[:, None]), FLOOR_MM if floor else np.nan)
        if frame is not None:
            ring = (np.abs(x)[None] <= half[0] + 25) & (np.abs(y)[:, None] <= half[1] + 25)
            outward = np.maximum(np.abs(x)[None] - half[0], np.abs(y)[:, None] - half[1])
            profile = frame + np.clip(outward - 4, 0, 8) * 0.5
            heights = np.where(ring & ~inside, profile, heights)
        if hole_mm:
            open_ = np.hypot(x[None] - 20, y[:, None] + 10) < hole_mm / 2
            heights = np.where(open_, FLOOR_MM, heights)
        corner = np.array([x[0], y[0], 0.0])

        turn = (
            rotation_about_axis(np.zeros(3), np.array([1.0, 0, 0]), tilt_deg[0])
            @ rotation_about_axis(np.zeros(3), np.array([0, 1.0, 0]), tilt_deg[1])
            @ rotation_about_axis(np.zeros(3), np.array([0, 0, 1.0]), roll_deg)
        )
        facing = RigidTransform(np.diag([1.0, -1.0, -1.0]), np.array([*shift_mm, 700.0]))
        camera_from_truth = facing @ turn
        focal = 700 * pixels[0] / (size[0] + 120)
        centre = (np.array(pixels) - 1) / 2
        K = np.array([[focal, 0, centre[0]], [0, focal, centre[1]], [0, 0, 1.0]])
        lens = Lens(pixels, K, np.array([-0.05, 0.01, 0.0005, -0.0003, 0.0]))
        rays = lens.directions(lens.pixel_grid())
        truth_from_camera = camera_from_truth.inverse()
        directions = truth_from_camera.rotate(rays).reshape(-1, 3)
        origin = truth_from_camera.translation_mm - corner
        caster = RayCaster(heights, STEP_MM)
        t = caster.first_hit(np.broadcast_to(origin, directions.shape).copy(), directions)
        t = np.where(np.isfinite(t), t, np.nan).reshape(rays.shape[:2])
        rng = np.random.default_rng(seed)
        hit = truth_from_camera.apply(rays * t[..., None])
        seen = np.isfinite(t)
        on_canvas = seen & (np.abs(hit[..., 0]) <= half[0]) & (np.abs(hit[..., 1]) <= half[1])
        if hole_mm:
            on_canvas &= np.hypot(hit[..., 0] - 20, hit[..., 1] + 10) > hole_mm / 2
        if frame is not None or floor:  # walls belong to nobody
            expected = relief(hit[..., 0], hit[..., 1])
            on_canvas &= np.abs(hit[..., 2] - expected) < 1.5
        t = t + noise * rng.standard_normal(t.shape) / np.linalg.norm(rays, axis=-1)
        for _ in range(holes):
            r, c = rng.integers(0, t.shape[0] - 3), rng.integers(0, t.shape[1] - 3)
            t[r : r + rng.integers(1, 4), c : c + rng.integers(1, 4)] = np.nan
        scan_from_camera = rotation_about_axis(
            np.array([5.0, 3.0, 2.0]), np.array([1.0, 2.0, -1.0]), 35.0
        )
        pose = scan_from_camera.inverse()
        return Scene(
            scan_from_camera.apply(rays * t[..., None]),
            np.full(t.shape, max(noise, 1e-3), np.float32),
            Camera(lens, pose),
            scan_from_camera @ camera_from_truth,
            on_canvas & np.isfinite(t),
            relief,
        )

    return make


RELIEFS = {"flat": flat, "impasto": impasto, "deep": deep}


@pytest.fixture(scope="session")
def reliefs() -> dict[str, Relief]:
    return RELIEFS
