"""Running a recipe in a workspace, and saying how far it is."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal, Protocol

from pydantic import BaseModel

from pipeline.engine.execute import execute
from pipeline.engine.freshness import NOT_RUN, request, why_stale
from pipeline.engine.hashes import HashCache
from pipeline.engine.manifest import Manifest
from pipeline.engine.recipe import Recipe, between
from pipeline.engine.settings import Settings, configure
from pipeline.engine.source import BundleSource
from pipeline.engine.stage import Stage
from pipeline.engine.workspace import Workspace
from pipeline.errors import ImpastoError

State = Literal["up to date", "stale", "not run"]


@dataclass(frozen=True)
class Selection:
    """Which stages to bring up to date, and how."""

    first: str | None = None
    last: str | None = None
    force: bool = False
    settings: Settings = field(default_factory=dict)


@dataclass(frozen=True)
class Result:
    """A stage that is now up to date: it was already (``ran`` False), or was done because."""

    stage: str
    ran: bool
    why: str
    manifest: Manifest


@dataclass(frozen=True)
class StageStatus:
    """How a stage stands; ``why`` says what a stale one would be redone for."""

    stage: str
    state: State
    why: str
    manifest: Manifest | None


class Display(Protocol):
    """Shows a run to people."""

    def started(self, stage: str, why: str) -> None:
        """Show that a stage starts, and why it is done."""

    def progress(self, done: float, total: float, what: str) -> None:
        """Show how far the stage is."""

    def finished(self, result: Result) -> None:
        """Show that a stage is up to date."""

    def failed(self, stage: str) -> None:
        """Show that the stage stopped with an error, which is reported elsewhere."""


Plan = list[tuple[Stage, BaseModel]]


def plan(recipe: Recipe, selection: Selection) -> Plan:
    """Import the selected stages and check everything that was set.

    Raises
    ------
    UsageError
        The selection names stages or keys that do not exist, or values out of bounds.
    """
    chosen = between(recipe, selection.first, selection.last)
    for reference in recipe:
        if reference.name in selection.settings and reference not in chosen:
            configure(reference.load(), selection.settings)
    stages = [reference.load() for reference in chosen]
    return [(stage, configure(stage, selection.settings)) for stage in stages]


def run_plan(planned: Plan, workspace: Workspace, display: Display, *, force: bool) -> list[Result]:
    """Bring the planned stages up to date, in order; with ``force``, redo them all.

    Raises
    ------
    ImpastoError
        A stage could not be done; those before it are complete.
    """
    results = []
    with workspace.locked():
        cache = HashCache(workspace.hashes)
        source = BundleSource(workspace.bundle, cache)
        try:
            for stage, configuration in planned:
                wanted = request(stage, configuration, workspace, source, cache)
                why = why_stale(stage, wanted, workspace, cache)
                if why is None and force:
                    why = "forced"
                if why is None:
                    result = Result(stage.name, False, "", _manifest(workspace, stage))
                else:
                    display.started(stage.name, why)
                    try:
                        manifest = execute(
                            stage,
                            configuration,
                            wanted,
                            workspace,
                            source,
                            cache,
                            display.progress,
                        )
                    except BaseException:
                        display.failed(stage.name)
                        raise
                    result = Result(stage.name, True, why, manifest)
                display.finished(result)
                results.append(result)
        finally:
            cache.save()
    return results


def _manifest(workspace: Workspace, stage: Stage) -> Manifest:
    manifest = workspace.manifest(stage.folder)
    if manifest is None:
        raise ImpastoError(f"the manifest of {stage.name} vanished", where=str(workspace.folder))
    return manifest


def statuses(recipe: Recipe, workspace: Workspace, settings: Settings) -> Iterator[StageStatus]:
    """Say how every stage stands for a run with these settings, without changing anything."""
    cache = HashCache(workspace.hashes)
    source = BundleSource(workspace.bundle, cache)
    unsettled: dict[str, str] = {}
    for reference in recipe:
        stage = reference.load()
        manifest = workspace.manifest(stage.folder)
        configuration = configure(stage, settings)
        makers = [
            unsettled[folder]
            for artifact, _ in stage.input_artifacts.values()
            if (folder := artifact.files[0].split("/", 1)[0]) in unsettled
        ]
        why: str | None
        if not (workspace.folder / stage.folder).exists():
            why = NOT_RUN
        elif makers:
            why = f"{makers[0]} comes first"
        else:
            try:
                wanted = request(stage, configuration, workspace, source, cache)
                why = why_stale(stage, wanted, workspace, cache)
            except (ImpastoError, OSError) as error:
                why = str(error)
        if why is None:
            yield StageStatus(stage.name, "up to date", "", manifest)
            continue
        unsettled[stage.folder] = stage.name
        state: State = "not run" if why == NOT_RUN else "stale"
        yield StageStatus(stage.name, state, why, manifest)
