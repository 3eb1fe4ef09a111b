"""``impasto bench``: run time against error, measured on this machine."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import click

from pipeline.errors import UsageError

NAMES = ("calibrate", "scan", "extract", "classify")
FOLDER = Path(__file__).resolve().parents[2] / "benchmarks"


@click.command(short_help="Measure run time against error.")
@click.argument("names", nargs=-1, metavar="[NAME]...")
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    required=True,
    help="Where NAME.json and NAME.svg go.",
)
@click.option("--quick", is_flag=True, help="Fewer and smaller cases, to see that all works.")
def bench(names: tuple[str, ...], out: Path, quick: bool) -> None:
    """Measure run time against error: calibrate, scan, extract, classify, or all of them.

    Prints a table for each and writes it as JSON and as a picture with the frontier of what is
    fastest at its error. Captures are made on the way, with known truth.
    """
    if unknown := [name for name in names if name not in NAMES]:
        raise UsageError(f"no benchmark {unknown[0]!r}", expected=f"one of {', '.join(NAMES)}")
    if not FOLDER.is_dir():
        raise UsageError(
            "the benchmarks are not part of an installed package",
            fix="run ./impasto bench in a checkout of the sources",
        )
    if str(FOLDER.parent) not in sys.path:
        sys.path.insert(0, str(FOLDER.parent))
    for name in names or NAMES:
        result = importlib.import_module(f"benchmarks.{name}").measure(quick=quick)
        click.echo(result.table())
        for path in result.write(out):
            click.echo(f"  {path}")
