"""Light: from a source to the subject, from there to the camera's pixels, and into its sensor."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from hardware.simulated.subjects import Hits, Subject
from pipeline.formats.patterns import Pattern, Product, pattern_image
from pipeline.geometry.camera import Camera, Lens

Array = NDArray[np.float64]
Image = NDArray[np.float32]

GREY = np.array([0.25, 0.5, 0.25], np.float32)
"""A Bayer mosaic's mean of R, G, G and B."""


@dataclass(frozen=True)
class Eye:
    """A camera's rays, ``samples`` x ``samples`` per pixel, in the rig's frame.

    Parameters
    ----------
    directions
        (rows x columns x samples^2, 3); the samples of a pixel follow one another.
    """

    camera: Camera
    origin_mm: Array
    directions: Array


def lens_rays(lens: Lens, samples: int) -> Array:
    """Return the directions of a lens's rays in the camera's frame, in the order of an eye."""
    pixels = lens.pixel_grid()[:, :, None, None, :]
    offset = (np.arange(samples) + 0.5) / samples - 0.5
    inside = np.stack(np.meshgrid(offset, offset), axis=-1)
    return lens.directions((pixels + inside).reshape(-1, 2))


def open_eye(camera: Camera, rays: Array) -> Eye:
    """Point a lens's rays to where its camera looks."""
    return Eye(camera, camera.centre_mm, camera.pose.inverse().rotate(rays))


def reflected(hits: Hits, view_mm: Array, source_mm: Array, intensity: float) -> Image:
    """Return the radiance (N, 3) towards the viewer of a point source's light, without shadows.

    L = f E with f = rho_d + rho_s max(0, C_xy (v_x l_x + v_y l_y) + C_z v_z l_z)^k, v and l in the
    frame of the normal (McAllister et al. 2002), and E = I cos(theta) / r^2, r in m.
    """
    radiance = np.empty((len(hits.kind), 3), np.float32)
    _reflect(*hits, view_mm, source_mm, intensity, radiance)
    return radiance


@njit(cache=True, parallel=True, error_model="numpy")
def _reflect(points, material, kind, view, source, intensity, radiance):  # type: ignore[no-untyped-def]
    for i in prange(len(points)):
        radiance[i] = 0
        if kind[i] == 0:
            continue
        lx, ly, lz = source[0] - points[i, 0], source[1] - points[i, 1], source[2] - points[i, 2]
        vx, vy, vz = view[0] - points[i, 0], view[1] - points[i, 1], view[2] - points[i, 2]
        nx, ny, nz = material[i, 0], material[i, 1], material[i, 2]
        square = lx * lx + ly * ly + lz * lz
        far, away = np.sqrt(square), np.sqrt(vx * vx + vy * vy + vz * vz)
        cosine = (nx * lx + ny * ly + nz * lz) / far
        if cosine <= 0:
            continue
        up = cosine * (nx * vx + ny * vy + nz * vz) / away
        across = (lx * vx + ly * vy + lz * vz) / (far * away) - up
        base = max(0.0, material[i, 9] * across + material[i, 10] * up)
        lobe = base ** material[i, 11]
        irradiance = intensity * cosine / (square * 1e-6)
        for k in range(3):
            radiance[i, k] = (material[i, 3 + k] + material[i, 6 + k] * lobe) * irradiance


def see_by_lamp(eye: Eye, subject: Subject, source_mm: Array, intensity: float) -> Image:
    """Return what each pixel receives in a lamp's light, (rows, columns, 3) radiance."""
    hits = subject.trace(eye.origin_mm, eye.directions)
    radiance = reflected(hits, eye.origin_mm, source_mm, intensity)
    radiance[~subject.lit(hits.points_mm, source_mm)] = 0
    width, height = eye.camera.lens.size_px
    return np.asarray(radiance.reshape(height, width, -1, 3).mean(axis=2))


@dataclass(frozen=True)
class Projection:
    """What a grey camera needs to see any pattern on a subject; arrays over rays.

    Parameters
    ----------
    place_px
        (N, 2) float32 projector pixel that lights the ray's point.
    light
        (N,) float32 radiance under full intensity; 0 in shadow and beside the image.
    dark
        (N,) float32 radiance without any projector light.
    """

    size_px: tuple[int, int]
    place_px: Image
    light: Image
    dark: Image


