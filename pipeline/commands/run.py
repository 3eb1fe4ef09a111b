"""``impasto run``: bundles through all stages, one after another or several at once."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import click

from pipeline.commands import options
from pipeline.engine.batch import Ending, Job, run_batch, run_job
from pipeline.engine.cluster import run_on_cluster
from pipeline.engine.display import make_display
from pipeline.engine.recipe import between
from pipeline.engine.runner import Selection
from pipeline.engine.settings import parse_settings
from pipeline.errors import ImpastoError, UsageError
from pipeline.recipe import RECIPE


@click.command()
@click.argument("bundles", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--out",
    required=True,
    type=click.Path(path_type=Path),
    help="The workspace of one bundle; of several, the folder of theirs.",
)
@click.option("--from", "first", metavar="STAGE", help="Leave the stages before this one alone.")
@click.option("--to", "last", metavar="STAGE", help="Stop after this stage.")
@options.force
@options.settings
@click.option(
    "--workers", type=click.IntRange(1), default=1, help="Bundles processed at once.  [default: 1]"
)
@click.option("--dask", metavar="ADDRESS", help="Send each bundle to this Dask scheduler.")
@options.quiet
def run(
    bundles: tuple[Path, ...],
    out: Path,
    first: str | None,
    last: str | None,
    force: bool,
    settings: tuple[str, ...],
    workers: int,
    dask: str | None,
    quiet: bool,
) -> None:
    """Take capture bundles through all stages; what is up to date is skipped.

    One BUNDLE: DIR becomes its workspace. Several: DIR/<bundle name>.
    """
    between(RECIPE, first, last)
    selection = Selection(first, last, force, parse_settings(settings, RECIPE))
    jobs = make_jobs(bundles, out, selection)
    if len(jobs) > 1 or dask is not None:
        run_several(jobs, workers, dask, quiet)
        return
    with make_display(quiet=quiet, terminal=sys.stdout.isatty()) as display:
        results = run_job(jobs[0], display)
    if not quiet:
        for text in options.closing_words(results):
            click.echo(text)


def make_jobs(bundles: Sequence[Path], out: Path, selection: Selection) -> list[Job]:
    """Return one job per bundle.

    Raises
    ------
    UsageError
        Two bundles would share a workspace.
    """
    if len(bundles) == 1:
        return [Job(bundles[0], out, RECIPE, selection)]
    jobs = [Job(bundle, out / bundle.resolve().name, RECIPE, selection) for bundle in bundles]
    repeated = [name for name, count in Counter(job.name for job in jobs).items() if count > 1]
    if repeated:
        raise UsageError(f"two bundles are named {repeated[0]!r}", fix="run them with two --out")
    return jobs


def run_several(jobs: Sequence[Job], workers: int, dask: str | None, quiet: bool) -> None:
    """Do the jobs here or on a cluster; errors are told as they come, and a table closes.

    Raises
    ------
    ImpastoError
        Some bundles could not be processed; the others were.
    """

    def ended(ending: Ending) -> None:
        if ending.status:
            click.echo(f"impasto: {ending.job.name}: {ending.text}", err=True)

    if dask is None:
        endings = run_batch(jobs, workers, quiet=quiet, ended=ended)
    else:
        endings = run_on_cluster(jobs, dask, ended=ended)
    if not quiet:
        width = max(len(job.name) for job in jobs)
        for ending in endings:
            outcome = "failed" if ending.status else ending.text
            click.echo(f"{ending.job.name:{width}}  {ending.elapsed_s:6.1f} s  {outcome}")
    failed = [ending.job.name for ending in endings if ending.status]
    if failed:
        raise ImpastoError(
            f"{len(failed)} of {len(jobs)} bundles could not be processed: {', '.join(failed)}"
        )
