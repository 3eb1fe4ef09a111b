"""A stage: a pure function with declared inputs and outputs.

A stage module defines ``Inputs``, ``Outputs`` (frozen dataclasses), ``Config`` (a pydantic
model with bounds and one-line docs) and ``run(inputs, config, log) -> Outputs``, and declares
them in one :class:`Stage`. ``run`` never touches a file: the engine loads what the inputs name and
saves what comes back.

    @dataclass(frozen=True)
    class Inputs:
        bundle: Bundle = reads_bundle("scan")
        calibration: Calibration = reads(CALIBRATION)

    @dataclass(frozen=True)
    class Outputs:
        range_image: RangeImage = writes(RANGE)

    SCAN = Stage("scan", version=1, inputs=Inputs, outputs=Outputs, config=Config, run=run)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar

from pydantic import BaseModel

from pipeline.formats.artifact import Artifact

T = TypeVar("T")


class NoWork(Exception):  # noqa: N818 - an outcome, not an error
    """A stage found that there is nothing for it to do; the text says why, for people."""


class Log(Protocol):
    """What a running stage may say; the engine shows it and keeps it in the manifest."""

    def progress(self, done: float, total: float, what: str = "") -> None:
        """Report ``done`` of ``total`` units."""

    def metric(self, name: str, value: float | int | str) -> None:
        """Record a figure in the manifest."""

    def warning(self, text: str) -> None:
        """Tell the user of something doubtful; the run goes on."""

    def skipped(self, what: str, why: str) -> None:
        """Record work that the scene did not need."""


def reads(artifact: Artifact[T], *, optional: bool = False) -> Any:
    """Declare an input; an optional one is None when its stage had no work."""
    return field(metadata={"artifact": artifact, "optional": optional})


def reads_bundle(*purposes: str) -> Any:
    """Declare that the stage reads the bundle: the sequences of these purposes.

    ``photos`` stands for the photographs with their darks, flats and colour target.
    """
    return field(metadata={"purposes": purposes})


def writes(artifact: Artifact[T]) -> Any:
    """Declare an output."""
    return field(metadata={"artifact": artifact})


@dataclass(frozen=True)
class Stage:
    """A named, versioned stage; raise ``version`` when the same inputs give other outputs.

    ``folder`` is the stage's folder in the workspace, its name if left out.
    """

    name: str
    version: int
    inputs: type[Any]
    outputs: type[Any]
    config: type[BaseModel]
    run: Callable[[Any, Any, Log], Any]
    folder: str = ""
