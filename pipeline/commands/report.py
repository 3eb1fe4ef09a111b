"""``impasto report``: one page that shows a workspace."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from pipeline.report.truth import TruthErrors


@click.command(short_help="Write a page that shows a workspace.")
@click.argument("workspace", type=click.Path(path_type=Path))
@click.option(
    "--out",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Where to write the page; WORKSPACE/report.html if left out.",
)
@click.option(
    "--truth",
    type=click.Path(path_type=Path, exists=True, file_okay=False),
    help="A folder with the capture's known truth, to compare with.",
)
@click.option("--no-pictures", is_flag=True, help="Leave the renders out.")
def report(workspace: Path, out: Path | None, truth: Path | None, no_pictures: bool) -> None:
    """Write one HTML page, without outside resources, that shows WORKSPACE.

    The page has the capture, the range map, the height field, the relief, renders under several
    lamps, and how each stage went.
    """
    page, _ = write(workspace, out, truth=truth, with_pictures=not no_pictures, say=click.echo)
    click.echo(f"report     {page}")


def write(
    folder: Path,
    out: Path | None,
    *,
    truth: Path | None,
    with_pictures: bool,
    say: Callable[[str], None],
) -> tuple[Path, TruthErrors | None]:
    """Draw the pictures if there is an asset, compare with the truth if given, write the page.

    Returns
    -------
    Where the page is, and the errors against the truth.
    """
    from pipeline.commands.pictures import draw_pictures
    from pipeline.engine.workspace import open_workspace
    from pipeline.formats.height_field import HEIGHT
    from pipeline.formats.reflectance_maps import MAPS
    from pipeline.report.page import write_report
    from pipeline.report.truth import errors_against_truth

    workspace = open_workspace(folder)
    packed = workspace.manifest("asset")
    pictures = []
    if with_pictures and packed is not None and packed.outcome == "done":
        drawn = draw_pictures(workspace.folder / "asset", workspace.folder / "pictures", say=say)
        pictures = [(picture.path, picture.caption) for picture in drawn]
    errors = None
    if truth is not None:
        fitted = workspace.manifest("fit")
        maps = MAPS.load(workspace.folder) if fitted and fitted.outcome == "done" else None
        errors = errors_against_truth(HEIGHT.load(workspace.folder), truth, maps=maps)
    page = workspace.folder / "report.html" if out is None else out
    write_report(workspace, page, pictures=pictures, truth=errors)
    return page, errors
