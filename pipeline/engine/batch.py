"""Several bundles, each in its own process: one that fails or dies does not stop the others."""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from pathlib import Path

from pipeline.engine.display import Lines, Quiet
from pipeline.engine.failure import in_one_line
from pipeline.engine.recipe import Recipe
from pipeline.engine.runner import Display, Result, Selection, plan, run_plan
from pipeline.engine.workspace import create_workspace

THREAD_LIMITS = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")
_POLL_S = 60.0


@dataclass(frozen=True)
class Job:
    """A bundle to be taken through a recipe into a workspace."""

    bundle: Path
    out: Path
    recipe: Recipe
    selection: Selection

    @property
    def name(self) -> str:
        """The name of the bundle's folder."""
        return self.bundle.resolve().name


@dataclass(frozen=True)
class Ending:
    """How a job ended: exit status, and one line."""

    job: Job
    status: int
    text: str
    elapsed_s: float


def run_job(job: Job, display: Display) -> list[Result]:
    """Do one job in this process."""
    planned = plan(job.recipe, job.selection)
    folders = tuple(reference.folder for reference in job.recipe)
    workspace = create_workspace(job.out, job.bundle, folders)
    return run_plan(planned, workspace, display, force=job.selection.force)


def work_done(results: Sequence[Result]) -> str:
    """Say in a few words what a job came to."""
    done = sum(result.ran for result in results)
    return f"{done} of {len(results)} stages done" if done else "nothing to do"


def run_batch(
    jobs: Sequence[Job], workers: int, *, quiet: bool, ended: Callable[[Ending], None]
) -> list[Ending]:
    """Do jobs in at most ``workers`` processes; their lines begin with the bundle's name.

    ``ended`` is called as each job ends. On KeyboardInterrupt the processes are terminated; their
    workspaces stay consistent.

    Returns
    -------
    list of Ending
        In the order of ``jobs``.
    """
    context = multiprocessing.get_context("spawn")
    threads = max(1, len(os.sched_getaffinity(0)) // min(workers, len(jobs)))
    waiting = deque(enumerate(jobs))
    running: dict[int, tuple[int, SpawnProcess, Connection, float]] = {}
    endings: dict[int, Ending] = {}
    try:
        while waiting or running:
            while waiting and len(running) < workers:
                index, job = waiting.popleft()
                receiver, sender = context.Pipe(duplex=False)
                process = context.Process(target=_work, args=(job, threads, quiet, sender))
                with _interrupts_ignored():
                    process.start()
                sender.close()
                running[process.sentinel] = (index, process, receiver, time.perf_counter())
            for sentinel in wait(list(running), timeout=_POLL_S):
                assert isinstance(sentinel, int)
                index, process, receiver, started = running.pop(sentinel)
                status, text = _result(process, receiver)
                ending = Ending(jobs[index], status, text, time.perf_counter() - started)
                endings[index] = ending
                ended(ending)
    finally:
        for _, process, _, _ in running.values():
            process.terminate()
        for _, process, _, _ in running.values():
            process.join()
    return [endings[index] for index in range(len(jobs))]


@contextmanager
def _interrupts_ignored() -> Iterator[None]:
    """Let a process started in this block ignore Ctrl-C, which its parent turns into an end."""
    previous = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, previous)


def _result(process: SpawnProcess, receiver: Connection) -> tuple[int, str]:
    process.join()
    with receiver:
        try:
            status, text = receiver.recv()
        except EOFError:
            return 1, f"its process died (exit status {process.exitcode})"
    return status, text


def _work(job: Job, threads: int, quiet: bool, sender: Connection) -> None:
    # Before numpy and numba are imported, which read these once.
    for name in THREAD_LIMITS:
        os.environ.setdefault(name, str(threads))
    try:
        results = run_job(job, Quiet() if quiet else Lines(f"{job.name}: "))
        answer = 0, work_done(results)
    except BaseException as error:
        answer = in_one_line(error)
    sender.send(answer)
    sender.close()
