"""A rig that scans a relief known exactly: frames with shot and read noise, for benchmarks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.bundle import Bundle, open_bundle
from pipeline.formats.bundle_writer import BundleWriter
from pipeline.formats.patterns import Pattern, intensity
from pipeline.geometry.camera import Camera, Lens
from pipeline.geometry.rigid import RigidTransform, rotation_about_axis

Array = NDArray[np.float64]

DISTANCE_MM, BASELINE_MM = 600.0, 180.0
FULL_WELL_E, READ_NOISE_E, BITS = 20000.0, 4.0, 12
AMBIENT = 0.01


class Scene:
    """A painting-like relief under a camera and a projector, both with lens distortion.

    Parameters
    ----------
    size_px, projector_px
        (columns, rows) of the camera's and the projector's pictures.
    relief_mm
        Amplitude of the brushwork.
    baseline_mm
        Between the two; smaller makes depth less certain.
    """

    def __init__(
        self,
        size_px: tuple[int, int] = (640, 512),
        projector_px: tuple[int, int] = (1024, 768),
        relief_mm: float = 0.8,
        baseline_mm: float = BASELINE_MM,
        seed: int = 4,
    ) -> None:
        self.rng = np.random.default_rng(seed)
        self.size_px, self.projector_px = size_px, projector_px
        bend = np.array([-0.08, 0.05, 0.0004, -0.0003, 0.0])
        self.camera = Camera(Lens(size_px, _matrix(size_px, 2.4), bend))
        turn = rotation_about_axis(
            np.zeros(3),
            np.array([0.02, 1.0, 0.0]),
            np.degrees(np.arctan2(baseline_mm, DISTANCE_MM)),
        )
        place = turn.apply(np.array([-baseline_mm, 4.0, 12.0]))
        pose = RigidTransform(turn.rotation, place)
        self.projector = Camera(Lens(projector_px, _matrix(projector_px, 1.9), -0.5 * bend), pose)
        rays = self.camera.lens.directions(self.camera.lens.pixel_grid())
        self.points = self._on_surface(rays, relief_mm)
        self.depth_mm = self.points[..., 2]
        self.coordinates = self.projector.project(self.points)
        self.albedo = self._paint()

    def _on_surface(self, rays: Array, relief_mm: float) -> Array:
        """Meet the relief along the rays, by fixed-point steps: its slope is far below 1."""
        slope = np.array([0.06, -0.09, 1.0])
        waves = [
            (self.rng.uniform(0, 2 * np.pi), length, self.rng.uniform(0, 2 * np.pi))
            for length in (40.0, 22.0, 13.0, 8.0, 5.0)
            for _ in range(3)
        ]
        depth = DISTANCE_MM / (rays @ slope)
        for _ in range(12):
            x, y = rays[..., 0] * depth, rays[..., 1] * depth
            height = np.zeros_like(depth)
            for angle, length, phase in waves:
                along = np.cos(angle) * x + np.sin(angle) * y
                height += relief_mm * length / 90 * np.sin(2 * np.pi * along / length + phase)
            depth = (DISTANCE_MM + height) / (rays @ slope)
        return np.asarray(rays * depth[..., None])

    def _paint(self) -> Array:
        """Albedo 0.04 to 0.85: patches with edges of their own, softened by the lens."""
        import cv2

        coarse = self.rng.random((self.size_px[1] // 12 + 2, self.size_px[0] // 12 + 2))
        patches = np.kron(coarse**2, np.ones((12, 12)))[: self.size_px[1], : self.size_px[0]]
        return np.asarray(0.04 + 0.81 * cv2.GaussianBlur(patches, (0, 0), 1.0), dtype=np.float64)

    def frame(self, pattern: Pattern, exposure: float) -> NDArray[np.uint16]:
        """Take one picture; exposure 1 brings albedo 1 to the full well."""
        light = intensity(pattern, self.coordinates[..., 0], self.coordinates[..., 1])
        electrons = FULL_WELL_E * exposure * (AMBIENT + self.albedo * light)
        noisy = electrons + np.sqrt(electrons) * self.rng.standard_normal(electrons.shape)
        noisy += READ_NOISE_E * self.rng.standard_normal(electrons.shape)
        steps = 2**BITS - 1
        level = np.clip(np.rint(noisy / FULL_WELL_E * steps), 0, steps)
        return np.asarray(np.rint(level * (65535 / steps)), dtype=np.uint16)

    def record(
        self, folder: Path, patterns: tuple[Pattern, ...], exposures: tuple[float, ...] = (0.9,)
    ) -> Bundle:
        """Write a bundle with one scan."""
        writer, frames = BundleWriter(folder), []
        for i, pattern in enumerate(patterns):
            for j, exposure in enumerate(exposures):
                file = f"front/{i:03d}-{j}.png"
                writer.add_image(file, self.frame(pattern, exposure))
                shown = pattern.model_dump(mode="json")
                frames.append({"file": file, "pattern": shown, "exposure_s": exposure})
        writer.close(
            {
                "format": "impasto-capture",
                "version": 1,
                "name": "benchmark",
                "encoding": "linear",
                "cameras": {"C0": {"size_px": list(self.size_px), **_lens(self.camera.lens),
                    "full_well_e": FULL_WELL_E, "read_noise_e": READ_NOISE_E, "bits": BITS}},
                "projector": {
                    "size_px": list(self.projector_px),
                    "camera": "C0",
                    **_lens(self.projector.lens),
                    "R": self.projector.pose.rotation.tolist(),
                    "t_mm": self.projector.pose.translation_mm.tolist(),
                },
                "sequences": [
                    {"name": "front", "purpose": "scan", "camera": "C0", "frames": frames}
                ],
            }
        )  # fmt: skip
        return open_bundle(folder)


def _matrix(size_px: tuple[int, int], focal_widths: float) -> Array:
    width, height = size_px
    focal = focal_widths * width
    return np.array([[focal, 0, width / 2 + 1.3], [0, focal, height / 2 - 2.1], [0, 0, 1]])


def _lens(lens: Lens) -> dict[str, object]:
    return {"K": lens.K.tolist(), "distortion": lens.distortion.tolist()}
