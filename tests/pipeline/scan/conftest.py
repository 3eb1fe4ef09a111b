"""A rig that scans a surface known exactly, in memory."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pipeline.formats.capture import CameraEntry, Frame, Sequence
from pipeline.formats.patterns import Black, Gray, Phase, White, intensity
from pipeline.geometry.camera import Camera, Lens
from pipeline.geometry.rigid import RigidTransform, rotation_about_axis

SIZE, PROJECTOR_SIZE = (120, 90), (256, 192)


class Rig:
    """Camera at the origin, projector beside it; a surface ``depth`` z (rows, columns)."""

    def __init__(self, albedo: Any = 0.6, seed: int = 3) -> None:
        bent = np.array([-0.1, 0.08, 0.0005, -0.0004, 0.0])
        K = np.array([[300.0, 0, 60.3], [0, 301.0, 44.2], [0, 0, 1]])
        self.camera = Camera(Lens(SIZE, K, bent))
        K = np.array([[640.0, 0, 127.0], [0, 642.0, 95.0], [0, 0, 1]])
        turn = rotation_about_axis(np.zeros(3), np.array([0.02, 1.0, 0.0]), 16.0).rotation
        pose = RigidTransform(turn, np.array([-255.0, 20.0, 45.0]))
        self.projector = Camera(Lens(PROJECTOR_SIZE, K, -0.5 * bent), pose)
        self.rays = self.camera.lens.directions(self.camera.lens.pixel_grid())
        self.depth = 900.0 / (self.rays @ np.array([0.1, -0.15, 1.0]))
        self.depth = self.depth + 2.0 * np.sin(self.rays[..., 0] * 60)
        self.albedo, self.seed = albedo, seed

    @property
    def points(self) -> np.ndarray:
        """The surface, (rows, columns, 3) mm."""
        return self.rays * self.depth[..., None]

    @property
    def pixels(self) -> np.ndarray:
        """The projector coordinates that light it."""
        return self.projector.project(self.points)

    def patterns(self, axes: str = "xy", steps: int = 4) -> list[Any]:
        """Levels, Gray code and phase along the axes."""
        shown: list[Any] = [White(), Black()]
        for axis in axes:
            shown += [Gray(axis=axis, bit=b, bits=5, cell_px=8) for b in range(5)]
            shown += [Phase(axis=axis, period_px=16, step=i, steps=steps) for i in range(steps)]
        return shown

    def bundle(self, patterns: list[Any]) -> Any:
        """Take the frames of one scan."""
        rng = np.random.default_rng(self.seed)
        images, frames = {}, []
        for i, pattern in enumerate(patterns):
            light = intensity(pattern, self.pixels[..., 0], self.pixels[..., 1])
            value = np.nan_to_num(0.02 + self.albedo * light)
            electrons = rng.poisson(value * 20000) + 4 * rng.standard_normal(value.shape)
            images[f"{i}.png"] = np.clip(np.round(electrons / 20000 * 65535), 0, 65535).astype(
                np.uint16
            )
            frames.append(Frame(file=f"{i}.png", pattern=pattern, exposure_s=1.0))
        camera = CameraEntry(size_px=SIZE, full_well_e=20000, read_noise_e=4, bits=16)
        scan = Sequence(name="front", purpose="scan", camera="C0", frames=tuple(frames))
        return SimpleNamespace(
            capture=SimpleNamespace(
                encoding="linear",
                projector=SimpleNamespace(size_px=PROJECTOR_SIZE),
                cameras={"C0": camera},
            ),
            read_stored=lambda file: images[file],
            full_scale=lambda file: 65535.0,
            sequences=lambda purpose: (scan,) if purpose == "scan" else (),
            images=images,
        )


@pytest.fixture
def rig() -> type[Rig]:
    """Give the class of rigs."""
    return Rig
