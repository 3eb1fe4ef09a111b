"""Options shared by the commands that run stages, and the closing words of a run."""

from __future__ import annotations

from collections.abc import Sequence

import click

from pipeline.engine.runner import Result

force = click.option("--force", is_flag=True, help="Redo stages that are up to date, too.")
settings = click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="STAGE.KEY=VALUE",
    help="Configure a stage, for this run only; may be repeated.",
)
quiet = click.option("--quiet", "-q", is_flag=True, help="Print nothing but errors.")


def closing_words(results: Sequence[Result]) -> list[str]:
    """Return what is printed at the end of a run: what was skipped, or that nothing was done."""
    if not any(result.ran for result in results):
        stages = "the stage is" if len(results) == 1 else f"all {len(results)} stages are"
        return [f"nothing to do: {stages} up to date"]
    skips = [
        f"  {result.stage}: {skip['what']}: {skip['why']}"
        for result in results
        if result.ran
        for skip in result.manifest.skipped
    ]
    return ["skipped, as not needed:", *skips] if skips else []
