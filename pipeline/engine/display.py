"""Showing a run: a progress bar on a terminal, one line per stage anywhere, or nothing."""

from __future__ import annotations

from types import TracebackType
from typing import TYPE_CHECKING, Self

import click

from pipeline.engine.figures import telling
from pipeline.engine.freshness import NOT_RUN
from pipeline.engine.runner import Result

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID


class Quiet:
    """Shows nothing."""

    def started(self, stage: str, why: str) -> None:
        """Show nothing."""

    def progress(self, done: float, total: float, what: str) -> None:
        """Show nothing."""

    def finished(self, result: Result) -> None:
        """Show nothing."""

    def failed(self, stage: str) -> None:
        """Show nothing."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Put the terminal right again."""


class Lines(Quiet):
    """One line when a stage ends; all lines begin with ``prefix``."""

    def __init__(self, prefix: str = "") -> None:
        self._prefix = prefix

    def finished(self, result: Result) -> None:
        """Print how it ended, and why it was redone."""
        self.print(line(result))
        if result.ran:
            for text in result.manifest.warnings:
                self.print(f"{'':11} warning: {text}")

    def failed(self, stage: str) -> None:
        """Print that it failed."""
        self.print(f"{stage:11} stopped")

    def print(self, text: str) -> None:
        """Print a line now, also into a pipe."""
        click.echo(self._prefix + text)


class Bars(Lines):
    """A progress bar for the stage that runs."""

    def __init__(self) -> None:
        super().__init__()
        self._progress: Progress | None = None
        self._task: TaskID | None = None

    def started(self, stage: str, why: str) -> None:  # noqa: ARG002 - said when it ends
        """Show the stage's bar, of unknown length."""
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        if self._progress is None:
            self._progress = Progress(
                TextColumn("{task.fields[stage]:11}"),
                BarColumn(),
                TimeElapsedColumn(),
                TextColumn("{task.description}"),
                transient=True,
            )
            self._progress.start()
        self._task = self._progress.add_task("", total=None, stage=stage)

    def progress(self, done: float, total: float, what: str) -> None:
        """Move the bar."""
        if self._progress is not None and self._task is not None:
            self._progress.update(self._task, completed=done, total=total, description=what)

    def finished(self, result: Result) -> None:
        """Replace the bar by the line."""
        self._drop_task()
        super().finished(result)

    def failed(self, stage: str) -> None:
        """Replace the bar by the line."""
        self._drop_task()
        super().failed(stage)

    def print(self, text: str) -> None:
        """Print above the bar."""
        if self._progress is None:
            super().print(text)
        else:
            self._progress.console.print(text, markup=False, highlight=False, soft_wrap=True)

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._progress is not None:
            self._progress.stop()

    def _drop_task(self) -> None:
        if self._progress is not None and self._task is not None:
            self._progress.remove_task(self._task)
            self._task = None


def line(result: Result) -> str:
    """Return the line of a stage."""
    manifest = result.manifest
    if manifest.outcome == "no work":
        text = f"no work: {manifest.reason}"
    elif result.ran:
        figures = telling(manifest.metrics)
        text = f"done in {manifest.run['elapsed_s']:.1f} s" + (f"   ({figures})" if figures else "")
    else:
        text = "up to date"
    if result.ran and result.why != NOT_RUN:
        text += f"   because {result.why}"
    return f"{result.stage:11} {text}"


def make_display(*, quiet: bool, terminal: bool) -> Quiet:
    """Choose how a run is shown."""
    if quiet:
        return Quiet()
    return Bars() if terminal else Lines()
