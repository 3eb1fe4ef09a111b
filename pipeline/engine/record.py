"""What a running stage says, and what running it costs."""

from __future__ import annotations

import math
import resource
import sys
from collections.abc import Callable
from pathlib import Path


class RecordingLog:
    """The engine's :class:`~pipeline.engine.stage.Log`: keeps everything, shows progress."""

    def __init__(self, show_progress: Callable[[float, float, str], None]) -> None:
        self._show_progress = show_progress
        self.metrics: dict[str, float | int | str | None] = {}
        self.warnings: list[str] = []
        self.skips: list[dict[str, str]] = []

    def progress(self, done: float, total: float, what: str = "") -> None:
        """Show that ``done`` of ``total`` units are done."""
        self._show_progress(done, total, what)

    def metric(self, name: str, value: float | int | str) -> None:
        """Record a figure; numpy's scalars are fine; null stands for one that is not finite."""
        plain = value.item() if hasattr(value, "item") else value
        if not isinstance(plain, (str, int, float)):
            raise TypeError(f"metric {name}: {type(value).__name__} is not a number or a text")
        finite = not isinstance(plain, float) or math.isfinite(plain)
        self.metrics[name] = plain if finite else None

    def warning(self, text: str) -> None:
        """Record something doubtful."""
        self.warnings.append(text)

    def skipped(self, what: str, why: str) -> None:
        """Record work that was not needed."""
        self.skips.append({"what": what, "why": why})


class PeakMemory:
    """The largest resident set of this process since the object was made.

    Linux lets a process reset its high-water mark; then the figure is this stage's (with all that
    was resident when it started). Elsewhere it is the largest since the process started.
    """

    def __init__(self) -> None:
        self._status: Path | None = Path("/proc/self/status")
        try:
            Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
            self._high_water(self._status)
        except (OSError, StopIteration):
            self._status = None

    def bytes_and_method(self) -> tuple[int, str]:
        """Return the figure, and how it was measured."""
        if self._status is not None:
            return self._high_water(self._status), "resident set, high-water mark of the stage"
        unit = 1 if sys.platform == "darwin" else 1024
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit
        return peak, "resident set, high-water mark of the process so far"

    @staticmethod
    def _high_water(status: Path) -> int:
        lines = status.read_text(encoding="ascii", errors="replace").splitlines()
        return 1024 * int(next(line for line in lines if line.startswith("VmHWM")).split()[1])
