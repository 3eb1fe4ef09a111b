"""Taking a capture: pattern sequences and photographs, written into a bundle as they come."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from hardware.devices import Camera, Rig
from pipeline.errors import HardwareError
from pipeline.formats.bundle_writer import BundleWriter
from pipeline.formats.patterns import Axis, Black, Gray, Pattern, Phase, White

Progress = Callable[[str, int, int], None]

_SATURATED, _MOST_SATURATED = 0.98, 0.002
_LEVEL, _PROBES = 0.8, 8
_IN_FLIGHT = 8
"""Images that may wait to be written, so that a slow disk slows the rig and not the memory."""


@dataclass(frozen=True)
class Coding:
    """How one axis of the projector is coded: Gray code, then phase steps of each period."""

    axis: Axis
    bits: int = 0
    cell_px: int = 1
    periods_px: tuple[float, ...] = ()
    steps: int = 4
    inverted: bool = False

    def patterns(self) -> list[Pattern]:
        """List the patterns in the order in which they are shown."""
        gray: list[Pattern] = [
            Gray(axis=self.axis, bit=bit, bits=self.bits, cell_px=self.cell_px, inverted=inverted)
            for bit in range(self.bits)
            for inverted in ((False, True) if self.inverted else (False,))
        ]
        phase = [
            Phase(axis=self.axis, period_px=period, step=step, steps=self.steps)
            for period in self.periods_px
            for step in range(self.steps)
        ]
        return gray + phase


def coded(*codings: Coding, uniform: bool = True) -> tuple[Pattern, ...]:
    """List white and black (unless ``uniform`` is false) and each axis's patterns."""
    first: list[Pattern] = [White(), Black()] if uniform else []
    return tuple(first + [pattern for coding in codings for pattern in coding.patterns()])


@dataclass(frozen=True)
class SequencePlan:
    """One sequence of patterns.

    Parameters
    ----------
    subject
        What the operator puts in place.
    exposures
        Relative to the metered one, which leaves white paint just below saturation.
    stored_bits
        8 or 16.
    keys
        Further keys of the document's entry (``board``, ``on_turntable``).
    """

    name: str
    purpose: Literal["calibrate", "scan", "pose", "light"]
    camera: str
    patterns: tuple[Pattern, ...]
    subject: str
    exposures: tuple[float, ...] = (1.0,)
    stored_bits: Literal[8, 16] = 16
    turntable_deg: float = 0.0
    keys: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class PhotoPlan:
    """One photograph under the lamp at a stop."""

    camera: str
    stop: str
    turntable_deg: float
    subject: str


def acquire(
    rig: Rig,
    writer: BundleWriter,
    sequences: Sequence[SequencePlan],
    photos: Sequence[PhotoPlan],
    progress: Progress,
) -> dict[str, Any]:
    """Take everything planned; the lamp is off and the projector dark on any exit.

    Returns
    -------
    The document's ``sequences`` and ``photos``. Closing the writer with the whole document is the
    caller's part.

    Raises
    ------
    HardwareError
        A device failed.
    """
    entries: dict[str, Any] = {"sequences": [], "photos": []}
    with _Writing(writer) as writing:
        try:
            for done, plan in enumerate(sequences):
                progress(f"sequences to {plan.purpose}", done, len(sequences))
                entries["sequences"].append(_take_sequence(rig, writing, plan))
            for done, photo in enumerate(photos):
                progress("photographs", done, len(photos))
                entries["photos"].append(_take_photo(rig, writing, photo, done))
        finally:
            rig.lamp.switch(False)
            rig.projector.show(None)
    return entries


def meter(camera: Camera, probe_s: float) -> float:
    """Find the exposure at which the brightest parts but a few lie at 0.8 of full scale.

    Raises
    ------
    HardwareError
        The picture is black, or no exposure is short enough.
    """
    exposure_s = probe_s
    for _ in range(_PROBES):
        frame = camera.capture(exposure_s)
        value = frame.image / 65535.0
        if np.mean(value > _SATURATED) > _MOST_SATURATED:
            exposure_s = frame.exposure_s / 4
            continue
        peak = float(np.quantile(value, 1 - _MOST_SATURATED))
        if peak < 1e-3:
            exposure_s = frame.exposure_s * 64
        elif peak < 0.1:
            exposure_s = frame.exposure_s * 0.5 / peak
        else:
            return round(frame.exposure_s * _LEVEL / peak, 6)
    raise HardwareError(
        f"no exposure was found ({exposure_s:.3g} s is not right either)",
        expected="a picture that is neither black nor saturated",
        fix="check lens cap, projector and lamp",
    )


def _take_sequence(rig: Rig, writing: _Writing, plan: SequencePlan) -> dict[str, Any]:
    rig.operator.place(plan.subject)
    rig.turntable.move_to(plan.turntable_deg)
    rig.lamp.switch(False)
    camera = rig.cameras[plan.camera]
    rig.projector.show(White())
    metered_s = meter(camera, 0.01)
    entries: list[dict[str, Any]] = []
    # Pattern by pattern: the projector is slower than the camera.
    for pattern in plan.patterns:
        rig.projector.show(pattern)
        for i, relative in enumerate(plan.exposures):
            frame = camera.capture(round(metered_s * relative, 6))
            file = f"{plan.name}/{i}-{len(entries) // len(plan.exposures):03d}.png"
            writing.add(file, _stored(frame.image, plan.stored_bits))
            shown = pattern.model_dump(exclude_defaults=True) | {"type": pattern.type}
            entries.append({"file": file, "pattern": shown, "exposure_s": frame.exposure_s})
    return {
        "name": plan.name,
        "purpose": plan.purpose,
        "camera": plan.camera,
        "turntable_deg": plan.turntable_deg,
        **plan.keys,
        "frames": entries,
    }


def _take_photo(rig: Rig, writing: _Writing, plan: PhotoPlan, number: int) -> dict[str, Any]:
    rig.operator.place(plan.subject)
    rig.turntable.move_to(plan.turntable_deg)
    rig.projector.show(None)
    rig.arc.move_to(plan.stop)
    rig.lamp.switch(True)
    camera = rig.cameras[plan.camera]
    frame = camera.capture(meter(camera, 0.02))
    file = f"photos/{number:04d}.png"
    writing.add(file, frame.image)
    return {
        "file": file,
        "camera": plan.camera,
        "turntable_deg": plan.turntable_deg,
        "light": plan.stop,
        "exposure_s": frame.exposure_s,
    }


def _stored(image: NDArray[np.uint16], bits: int) -> NDArray[np.uint8] | NDArray[np.uint16]:
    if bits == 16:
        return image
    return ((image.astype(np.uint32) + 128) // 257).astype(np.uint8)


class _Writing:
    """Writes images in the background; the first error ends the capture."""

    def __init__(self, writer: BundleWriter) -> None:
        self._writer = writer
        self._pool = ThreadPoolExecutor(2, thread_name_prefix="write")
        self._pending: list[Future[None]] = []

    def add(self, file: str, image: NDArray[np.uint8] | NDArray[np.uint16]) -> None:
        """Queue an image, waiting if too many wait already."""
        while len(self._pending) >= _IN_FLIGHT:
            self._pending.pop(0).result()
        self._pending.append(self._pool.submit(self._writer.add_image, file, image))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._pool.shutdown(wait=True, cancel_futures=error is not None)
        if error is None:
            for future in self._pending:
                future.result()
