"""What a camera sees of an object under a projector or a lamp: geometry once, light per frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from hardware.simulated.painting import Scene
from pipeline.geometry.camera import Camera
from pipeline.geometry.raycast import RayCaster
from pipeline.geometry.rigid import RigidTransform

Array = NDArray[np.float64]

_SHADOW_MARGIN_MM = 0.02


@dataclass(frozen=True)
class Seen:
    """What each ray of a camera meets; arrays over rays (rows, columns, ...), object's frame.

    ``points_mm`` is NaN where a ray meets nothing; ``normals`` are unit vectors towards the viewer;
    ``diffuse``, ``specular``, ``lobe`` as in the scene.
    """

    points_mm: Array
    normals: Array
    diffuse: Array
    specular: Array
    lobe: Array


class Solid(Protocol):
    """An object in its own frame."""

    def look(self, origin_mm: Array, directions: Array) -> Seen:
        """Meet rays (rows, columns, 3) from one point."""

    def lit(self, points_mm: Array, light_mm: Array) -> NDArray[np.bool_]:
        """Tell which points see the light."""


class PaintingSolid:
    """A painted height field."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        width, height = scene.size_mm
        self._corner = np.array([width / 2, -height / 2, 0.0])
        self._caster = RayCaster(scene.heights_mm, scene.spacing_mm)
        down, right = np.gradient(scene.heights_mm.astype(np.float64), scene.spacing_mm)
        normals = np.stack([-right, down, np.ones_like(down)], axis=-1)
        self._normals = (normals / np.linalg.norm(normals, axis=2, keepdims=True)).astype(
            np.float32
        )

    def look(self, origin_mm: Array, directions: Array) -> Seen:
        """Meet rays from one point."""
        flat = directions.reshape(-1, 3)
        origins = np.broadcast_to(origin_mm + self._corner, flat.shape)
        distance = self._caster.first_hit(np.ascontiguousarray(origins), flat)
        distance[~np.isfinite(distance)] = np.nan
        points = (origin_mm + flat * distance[:, None]).reshape(directions.shape)
        column = ((points[..., 0] + self._corner[0]) / self.scene.spacing_mm).astype(np.float32)
        row = ((-points[..., 1] - self._corner[1]) / self.scene.spacing_mm).astype(np.float32)

        def sample(image: NDArray[np.float32]) -> Array:
            return cv2.remap(image, column, row, cv2.INTER_LINEAR).astype(np.float64)

        normals = sample(self._normals)
        normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-9)
        scene = self.scene
        return Seen(
            points, normals, sample(scene.diffuse), sample(scene.specular), sample(scene.lobe)
        )

    def lit(self, points_mm: Array, light_mm: Array) -> NDArray[np.bool_]:
        """Tell which points see the light."""
        flat = points_mm.reshape(-1, 3)
        lit = np.zeros(len(flat), dtype=bool)
        known = np.isfinite(flat[:, 0])
        origins = flat[known] + self._corner
        target = np.broadcast_to(light_mm + self._corner, origins.shape)
        lit[known] = ~self._caster.occluded(
            origins, np.ascontiguousarray(target), _SHADOW_MARGIN_MM
        )
        return lit.reshape(points_mm.shape[:-1])


class BoardSolid:
    """A matte chessboard in the plane z = 0, its first inner corner at the origin."""

    def __init__(self, inner_corners: tuple[int, int], square_mm: float) -> None:
        self.inner_corners, self.square_mm = inner_corners, square_mm

    def look(self, origin_mm: Array, directions: Array) -> Seen:
        """Meet rays from one point."""
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = -origin_mm[2] / directions[..., 2]
        points = origin_mm + directions * np.where(distance > 0, distance, np.nan)[..., None]
        u, v = points[..., 0] / self.square_mm, points[..., 1] / self.square_mm
        columns, rows = self.inner_corners
        on_board = (u > -2) & (u < columns + 1) & (v > -2) & (v < rows + 1)
        in_squares = (u > -1) & (u < columns) & (v > -1) & (v < rows)
        dark = in_squares & ((np.floor(u) + np.floor(v)) % 2 == 0)
        points[~on_board] = np.nan
        side = np.sign(origin_mm[2]) or 1.0
        normals = np.broadcast_to(np.array([0.0, 0.0, side]), points.shape)
        diffuse = np.where(dark, 0.05, 0.8)[..., None] / np.pi * np.ones(3)
        nothing = np.zeros_like(points)
        return Seen(points, normals, diffuse, nothing, nothing + np.array([0.0, 0.0, 1.0]))

    def lit(self, points_mm: Array, light_mm: Array) -> NDArray[np.bool_]:
        """Tell which points see the light: all on the light's side of the plane."""
        return np.isfinite(points_mm[..., 0]) & (light_mm[2] != 0)


