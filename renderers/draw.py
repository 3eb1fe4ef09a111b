"""Draw an asset: choose between the GPU painter and the CPU reference, and say which it was."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import UsageError
from pipeline.formats.asset import Asset
from renderers.adapter import Adapter, GpuUnavailable, open_adapter
from renderers.painting import METHODS, Painting, PaintOptions
from renderers.view import Light, View

Backend = Literal["auto", "gpu", "cpu"]
BACKENDS: tuple[Backend, ...] = get_args(Backend)
REFERENCE = "reference"
ALL_METHODS = (*METHODS, REFERENCE)


@dataclass(frozen=True)
class RenderResult:
    """A picture, and how it came to be.

    Parameters
    ----------
    image
        (h, w, 4) float32 linear RGB radiance, premultiplied by the coverage in the last channel.
    backend
        ``gpu`` or ``cpu``: what drew it.
    method
        What was drawn: ``reference`` on the CPU, whatever was asked for.
    adapter
        The GPU's name, ``CPU`` otherwise.
    elapsed_s
        From the asset in memory to the picture in memory.
    notes
        What differs from what was asked for, and why.
    """

    image: NDArray[np.float32]
    backend: str
    method: str
    adapter: str
    elapsed_s: float
    notes: tuple[str, ...] = ()


def render(
    asset: Asset,
    view: View,
    lights: Sequence[Light],
    *,
    method: str = "hybrid",
    backend: str = "auto",
    options: PaintOptions | None = None,
    open_gpu: Callable[[], Adapter] = open_adapter,
) -> RenderResult:
    """Draw one picture.

    Parameters
    ----------
    method
        One of ``ALL_METHODS``; ``reference`` is the exact ray caster on the CPU.
    backend
        ``gpu`` fails where there is no adapter; ``auto`` then draws the reference on the CPU and
        says so in the notes.
    open_gpu
        Gives the adapter or raises ``GpuUnavailable``.

    Raises
    ------
    UsageError
        An unknown method or backend, or ``reference`` on the GPU.
    GpuUnavailable
        ``backend`` is ``gpu`` and the GPU cannot do it.
    """
    _require_one_of("method", method, ALL_METHODS)
    _require_one_of("backend", backend, BACKENDS)
    if method == REFERENCE and backend == "gpu":
        raise UsageError("the reference is drawn on the CPU", fix="leave --backend out")
    options = options or PaintOptions()
    notes: list[str] = []
    if backend != "cpu" and method != REFERENCE:
        try:
            return _on_gpu(asset, view, lights, method, options, open_gpu)
        except GpuUnavailable as error:
            if backend == "gpu":
                raise
            notes.append(f"drawn on the CPU: {error.problem}")
    if method != REFERENCE:
        notes.append(f"the CPU draws the exact reference in place of {method!r}")
    return _on_cpu(asset, view, lights, options, tuple(notes))


def _on_gpu(
    asset: Asset,
    view: View,
    lights: Sequence[Light],
    method: str,
    options: PaintOptions,
    open_gpu: Callable[[], Adapter],
) -> RenderResult:
    adapter = open_gpu()
    start = time.perf_counter()
    known = next(name for name in METHODS if name == method)
    image = Painting(asset, adapter).draw(view, lights, known, options)
    return RenderResult(image, "gpu", method, str(adapter), time.perf_counter() - start)


def _on_cpu(
    asset: Asset,
    view: View,
    lights: Sequence[Light],
    options: PaintOptions,
    notes: tuple[str, ...],
) -> RenderResult:
    from renderers.reference import render_reference

    start = time.perf_counter()
    image = render_reference(
        asset, view, list(lights), samples=options.samples, shadows=options.shadows
    )
    return RenderResult(image, "cpu", REFERENCE, "CPU", time.perf_counter() - start, notes)


def _require_one_of(what: str, given: str, allowed: Sequence[str]) -> None:
    if given not in allowed:
        raise UsageError(
            f"the {what} {given!r} is unknown", expected="one of " + ", ".join(allowed)
        )
