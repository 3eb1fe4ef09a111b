"""A stage: a pure function with declared inputs and outputs.

A stage module defines ``Inputs``, ``Outputs`` (frozen dataclasses), ``Config`` (a pydantic
model with bounds and one-line docs) and ``run(inputs, config, log) -> Outputs``, and declares
them in one :class:`Stage` named ``STAGE``. ``run`` never touches a file: the engine loads what the
inputs name and saves what comes back.

    @dataclass(frozen=True)
    class Inputs:
        bundle: Bundle = reads_bundle("scan")
        calibration: Calibration = reads(CALIBRATION)

    @dataclass(frozen=True)
    class Outputs:
        range_image: RangeImage = writes(RANGE)

    STAGE = Stage("scan", version=1, inputs=Inputs, outputs=Outputs, config=Config, run=run)

Rules that the engine relies on:

- **Import the heavy parts inside** ``run``. To find out that there is nothing to do, the engine
  imports every stage module; that has to stay well under a second for all of them together. At the
  top of a ``stage.py`` only numpy, pydantic, the types of ``formats`` and this module are
  welcome; numba, scipy, cv2 and the stage's own kernels are imported by ``run``. The same holds for
  the modules in ``formats``: their save and load functions import OpenEXR and cv2 when called.
- Read from the bundle only images of the purposes that were declared: others are not hashed, so a
  change in them would go unseen, and the engine refuses to read them. ``capture.json`` is
  always hashed whole.
- Same inputs and configuration, same bytes out, whatever the number of threads. Metrics, warnings
  and skipped work belong to the result: no times or memory in them, the engine records those.
- Every output is written; a stage that has nothing to give raises :class:`NoWork`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields
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
        """Record a figure in the manifest; ``share_...`` is a fraction, ``..._mm`` has its unit.

        The first three are shown when the stage ends, so record the most telling ones first.
        """

    def warning(self, text: str) -> None:
        """Tell the user of something doubtful; the run goes on."""

    def skipped(self, what: str, why: str) -> None:
        """Record work that the scene did not need."""


def reads(artifact: Artifact[T], *, optional: bool = False) -> Any:
    """Declare an input; an optional one is None when its stage had no work."""
    return field(metadata={"artifact": artifact, "optional": optional})


def reads_bundle(*purposes: str) -> Any:
    """Declare that the stage reads the bundle: the sequences of these purposes.

    ``photos`` stands for the photographs with their darks, flats and colour target. Without any
    purpose the stage sees the document alone.
    """
    return field(metadata={"purposes": purposes})


def writes(artifact: Artifact[T]) -> Any:
    """Declare an output."""
    return field(metadata={"artifact": artifact})


@dataclass(frozen=True)
class Stage:
    """A named, versioned stage; raise ``version`` when the same inputs give other outputs.

    ``folder`` is the stage's folder in the workspace, its name if left out.

    Raises
    ------
    TypeError
        A field is not declared, or an output's file lies outside the stage's folder.
    """

    name: str
    version: int
    inputs: type[Any]
    outputs: type[Any]
    config: type[BaseModel]
    run: Callable[[Any, Any, Log], Any]
    folder: str = ""

    def __post_init__(self) -> None:
        if not self.folder:
            object.__setattr__(self, "folder", self.name)
        for declared in fields(self.inputs):
            if not declared.metadata.keys() & {"artifact", "purposes"}:
                raise TypeError(f"{self.name}: input {declared.name} needs reads or reads_bundle")
        for declared in fields(self.outputs):
            if "artifact" not in declared.metadata:
                raise TypeError(f"{self.name}: output {declared.name} needs writes(...)")
        for file in self.output_files:
            if not file.startswith(self.folder + "/") or file == f"{self.folder}/manifest.json":
                raise TypeError(f"{self.name}: {file} is not a file of its own in {self.folder}/")

    @property
    def input_artifacts(self) -> dict[str, tuple[Artifact[Any], bool]]:
        """The artifacts read, by field, each with whether it is optional."""
        return {
            declared.name: (declared.metadata["artifact"], declared.metadata["optional"])
            for declared in fields(self.inputs)
            if "artifact" in declared.metadata
        }

    @property
    def bundle_purposes(self) -> dict[str, tuple[str, ...]]:
        """The purposes read from the bundle, by field; empty if the bundle is not read."""
        return {
            declared.name: tuple(declared.metadata["purposes"])
            for declared in fields(self.inputs)
            if "purposes" in declared.metadata
        }

    @property
    def output_artifacts(self) -> dict[str, Artifact[Any]]:
        """The artifacts written, by field."""
        return {declared.name: declared.metadata["artifact"] for declared in fields(self.outputs)}

    @property
    def output_files(self) -> tuple[str, ...]:
        """All files written, relative to the workspace, sorted."""
        files = (file for artifact in self.output_artifacts.values() for file in artifact.files)
        return tuple(sorted(files))
