"""Frames as light: reading, stacking, and merging the exposures of one pattern."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.bundle import Bundle
from pipeline.formats.capture import Frame
from pipeline.structured_light.noise import SATURATED, NoiseModel

Image = NDArray[np.float32]


class FrameReader:
    """Reads one sequence's frames as grey images; counts them for a progress bar.

    Parameters
    ----------
    bundle
        Where the images are.
    frames
        All frames of the sequence; their depth is that of the first.
    progress
        Told how many of the frames were read.
    """

    def __init__(
        self,
        bundle: Bundle,
        frames: Sequence[Frame],
        progress: Callable[[int, int], None] | None = None,
    ) -> None:
        self._bundle, self._total, self._progress = bundle, len(frames), progress
        self._read = 0
        self.full_scale = bundle.full_scale(frames[0].file)
        self.stored_bits = {255.0: 8, 65535.0: 16}.get(self.full_scale, 16)
        self._linear = bundle.capture.encoding == "linear"
        if not self._linear:
            self.full_scale = 1.0

    def stored(self, frame: Frame) -> NDArray[np.number]:
        """Read a frame proportional to light, ``full_scale`` meaning 1: (rows, columns)."""
        read = self._bundle.read_stored if self._linear else self._bundle.read
        image: NDArray[np.number] = read(frame.file)
        if image.ndim == 3:
            red, green, blue = (image[..., i].astype(np.float32) for i in range(3))
            image = (red + 2 * green + blue) / 4
        self._read += 1
        if self._progress is not None:
            self._progress(min(self._read, self._total), self._total)
        return image

    def stack(self, frames: Sequence[Frame]) -> NDArray[np.number]:
        """Read frames into one (frames, rows, columns) array, two at a time."""
        with ThreadPoolExecutor(2) as pool:
            return np.stack(list(pool.map(self.stored, frames)))

    def light(self, frames: Sequence[Frame], noise: NoiseModel) -> Image | None:
        """Merge exposures of one pattern into light per second, weighted by their noise.

        NaN where every exposure is saturated; None without frames.
        """
        if not frames:
            return None
        total: Image | float = 0.0
        weights: Image | float = 0.0
        for frame in frames:
            value = self.stored(frame) * np.float32(1 / self.full_scale)
            time = np.float32(exposure(frame))
            variance = noise.shot * np.maximum(value, 0) + noise.floor
            weight = np.where(value < SATURATED, time * time / variance, 0)
            total = total + weight * value / time
            weights = weights + weight
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(total / weights, dtype=np.float32)

    def brightest(self, frames: Sequence[Frame]) -> Image | None:
        """Return light per second from each pixel's longest exposure that is not saturated.

        A pixel saturated in all of them keeps the least it can have been: enough to tell a lit
        Gray stripe from a dark one.
        """
        best: Image | None = None
        for frame in sorted(frames, key=exposure):
            value = self.stored(frame) * np.float32(1 / self.full_scale)
            scaled = (value / np.float32(exposure(frame))).astype(np.float32)
            best = scaled if best is None else np.where(value < SATURATED, scaled, best)
        return best


def exposure(frame: Frame) -> float:
    """Return the exposure in seconds; 1 where it is not known."""
    return frame.exposure_s or 1.0
