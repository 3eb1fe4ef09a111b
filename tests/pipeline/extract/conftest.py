"""Synthetic canvases seen by a camera: exact range images with known truth."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
import scipy.special
from numpy.typing import NDArray
from scipy import ndimage

from pipeline.formats.calibration import Calibration
from pipeline.formats.placement_scans import PlacementScan
from pipeline.formats.range_image import RangeImage, Texture
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


PAINT_STEP_MM = 0.25
CAMERA_FROM_TABLE = RigidTransform(np.diag([1.0, -1, -1]), np.array([0.0, 0, 600.0]))
LAMP_MM = np.array([150.0, 60.0, 560.0])  # in the table's axes: the camera looks down on it


@dataclass(frozen=True)
class Painting:
    """A relief and its albedo around the canvas's middle; it is moved, the rig stays."""

    x: Array
    y: Array
    heights: Array
    albedo: Array

    def at(self, points: Array, image: Array | None = None) -> Array:
        """Return the height, or what another image holds, under points (..., 2 or 3)."""
        place = [(self.y[0] - points[..., 1]), (points[..., 0] - self.x[0])]
        return ndimage.map_coordinates(
            self.heights if image is None else image,
            [np.nan_to_num(p / PAINT_STEP_MM) for p in place],
            order=1,
            cval=np.nan,
        )


@pytest.fixture(scope="session")
def make_painting() -> Callable[..., Painting]:
    @functools.cache
    def make(
        relief: float = 0.25,
        contrast: float = 0.4,
        bulge: float = 0.0,
        size: tuple[float, float] = (260.0, 180.0),
        seed: int = 0,
    ) -> Painting:
        rng = np.random.default_rng(seed)
        columns, rows = (int(n / PAINT_STEP_MM) + 1 for n in size)
        x = (np.arange(columns) - (columns - 1) / 2) * PAINT_STEP_MM
        y = -(np.arange(rows) - (rows - 1) / 2) * PAINT_STEP_MM

        def strokes(width: float) -> Array:
            image = rng.standard_normal((rows, columns))
            image = ndimage.gaussian_filter(image, width / PAINT_STEP_MM)
            return image / image.std()

        heights = relief * (0.6 * strokes(1.5) + 0.8 * strokes(5.0))
        heights = heights - bulge * ((2 * x / size[0]) ** 2 + 0.7 * (2 * y[:, None] / size[1]) ** 2)
        return Painting(x, y, heights, 0.3 * np.exp(contrast * (strokes(1.2) + strokes(8.0))))

    return make


@pytest.fixture(scope="session")
def move() -> Callable[..., RigidTransform]:
    """Give motions of the canvas on the table: shift, turn in the plane, two tilts, lift."""

    def made(
        x: float, y: float, turn: float = 0.0, tilt: tuple[float, float] = (0, 0), z: float = 0.0
    ) -> RigidTransform:
        turned = (
            rotation_about_axis(np.zeros(3), np.array([0, 0, 1.0]), turn)
            @ rotation_about_axis(np.zeros(3), np.array([1.0, 0, 0]), tilt[0])
            @ rotation_about_axis(np.zeros(3), np.array([0, 1.0, 0]), tilt[1])
        )
        return RigidTransform(turned.rotation, np.array([x, y, z]))

    return made


@dataclass(frozen=True)
class Table:
    """A rig over a table, and scans of a painting that lies on it; the table's is the scan's."""

    camera: Camera
    calibration: Calibration

    def scan(
        self,
        painting: Painting,
        table_from_canvas: RigidTransform,
        name: str,
        *,
        noise: float = 0.02,
        stated: float | None = None,
        gain: float = 1.0,
        seed: int = 0,
    ) -> PlacementScan:
        """Scan it; where the picture reaches beyond the canvas there is nothing."""
        rng = np.random.default_rng(seed)
        rays = self.camera.lens.directions(self.camera.lens.pixel_grid())
        back = table_from_canvas.inverse() @ self.camera.pose.inverse()
        directions = back.rotate(rays).reshape(-1, 3)
        origin = back.translation_mm - np.array([painting.x[0], painting.y[0], 0])
        t = RayCaster(painting.heights, PAINT_STEP_MM).first_hit(
            np.broadcast_to(origin, directions.shape).copy(), directions
        )
        t = np.where(np.isfinite(t), t, np.nan).reshape(rays.shape[:2])
        hit = back.apply(rays * t[..., None])
        down, right = np.gradient(painting.heights, PAINT_STEP_MM)
        normal = np.stack(
            [-painting.at(hit, right), painting.at(hit, down), np.ones_like(t)], axis=-1
        )
        normal = table_from_canvas.rotate(normal / np.linalg.norm(normal, axis=-1, keepdims=True))
        way = LAMP_MM - table_from_canvas.apply(hit)
        distance = np.linalg.norm(way, axis=-1)
        cosine = np.maximum(np.einsum("...i,...i", normal, way) / distance, 0)
        light = gain * painting.at(hit, painting.albedo) * cosine / (distance / 1000) ** 2
        light = light * (1 + 0.01 * rng.standard_normal(t.shape))
        known = np.isfinite(t)
        t = t + noise * rng.standard_normal(t.shape) / np.linalg.norm(rays, axis=-1)
        points = self.camera.pose.inverse().apply(rays * t[..., None])
        sigma = np.where(known, noise if stated is None else stated, np.nan)
        return PlacementScan(
            name,
            RangeImage(points.astype(np.float32), sigma.astype(np.float32)),
            Texture(np.where(known, light, np.nan).astype(np.float32), "white"),
        )


@pytest.fixture(scope="session")
def table() -> Table:
    K = np.array([[1150.0, 0, 129.5], [0, 1150.0, 99.5], [0, 0, 1]])
    lens = Lens((260, 200), K, np.array([-0.05, 0.01, 0.0005, -0.0003, 0]))
    camera = Camera(lens, CAMERA_FROM_TABLE)
    projector = Camera(lens, RigidTransform(np.eye(3), -LAMP_MM))
    known = Calibration("rig", "C0", {"C0": lens}, {"C0": camera.pose}, projector)
    return Table(camera, known)
