"""The errors a user meets: one line that says what, where, what was expected and what to do.

The command line prints ``str(error)`` and exits with ``error.exit_status``; a traceback is shown
only with ``--debug``. Anything that is not an :class:`ImpastoError` is a defect of the program.
"""

from __future__ import annotations


class ImpastoError(Exception):
    """The data could not be processed (exit status 1).

    Parameters
    ----------
    problem
        What is wrong, including the value that was given.
    where
        File, and key inside it, that the problem was found in (``capture.json: photos[3].light``).
    expected
        What would have been right.
    fix
        What the user can do about it.
    """

    exit_status = 1

    def __init__(
        self,
        problem: str,
        *,
        where: str | None = None,
        expected: str | None = None,
        fix: str | None = None,
    ) -> None:
        self.problem, self.where, self.expected, self.fix = problem, where, expected, fix
        text = f"{where}: {problem}" if where else problem
        if expected:
            text += f"; expected {expected}"
        if fix:
            text += f"; {fix}"
        super().__init__(" ".join(text.split()))


class UsageError(ImpastoError):
    """The command was called wrongly (exit status 2)."""

    exit_status = 2


class HardwareError(ImpastoError):
    """A device failed or did not answer in time (exit status 3)."""

    exit_status = 3