def look(camera: Camera, solid: Solid, rig_from_object: RigidTransform, samples: int) -> Seen:
    """Meet ``samples`` x ``samples`` rays per pixel, laid out on a finer grid of the same image."""
    width, height = camera.lens.size_px
    x, y = ((np.arange(size * samples) + 0.5) / samples - 0.5 for size in (width, height))
    pixels = np.stack(np.meshgrid(x, y), axis=-1)
    origin, directions = camera.rays(pixels)
    back = rig_from_object.inverse()
    return solid.look(back.apply(origin), back.rotate(directions))


def reflected(seen: Seen, view_mm: Array, light_mm: Array, intensity: float) -> Array:
    """Return the radiance (rows, columns, 3) towards the viewer of a point light, unshadowed.

    f = rho_d + rho_s max(0, C_xy (v . l - v_z l_z) + C_z v_z l_z)^k with z the normal;
    E = I cos / r^2, r in m.
    """
    to_light, to_eye = light_mm - seen.points_mm, view_mm - seen.points_mm
    distance = np.linalg.norm(to_light, axis=-1)
    to_light = to_light / distance[..., None]
    to_eye = to_eye / np.linalg.norm(to_eye, axis=-1, keepdims=True)
    cosine = (seen.normals * to_light).sum(axis=-1)
    along = cosine * (seen.normals * to_eye).sum(axis=-1)
    across = (to_light * to_eye).sum(axis=-1) - along
    base = np.maximum(seen.lobe[..., 0] * across + seen.lobe[..., 1] * along, 0)
    brdf = seen.diffuse + seen.specular * (base ** seen.lobe[..., 2])[..., None]
    irradiance = intensity * np.maximum(cosine, 0) / (distance * 1e-3) ** 2
    return np.nan_to_num(brdf * irradiance[..., None])


def gather(radiance: NDArray[np.floating], samples: int, spread_px: float) -> Array:
    """Average the rays of each pixel and blur with the lens's point spread (sigma, px)."""
    fine = radiance.astype(np.float32, copy=False)
    fine = cv2.GaussianBlur(fine, (0, 0), max(spread_px * samples, 1e-3))
    if samples == 1:
        return fine.astype(np.float64)
    rows, columns = fine.shape[0] // samples, fine.shape[1] // samples
    return cv2.resize(fine, (columns, rows), interpolation=cv2.INTER_AREA).astype(np.float64)


@dataclass(frozen=True)
class Sensor:
    """Shot noise, read noise, saturation and rounding of a sensor."""

    full_well_e: float = 15000.0
    read_noise_e: float = 4.0
    bits: int = 12
    responsivity_per_s: float = 40.0

    def record(
        self, radiance: Array, exposure_s: float, random: np.random.Generator, stored_bits: int
    ) -> NDArray[np.uint8] | NDArray[np.uint16]:
        """Turn radiance into a stored image."""
        electrons = radiance * (exposure_s * self.responsivity_per_s * self.full_well_e)
        noise = random.standard_normal(electrons.shape, dtype=np.float32)
        electrons = electrons + noise * np.sqrt(np.maximum(electrons, 0) + self.read_noise_e**2)
        levels = 2 ** min(self.bits, stored_bits) - 1
        value = np.clip(np.rint(electrons / self.full_well_e * levels), 0, levels)
        kind = np.uint8 if stored_bits == 8 else np.uint16
        return np.rint(value * ((2**stored_bits - 1) / levels)).astype(kind)
