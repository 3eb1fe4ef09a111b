"""``impasto demo``: a simulated painting is captured, processed, drawn, and compared to truth."""

from __future__ import annotations

import json
import shutil
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

from pipeline.errors import UsageError

if TYPE_CHECKING:
    from pipeline.report.truth import TruthErrors

MARK = "demo.json"


@click.command(short_help="Simulated rig, bundle, asset, pictures and report.")
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("demo"),
    show_default=True,
    help="Where everything goes.",
)
@click.option(
    "--seed",
    type=click.IntRange(0),
    default=1,
    show_default=True,
    help="Of the noise and the painting.",
)
@click.option(
    "--photos",
    type=click.IntRange(0, 1000),
    default=32,
    show_default=True,
    help="How many photographs the simulated rig takes; 0 leaves reflectance out.",
)
def demo(out: Path, seed: int, photos: int) -> None:
    """Show the whole chain on a simulated painting, in about a minute.

    Leaves the capture bundle, its truth, all stages' results, the asset, pictures and report.html
    in the folder. A second call redoes only what changed.
    """
    from pipeline.commands import report
    from pipeline.engine.batch import Job, run_job
    from pipeline.engine.display import make_display
    from pipeline.engine.runner import Selection
    from pipeline.recipe import RECIPE

    started = time.perf_counter()
    out.mkdir(parents=True, exist_ok=True)
    bundle, truth = out / "bundle", out / "truth"
    capture(out, seed, photos)
    with make_display(quiet=False, terminal=sys.stdout.isatty()) as display:
        run_job(Job(bundle, out, RECIPE, Selection()), display)
    page, errors = report.write(out, None, truth=truth, with_pictures=True, say=click.echo)
    if errors is not None:
        show_errors(errors)
    click.echo(f"asset      {out / 'asset'}")
    click.echo(f"report     {page}")
    click.echo(f"all done in {time.perf_counter() - started:.0f} s")


def capture(out: Path, seed: int, photos: int) -> None:
    """Let the simulated rig record a bundle and its truth, unless they are there already.

    A mark says how the capture is made, and at last that it is complete: a broken-off one is made
    again, and a folder that bears no mark is never touched.

    Raises
    ------
    UsageError
        There is a ``bundle`` or ``truth`` that this command did not make.
    """
    from hardware.simulated.studio import VERSION, Setting, record
    from pipeline.formats.atomic import write_text_atomically

    mark, folders = out / MARK, (out / "bundle", out / "truth")
    wanted = {"version": VERSION, "seed": seed, "photos": photos}
    found = read_mark(mark)
    if found == wanted | {"complete": True} and all(folder.is_dir() for folder in folders):
        click.echo("capture    up to date")
        return
    for folder in folders:
        if folder.exists() and found is None:
            raise UsageError(
                f"{folder} was not made by impasto demo", fix="choose another folder with --out"
            )
    write_text_atomically(mark, json.dumps(wanted | {"complete": False}) + "\n")
    for folder in folders:
        if folder.exists():
            shutil.rmtree(folder)
    started = time.perf_counter()
    shown = ""

    def progress(what: str, _done: int, total: int) -> None:
        nonlocal shown
        if what != shown:
            shown = what
            click.echo(f"capture    {what}" + (f" ({total})" if total > 1 else ""))

    record(Setting(seed=seed, photos=photos), *folders, progress)
    write_text_atomically(mark, json.dumps(wanted | {"complete": True}) + "\n")
    click.echo(f"capture    done in {time.perf_counter() - started:.1f} s")


def read_mark(mark: Path) -> dict[str, object] | None:
    """Return what the mark says; None without one."""
    try:
        found = json.loads(mark.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except (OSError, ValueError):
        found = {}
    return found if isinstance(found, dict) else {}


def show_errors(errors: TruthErrors) -> None:
    """Print the errors against the truth."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title="errors against the truth", title_justify="left", box=None)
    table.add_column("figure")
    table.add_column("value", justify="right")
    table.add_column("unit")
    for name, value, unit in errors.rows():
        table.add_row(name, f"{value:.3g}", unit)
    Console().print(table)