def project(
    eye: Eye, subject: Subject, projector: Camera, intensity: float, ambient: float
) -> Projection:
    """Work out where the projector's pixels fall and how bright they look.

    Parameters
    ----------
    intensity
        Of the projector's white, as of a lamp at its optical centre.
    ambient
        Radiance of a perfectly white matte surface in the room's light.
    """
    hits = subject.trace(eye.origin_mm, eye.directions)
    source = projector.centre_mm
    place = projector.project(hits.points_mm)
    width, height = projector.lens.size_px
    with np.errstate(invalid="ignore"):
        inside = ((place > -0.5) & (place < (width - 0.5, height - 0.5))).all(axis=1)
    light = reflected(hits, eye.origin_mm, source, intensity) @ GREY
    light[~(inside & subject.lit(hits.points_mm, source))] = 0
    dark = (hits.material[:, 3:6] @ GREY) * np.float32(np.pi * ambient)
    dark[hits.kind == 0] = 0
    return Projection(eye.camera.lens.size_px, np.nan_to_num(place).astype(np.float32), light, dark)


def projected_image(
    pattern: Pattern, size_px: tuple[int, int], *, gamma: float, defocus_px: float, black: float
) -> Image:
    """Return the light that a projector's pixels send for a pattern, (height, width), 1 = white.

    The drive goes through the projector's gamma, the lens blurs the light; black is not dark.
    """
    width, height = size_px
    along = getattr(pattern, "axis", "x")
    # All but products of patterns vary along one axis at most: draw one line of them.
    line = (width, 1) if along == "x" else (1, height)
    drive = pattern_image(pattern, size_px if isinstance(pattern, Product) else line)
    light = (black + (1 - black) * drive**gamma).astype(np.float32)
    if defocus_px > 0:
        light = cv2.GaussianBlur(light, (0, 0), defocus_px, borderType=cv2.BORDER_REPLICATE)
    return np.ascontiguousarray(np.broadcast_to(light, (height, width)))


def see_by_projector(projection: Projection, shown: Image | None) -> Image:
    """Return what each pixel receives under a pattern, (rows, columns) radiance."""
    width, height = projection.size_px
    seen = np.empty(width * height, np.float32)
    image = np.zeros((2, 2), np.float32) if shown is None else shown
    _light(image, projection.place_px, projection.light, projection.dark, seen)
    return seen.reshape(height, width)


@njit(cache=True, parallel=True)
def _light(image, place, light, dark, seen):  # type: ignore[no-untyped-def]
    rows, columns = image.shape
    samples = len(light) // len(seen)
    for pixel in prange(len(seen)):
        total = 0.0
        for i in range(pixel * samples, (pixel + 1) * samples):
            total += dark[i]
            if light[i] > 0:
                u = min(max(place[i, 0], 0.0), columns - 1.0)
                v = min(max(place[i, 1], 0.0), rows - 1.0)
                c, r = min(int(u), columns - 2), min(int(v), rows - 2)
                a, b = u - c, v - r
                upper = (1 - a) * image[r, c] + a * image[r, c + 1]
                lower = (1 - a) * image[r + 1, c] + a * image[r + 1, c + 1]
                total += light[i] * ((1 - b) * upper + b * lower)
        seen[pixel] = total / samples


def spread(radiance: Image, sigma_px: float) -> Image:
    """Blur with the camera lens's point spread."""
    if sigma_px <= 0:
        return radiance
    return np.asarray(cv2.GaussianBlur(radiance, (0, 0), sigma_px), dtype=np.float32)


@dataclass(frozen=True)
class Sensor:
    """Shot noise, read noise, saturation and rounding.

    Parameters
    ----------
    responsivity_per_s
        Share of the full well per unit of radiance and second.
    bits
        Of the converter; values are stored shifted up to 16 bits, the largest as 65535.
    """

    responsivity_per_s: float = 40.0
    full_well_e: float = 15000.0
    read_noise_e: float = 4.0
    bits: int = 12

    def record(
        self, radiance: Image, exposure_s: float, random: np.random.Generator | None
    ) -> NDArray[np.uint16]:
        """Turn radiance into a stored image; without ``random``, an ideal one."""
        electrons = radiance * np.float32(exposure_s * self.responsivity_per_s * self.full_well_e)
        levels = 65535
        if random is not None:
            noise = random.standard_normal(electrons.shape, dtype=np.float32)
            electrons += noise * np.sqrt(electrons + np.float32(self.read_noise_e**2))
            levels = 2**self.bits - 1
        value = np.rint(np.clip(electrons / np.float32(self.full_well_e), 0, 1) * levels)
        return np.asarray(np.rint(value * np.float32(65535 / levels)), dtype=np.uint16)
