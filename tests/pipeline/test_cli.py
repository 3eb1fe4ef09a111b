"""The command line itself: quick help, lazy commands, exit statuses, one-line errors."""

from __future__ import annotations

import errno
import importlib.util
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import click
import pytest

import pipeline
from pipeline import cli
from pipeline.errors import HardwareError, ImpastoError, UsageError

ROOT = Path(__file__).resolve().parents[2]
HEAVY = {
    "numpy", "scipy", "numba", "cv2", "pydantic", "rich", "wgpu", "OpenEXR", "colour", "rawpy",
    "serial", "multiprocessing", "hardware", "renderers", "pipeline.recipe",
    "pipeline.engine.stage",
}  # fmt: skip


def run_python(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=60
    )


def fail_with(monkeypatch: pytest.MonkeyPatch, error: BaseException) -> None:
    @click.command()
    def broken() -> None:
        raise error

    monkeypatch.setattr(cli.LazyGroup, "get_command", lambda *_: broken)


def call(*arguments: str) -> int:
    with pytest.raises(SystemExit) as ended:
        cli.main(arguments)
    assert isinstance(ended.value.code, int)
    return ended.value.code


@pytest.mark.parametrize("arguments", [["--help"], ["-h"], [], ["--version"], ["nonsense"]])
def test_help_imports_nothing_heavy(arguments: list[str]) -> None:
    code = (
        "import sys\nfrom pipeline.cli import main\n"
        f"try: main({arguments!r})\nexcept SystemExit: pass\n"
        "print(' '.join(sys.modules), file=sys.stderr)"
    )
    imported = set(run_python(code).stderr.split())
    assert "click" in imported
    assert not imported & HEAVY


def test_help_lists_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert call("--help") == 0
    printed = capsys.readouterr().out
    for name, (_, text) in cli.COMMANDS.items():
        assert f"\n  {name:11}  {text}\n" in printed


@pytest.mark.parametrize("name", list(cli.COMMANDS))
def test_commands_in_the_table_exist(name: str) -> None:
    module = cli.COMMANDS[name][0].partition(":")[0]
    assert importlib.util.find_spec(module) is not None
    command = cli.impasto.get_command(click.Context(cli.impasto), name)
    assert isinstance(command, click.Command)


def test_version_is_the_packages(capsys: pytest.CaptureFixture[str]) -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert project["version"] == pipeline.__version__
    assert call("--version") == 0
    assert capsys.readouterr().out == f"impasto, version {project['version']}\n"


def test_without_arguments_shows_help_and_is_wrong_usage(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert call() == 2
    assert "Commands:" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nonsense"], "no command 'nonsense'; expected one of demo, run, .*; see impasto --help"),
        (["--nonsense"], "No such option:? '?--nonsense'?; see impasto --help"),
        (["run"], "Missing argument 'BUNDLES...'; see impasto run --help"),
        (["run", "x"], "Missing option '--out'; see impasto run --help"),
        (["run", "x", "--out", "y", "--workers", "0"], "Invalid value for '--workers': .*"),
        (["run", "x", "--out", "y", "--from", "zip"], "--from: no stage 'zip'; expected one of .*"),
        (
            ["run", "x", "--out", "y", "--set", "a"],
            "--set a: not understood; expected stage.key=.*",
        ),
        (["scan", "x", "y"], "Got unexpected extra argument .*; see impasto scan --help"),
    ],
)
def test_wrong_usage_is_status_2_and_one_line(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(*arguments) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert re.fullmatch(f"impasto: {message}\n", printed.err)


@pytest.mark.parametrize(
    ("error", "status", "line"),
    [
        (ImpastoError("it is torn", where="a.png", fix="mend it"), 1, "a.png: it is torn; mend it"),
        (UsageError("not like this"), 2, "not like this"),
        (HardwareError("the table is stuck"), 3, "the table is stuck"),
        (KeyboardInterrupt(), 130, "interrupted; what was finished is kept"),
        (OSError(errno.ENOSPC, "No space left on device", "/d/scan"), 1,
         "/d/scan: No space left on device"),
        (PermissionError(errno.EACCES, "Permission denied", "/d"), 1, "/d: Permission denied"),
        (OSError("odd"), 1, "odd"),
        (MemoryError(), 1, "not enough memory"),
        (ValueError("a\nb"), 1,
         "internal error, ValueError: a b; please report it; --debug shows where it comes from"),
        (EOFError("cut"), 1,
         "internal error, EOFError: cut; please report it; --debug shows where it comes from"),
        (click.ClickException("no file"), 1, "no file"),
    ],
)  # fmt: skip
def test_errors_are_one_line_with_their_status(
    error: BaseException,
    status: int,
    line: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    fail_with(monkeypatch, error)
    assert call("run") == status
    assert capsys.readouterr().err == f"impasto: {line}\n"


@pytest.mark.parametrize("arguments", [["--debug", "run"], ["run", "--debug"]])
def test_debug_shows_the_traceback(
    arguments: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    fail_with(monkeypatch, ImpastoError("it is torn"))
    assert call(*arguments) == 1
    errors = capsys.readouterr().err
    assert errors.startswith("Traceback")
    assert errors.endswith("impasto: it is torn\n")


def test_debug_after_two_dashes_is_an_argument() -> None:
    arguments = ["run", "--debug", "--", "--debug"]
    assert cli._take_debug(arguments)
    assert arguments == ["run", "--", "--debug"]
    assert not cli._take_debug(arguments)


def test_reader_that_goes_away_is_no_disaster() -> None:
    process = subprocess.run(
        f"{{ {sys.executable} -m pipeline --help; echo status $? >&2; }} | true",
        shell=True, cwd=ROOT, capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert "Traceback" not in process.stderr
    assert "BrokenPipe" not in process.stderr
    assert process.stderr in ("status 0\n", "status 1\n")


def test_module_and_command_are_the_same() -> None:
    process = subprocess.run(
        [sys.executable, "-m", "pipeline", "--version"],
        cwd=ROOT, capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert process.stdout == f"impasto, version {pipeline.__version__}\n"
