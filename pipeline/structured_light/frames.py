"""Frames as light: reading ahead, stacking, and merging the exposures of one pattern."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from pipeline.formats.bundle import Bundle
from pipeline.formats.capture import Frame
from pipeline.formats.images import to_grey
from pipeline.structured_light.noise import SATURATED, NoiseModel

Image = NDArray[np.float32]
Stored = NDArray[np.number]

_AHEAD = 12
"""Frames that may wait to be used: enough to read on while one period is solved."""

_THREADS = 2


class FrameReader:
    """Reads a sequence's frames as grey images, a few ahead of where they are wanted.

    Use as a context manager: leaving it ends the reading.

    Parameters
    ----------
    bundle
        Where the images are.
    frames
        In the order in which they will be asked for.
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
        self._linear = bundle.capture.encoding == "linear"
        stored_scale = bundle.full_scale(frames[0].file)
        self.stored_bits = {255.0: 8, 65535.0: 16}.get(stored_scale, 16)
        self.full_scale = stored_scale if self._linear else 1.0
        self._pool = ThreadPoolExecutor(_THREADS, thread_name_prefix="frames")
        self._waiting = deque(frames)
        self._coming: deque[tuple[Frame, Future[Stored]]] = deque()

    def __enter__(self) -> FrameReader:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._pool.shutdown(wait=True, cancel_futures=True)

    def stored(self, frame: Frame) -> Stored:
        """Read a frame proportional to light, ``full_scale`` meaning 1: (rows, columns)."""
        while self._waiting and len(self._coming) < _AHEAD:
            coming = self._waiting.popleft()
            self._coming.append((coming, self._pool.submit(self._load, coming)))
        if self._coming and self._coming[0][0] is frame:
            image = self._coming.popleft()[1].result()
        else:
            image = self._load(frame)
        self._read += 1
        if self._progress is not None:
            self._progress(min(self._read, self._total), self._total)
        return image

    def _load(self, frame: Frame) -> Stored:
        read = self._bundle.read_stored if self._linear else self._bundle.read
        image: Stored = read(frame.file)
        return image if image.ndim == 2 else to_grey(image.astype(np.float32))

    def stack(self, frames: Sequence[Frame]) -> Stored:
        """Read frames into one (frames, rows, columns) array of their stored type."""
        first = self.stored(frames[0])
        stack = np.empty((len(frames), *first.shape), first.dtype)
        stack[0] = first
        for i, frame in enumerate(frames[1:], start=1):
            stack[i] = self.stored(frame)
        return stack

    def light(
        self, frames: Sequence[Frame], noise: NoiseModel, *, at_least: bool = False
    ) -> Image | None:
        """Merge exposures of one pattern into light per second, weighted by their noise.

        A pixel saturated in every exposure is NaN or, with ``at_least``, the least it can have
        been, which is enough to tell a lit Gray stripe from a dark one. None without frames.
        """
        if not frames:
            return None
        times = np.array([exposure(frame) for frame in frames])
        bound = SATURATED / times.min() if at_least else np.nan
        stack = self.stack(frames)
        merged: Image = np.full(stack.shape[1:], bound, np.float32)
        _merge(stack, times, 1 / self.full_scale, SATURATED, noise.shot, noise.floor, merged)
        return merged


def exposure(frame: Frame) -> float:
    """Return the exposure in seconds; 1 where it is not known."""
    return frame.exposure_s or 1.0


@njit(cache=True, parallel=True)
def _merge(stack, times, unit, saturated, shot, floor, merged):  # type: ignore[no-untyped-def]
    """Weighted mean of value / time; the weights follow the mean, not the noisy value itself."""
    frames, rows, columns = stack.shape
    for row in prange(rows):
        for column in range(columns):
            value = time = 0.0
            for f in range(frames):
                v = stack[f, row, column] * unit
                if v < saturated:
                    value += v
                    time += times[f]
            if time == 0.0:
                continue
            level = max(value / time, 0.0)
            total = weights = 0.0
            for f in range(frames):
                v = stack[f, row, column] * unit
                if v < saturated:
                    weight = times[f] / (shot * level * times[f] + floor)
                    total += weight * v
                    weights += weight * times[f]
            merged[row, column] = total / weights
