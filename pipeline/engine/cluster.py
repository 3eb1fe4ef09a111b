"""Several bundles on a Dask cluster, one task each."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from pipeline.engine.batch import Ending, Job, run_job, work_done
from pipeline.engine.display import Quiet
from pipeline.engine.failure import in_one_line
from pipeline.errors import ImpastoError, UsageError

_CONNECT_S = 20


def run_on_cluster(
    jobs: Sequence[Job], address: str, *, ended: Callable[[Ending], None]
) -> list[Ending]:
    """Do jobs as tasks of the Dask scheduler at ``address``; ``ended`` is called as each ends.

    The workers must have this program installed and see the same folders under the same paths.
    When this process is interrupted, tasks that have not begun are dropped.

    Raises
    ------
    UsageError
        The package ``distributed`` is not installed.
    ImpastoError
        No scheduler answers at ``address``.

    Returns
    -------
    list of Ending
        In the order of ``jobs``.
    """
    try:
        distributed = importlib.import_module("distributed")
    except ModuleNotFoundError:
        raise UsageError(
            "--dask needs the package distributed, which is not installed",
            fix="pip install 'impasto[cluster]'",
        ) from None
    try:
        client = distributed.Client(address, timeout=_CONNECT_S)
    except (OSError, ValueError) as error:
        raise ImpastoError(
            f"--dask {address}: no scheduler answers ({error})",
            expected="an address such as tcp://host:8786",
        ) from error
    endings: dict[int, Ending] = {}
    with client:
        futures: dict[Any, int] = {
            client.submit(_do, _absolute(job), key=f"impasto-{index}-{time.time_ns()}"): index
            for index, job in enumerate(jobs)
        }
        for future in distributed.as_completed(futures):
            job = jobs[futures[future]]
            if future.status == "finished":
                status, text, elapsed_s = future.result()
            else:
                status, text, elapsed_s = 1, f"its task was lost ({future.exception()!r})", 0.0
            ending = Ending(job, status, " ".join(text.split()), elapsed_s)
            endings[futures[future]] = ending
            ended(ending)
    return [endings[index] for index in range(len(jobs))]


def _absolute(job: Job) -> Job:
    return replace(job, bundle=job.bundle.absolute(), out=job.out.absolute())


def _do(job: Job) -> tuple[int, str, float]:
    started = time.perf_counter()
    try:
        status, text = 0, work_done(run_job(job, Quiet()))
    except Exception as error:
        status, text = in_one_line(error)
    return status, text, time.perf_counter() - started
