"""``impasto status``: how every stage of a workspace stands."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

import click

from pipeline.commands import options
from pipeline.engine.figures import telling
from pipeline.engine.runner import StageStatus, statuses
from pipeline.engine.settings import parse_settings
from pipeline.engine.workspace import open_workspace
from pipeline.recipe import RECIPE


@click.command()
@click.argument("workspace", type=click.Path(path_type=Path))
@options.settings
def status(workspace: Path, settings: tuple[str, ...]) -> None:
    """Say how every stage of a workspace stands, without changing anything.

    A stage is stale if `impasto run` with the same --set would redo it.
    """
    opened = open_workspace(workspace)
    click.echo(f"{opened.folder}, made from {opened.bundle}")
    found = list(statuses(RECIPE, opened, parse_settings(settings, RECIPE)))
    for text in table([row(entry) for entry in found]):
        click.echo(text)


HEADER = ("stage", "state", "when", "time", "figures")


def row(entry: StageStatus) -> tuple[str, ...]:
    """Return a stage's cells, in the order of ``HEADER``."""
    state, manifest = entry.state, entry.manifest
    if entry.state == "stale":
        state_text = f"stale: {entry.why}"
    elif manifest is not None and manifest.outcome == "no work":
        state_text = f"no work: {manifest.reason}"
    else:
        state_text = state
    if manifest is None:
        return entry.stage, state_text, "", "", ""
    when = datetime.fromisoformat(manifest.run["started"]).astimezone()
    elapsed = f"{manifest.run['elapsed_s']:.1f} s"
    return (
        entry.stage,
        state_text,
        f"{when:%Y-%m-%d %H:%M}",
        elapsed,
        telling(manifest.metrics),
    )


def table(rows: list[tuple[str, ...]]) -> list[str]:
    """Return aligned lines under the header."""
    lines = [HEADER, *rows]
    widths = [max(len(line[column]) for line in lines) for column in range(len(HEADER))]
    return [
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
        for line in lines
    ]
