"""The graphics adapter: found within a bounded time, opened once per process."""

from __future__ import annotations

import os
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from pipeline.errors import HardwareError

_ADVICE = "install a Vulkan driver (mesa-vulkan-drivers gives a software one) or use --backend cpu"
_WANTED_LIMITS = ("max-texture-dimension-2d", "max-buffer-size", "max-storage-buffer-binding-size")


class GpuUnavailable(HardwareError):  # noqa: N818 - an outcome that callers fall back from
    """There is no usable graphics adapter, or it cannot hold the work; ``problem`` says why."""


@dataclass(frozen=True)
class Adapter:
    """An open device.

    Parameters
    ----------
    device
        The ``wgpu.GPUDevice``.
    name
        As the driver tells it.
    software
        True where the CPU plays the GPU (lavapipe, SwiftShader).
    """

    device: Any
    name: str
    software: bool

    def __str__(self) -> str:
        """Name the adapter for people, saying when it is not a real GPU."""
        return f"{self.name}, software" if self.software else self.name

    @property
    def largest_texture(self) -> int:
        """The largest side of a 2-D texture, texels."""
        return int(self.device.limits["max-texture-dimension-2d"])


def open_adapter(timeout_s: float = 30.0) -> Adapter:
    """Open the best adapter; later calls return the same one, or fail the same way.

    Raises
    ------
    GpuUnavailable
        wgpu is missing, there is no adapter, or the driver does not answer within ``timeout_s``.
    """
    outcome = _asked_once(timeout_s)
    if isinstance(outcome, GpuUnavailable):
        raise outcome
    return outcome


@lru_cache(maxsize=1)
def _asked_once(timeout_s: float) -> Adapter | GpuUnavailable:
    """Keep a failure too, so that a driver that hangs is waited for once, not per picture."""
    try:
        return within(timeout_s, _open)
    except GpuUnavailable as error:
        return error


def within(timeout_s: float, work: Callable[[], Adapter]) -> Adapter:
    """Run ``work`` in a thread that is given up after ``timeout_s``: a driver may hang."""
    outcome: list[Adapter | Exception] = []

    def attempt() -> None:
        try:
            outcome.append(work())
        except Exception as error:
            outcome.append(error)

    thread = threading.Thread(target=attempt, name="open-adapter", daemon=True)
    thread.start()
    thread.join(timeout_s)
    if not outcome:
        raise GpuUnavailable(f"the graphics driver did not answer in {timeout_s:g} s", fix=_ADVICE)
    if isinstance(outcome[0], GpuUnavailable):
        raise outcome[0]
    if isinstance(outcome[0], Exception):
        reason = " ".join(str(outcome[0]).split())
        raise GpuUnavailable(f"no graphics adapter: {reason}", fix=_ADVICE) from outcome[0]
    return outcome[0]


@contextmanager
def _quiet_session() -> Iterator[None]:
    """Keep the driver's search for a window from complaining where there is no session."""
    name = "XDG_RUNTIME_DIR"
    if name in os.environ:
        yield
        return
    os.environ[name] = tempfile.gettempdir()
    try:
        yield
    finally:
        del os.environ[name]


def _open() -> Adapter:
    import wgpu

    # power_preference never selects a software adapter where a real one exists.
    with _quiet_session():
        adapter = wgpu.gpu.request_adapter_sync(power_preference="high-performance")
    if adapter is None:
        raise GpuUnavailable("no graphics adapter was found", fix=_ADVICE)
    limits = {name: adapter.limits[name] for name in _WANTED_LIMITS if name in adapter.limits}
    device = adapter.request_device_sync(label="impasto", required_limits=limits)
    info = adapter.info
    return Adapter(device, str(info["device"]), str(info["adapter_type"]).upper() == "CPU")
