"""A camera that watches a known projector coordinate, in memory."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pipeline.formats.capture import CameraEntry, Frame, Sequence
from pipeline.formats.patterns import Pattern, intensity

Array = NDArray[np.float64]
PROJECTOR_PX = (256, 192)


def smooth_field(rows: int, columns: int) -> tuple[Array, Array]:
    """Projector columns and rows that a camera of this size sees: a slanted, curved surface."""
    v, u = np.mgrid[0:rows, 0:columns].astype(np.float64)
    a, b = u / columns, v / rows
    x = 12 + 228 * a + 6 * np.sin(2.1 * b) + 5 * a * b
    y = 9 + 165 * b + 7 * np.sin(1.7 * a + 0.3)
    return x, y


@dataclass
class Scene:
    """What one pixel sees: ``ambient + projected * I`` per second, through a sensor."""

    rows: int = 60
    columns: int = 80
    projected: Array | float = 0.7
    ambient: Array | float = 0.05
    bits: int = 12
    full_well_e: float = 20000.0
    read_noise_e: float = 4.0
    noise: bool = True
    response: Callable[[Array], Array] = np.asarray
    seed: int = 5
    rgb: bool = False
    declared: dict[str, Any] = field(default_factory=dict)
    x: Array | None = None
    y: Array | None = None

    def __post_init__(self) -> None:
        x, y = smooth_field(self.rows, self.columns)
        self.x = x if self.x is None else self.x
        self.y = y if self.y is None else self.y

    def bundle(
        self,
        patterns: list[Pattern],
        exposures: tuple[float | None, ...] = (1.0,),
        gains: Array | None = None,
        encoding: str = "linear",
    ) -> tuple[Any, Sequence]:
        """Show all patterns at each exposure; return a stand-in bundle and its sequence."""
        rng = np.random.default_rng(self.seed)
        images: dict[str, NDArray[np.number]] = {}
        frames = []
        for seconds in exposures:
            for pattern in patterns:
                gain = 1.0 if gains is None else float(gains[len(frames)])
                light = self.response(intensity(pattern, self.x, self.y))
                value = gain * (seconds or 1.0) * (self.ambient + self.projected * light)
                name = f"{len(frames):03d}.png"
                images[name] = self._sensor(np.broadcast_to(value, self.x.shape), rng)
                frames.append(Frame(file=name, pattern=pattern, exposure_s=seconds))
        scale = 255.0 if self.bits == 8 else 65535.0
        entry = {"full_well_e": self.full_well_e, "read_noise_e": self.read_noise_e}
        entry |= {"bits": self.bits}
        if self.declared:
            entry = {k: v for k, v in self.declared.items() if v is not None}
        capture = SimpleNamespace(
            encoding=encoding,
            projector=SimpleNamespace(size_px=PROJECTOR_PX),
            cameras={"C0": CameraEntry(size_px=(self.columns, self.rows), **entry)},
        )
        bundle = SimpleNamespace(
            capture=capture,
            read_stored=lambda file: images[file],
            read=lambda file: (images[file] / scale).astype(np.float32),
            full_scale=lambda file: scale,
            images=images,
        )
        sequence = Sequence(name="front", purpose="scan", camera="C0", frames=tuple(frames))
        return bundle, sequence

    def _sensor(self, value: Array, rng: np.random.Generator) -> NDArray[np.number]:
        if self.noise:
            electrons = rng.poisson(np.clip(value, 0, 4) * self.full_well_e)
            electrons = electrons + self.read_noise_e * rng.standard_normal(value.shape)
            value = electrons / self.full_well_e
        levels = 2**self.bits - 1
        stored = np.clip(np.round(value * levels), 0, levels)
        if self.bits == 12:
            stored = np.where(stored == levels, 65535, 16 * stored)
        image = stored.astype(np.uint8 if self.bits == 8 else np.uint16)
        return np.stack([image] * 3, axis=-1) if self.rgb else image


@pytest.fixture
def scene() -> type[Scene]:
    """Give the class of synthetic scenes."""
    return Scene
