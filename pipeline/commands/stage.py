"""``impasto calibrate|scan|...``: one stage of a workspace."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from pipeline.commands import options
from pipeline.engine.display import make_display
from pipeline.engine.runner import Selection, plan, run_plan
from pipeline.engine.settings import parse_settings
from pipeline.engine.workspace import open_workspace, require_bundle
from pipeline.recipe import RECIPE


def _stage_command(name: str) -> click.Command:
    @click.command(name, help=f"Do {name} alone, from what the stages before left in WORKSPACE.")
    @click.argument("workspace", type=click.Path(path_type=Path))
    @options.force
    @options.settings
    @options.quiet
    def command(workspace: Path, force: bool, settings: tuple[str, ...], quiet: bool) -> None:
        run_stage(name, workspace, force, settings, quiet)

    return command


def run_stage(name: str, folder: Path, force: bool, settings: tuple[str, ...], quiet: bool) -> None:
    """Bring one stage up to date from what the workspace holds; those before it stay as they are.

    Raises
    ------
    ImpastoError
        The folder is no workspace, a stage before has not been run, or the stage failed.
    """
    selection = Selection(name, name, force, parse_settings(settings, RECIPE))
    planned = plan(RECIPE, selection)
    workspace = open_workspace(folder)
    require_bundle(workspace.bundle)
    with make_display(quiet=quiet, terminal=sys.stdout.isatty()) as display:
        results = run_plan(planned, workspace, display, force=force)
    if not quiet:
        for text in options.closing_words(results):
            click.echo(text)


calibrate = _stage_command("calibrate")
scan = _stage_command("scan")
extract = _stage_command("extract")
classify = _stage_command("classify")
reflectance = _stage_command("reflectance")
fit = _stage_command("fit")
pack = _stage_command("pack")
