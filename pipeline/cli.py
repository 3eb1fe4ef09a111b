"""The command line: a table of subcommands, imported when called, and the exit statuses.

0 done, 1 the data could not be processed, 2 wrong usage, 3 hardware, 130 interrupted.
"""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Sequence
from typing import NoReturn

import click

from pipeline import __version__
from pipeline.engine.failure import in_one_line

COMMANDS: dict[str, tuple[str, str]] = {
    "demo": ("pipeline.commands.demo:demo", "Simulated rig, bundle, asset, pictures and report."),
    "run": ("pipeline.commands.run:run", "Take bundles through all stages."),
    "calibrate": ("pipeline.commands.stage:calibrate", "Find lenses, poses and the projector."),
    "scan": ("pipeline.commands.stage:scan", "Decode the patterns and triangulate."),
    "extract": ("pipeline.commands.stage:extract", "Cut the canvas out as a height field."),
    "classify": ("pipeline.commands.stage:classify", "Find the relief, and boxes to hold it."),
    "reflectance": ("pipeline.commands.stage:reflectance", "Sample the photographs per texel."),
    "fit": ("pipeline.commands.stage:fit", "Fit the reflectance of every texel."),
    "pack": ("pipeline.commands.stage:pack", "Write the asset."),
    "status": ("pipeline.commands.status:status", "Say how every stage of a workspace stands."),
    "report": ("pipeline.commands.report:report", "Write a workspace's page with all figures."),
    "render": ("pipeline.commands.render:render", "Draw an asset."),
    "bench": ("pipeline.commands.bench:bench", "Measure run time against error."),
    "doctor": ("pipeline.commands.doctor:doctor", "Say what this machine has."),
}
"""Where each subcommand is implemented (``module:attribute``), and its line of help."""


class LazyGroup(click.Group):
    """A group whose help comes from the table alone."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002 - click's form
        """Name the subcommands in the table's order."""
        return list(COMMANDS)

    def get_command(
        self,
        ctx: click.Context,  # noqa: ARG002 - click's form
        cmd_name: str,
    ) -> click.Command | None:
        """Import a subcommand."""
        if cmd_name not in COMMANDS:
            return None
        module_name, _, attribute = COMMANDS[cmd_name][0].partition(":")
        command: click.Command = getattr(importlib.import_module(module_name), attribute)
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the subcommand, or name those that there are."""
        if args and args[0] not in COMMANDS and not args[0].startswith("-"):
            raise click.UsageError(
                f"no command {args[0]!r}; expected one of {', '.join(COMMANDS)}", ctx
            )
        return super().resolve_command(ctx, args)

    def format_commands(
        self,
        ctx: click.Context,  # noqa: ARG002 - click's form
        formatter: click.HelpFormatter,
    ) -> None:
        """List the subcommands without importing them."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in COMMANDS.items()])


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="impasto")
@click.option("--debug", is_flag=True, help="Show the traceback of an error (works anywhere).")
def impasto(debug: bool) -> None:
    """Digitise paintings and small objects, and show them again in real time."""


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and exit with its status; every error is one line on stderr."""
    # The order of BLAS's sums, and so the last bits, would depend on its number of threads; our
    # systems are small, and our own kernels use the cores.
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    debug = _take_debug(arguments)
    try:
        # Not impasto.main(): it has its own ideas of what an interruption looks like.
        with impasto.make_context("impasto", arguments) as context:
            impasto.invoke(context)
        sys.stdout.flush()
    except BaseException as error:
        if debug and not isinstance(error, (click.exceptions.Exit, SystemExit)):
            import traceback

            traceback.print_exc()
        sys.exit(report(error))
    sys.exit(0)


def report(error: BaseException) -> int:
    """Tell people of an error in one line; return the exit status."""
    match error:
        case click.exceptions.NoArgsIsHelpError():
            print(error.format_message(), file=sys.stderr)  # noqa: T201
            return 2
        case click.exceptions.Exit():
            return error.exit_code
        case SystemExit():
            return error.code if isinstance(error.code, int) else 1
        case click.Abort():
            return report(KeyboardInterrupt())
        case click.UsageError():
            command = error.ctx.command_path if error.ctx else "impasto"
            _say(f"{error.format_message().rstrip('.')}; see {command} --help")
            return 2
        case click.ClickException():
            _say(error.format_message())
            return 1
        case BrokenPipeError():
            # Whoever read our output went away; the interpreter must not try to flush it again.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return 1
        case _:
            status, text = in_one_line(error)
            _say(text)
            return status


def _say(text: str) -> None:
    print("impasto:", " ".join(text.split()), file=sys.stderr)  # noqa: T201


def _take_debug(arguments: list[str]) -> bool:
    end = arguments.index("--") if "--" in arguments else len(arguments)
    options = [argument for argument in arguments[:end] if argument != "--debug"]
    found = len(options) < end
    arguments[:end] = options
    return found


if __name__ == "__main__":
    main()
