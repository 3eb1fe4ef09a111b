"""What a run shows on a terminal and elsewhere."""

from __future__ import annotations

import pytest

from pipeline.engine.display import Bars, Lines, Quiet, make_display
from pipeline.engine.manifest import Manifest
from pipeline.engine.runner import Result


def result(why: str = "not run yet", ran: bool = True) -> Result:
    manifest = Manifest(
        "scan", 1, {}, {}, {}, "done",
        metrics={"share_measured": 0.5}, warnings=["[bold]dark"], run={"elapsed_s": 1.94},
    )  # fmt: skip
    return Result("scan", ran, why, manifest)


def test_choice() -> None:
    assert type(make_display(quiet=True, terminal=True)) is Quiet
    assert type(make_display(quiet=False, terminal=True)) is Bars
    assert type(make_display(quiet=False, terminal=False)) is Lines


@pytest.mark.parametrize("kind", [Lines, Bars])
def test_lines(kind: type[Lines], capsys: pytest.CaptureFixture[str]) -> None:
    with kind() as display:
        display.started("scan", "not run yet")
        display.progress(1, 2, "frames")
        display.progress(2, 2, "frames")
        display.finished(result())
        display.finished(result(ran=False))
        display.started("fit", "forced")
        display.failed("fit")
    lines = [line.rstrip() for line in capsys.readouterr().out.splitlines()]
    lines = [line for line in lines if line]
    assert lines == [
        "scan        done in 1.9 s   (50.0 % measured)",
        "            warning: [bold]dark",
        "scan        up to date",
        "fit         stopped",
    ]
