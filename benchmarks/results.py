"""Run time against error: rows of a benchmark, and its table, JSON and picture."""

from __future__ import annotations

import json
import math
import platform
import statistics
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Row:
    """One way of doing it.

    Parameters
    ----------
    name
        What was varied.
    seconds, error
        Median run time; error against the truth, in the benchmark's unit, NaN if there is none.
    default, peer
        It is what the stage does unless told otherwise; it is another program.
    figures
        Whatever else was measured.
    """

    name: str
    seconds: float
    error: float
    default: bool = False
    peer: bool = False
    figures: dict[str, float | str] = field(default_factory=dict)


@dataclass(frozen=True)
class Result:
    """All rows of one benchmark."""

    name: str
    title: str
    error_name: str
    rows: list[Row]
    notes: list[str] = field(default_factory=list)

    def frontier(self) -> list[Row]:
        """Return the rows that no other beats in both time and error, the fastest first."""
        kept: list[Row] = []
        for row in sorted(self.rows, key=lambda row: (row.seconds, row.error)):
            if math.isfinite(row.error) and (not kept or row.error < kept[-1].error):
                kept.append(row)
        return kept

    def table(self) -> str:
        """Return the rows as text; * is the default, + lies on the frontier."""
        best = self.frontier()
        keys = list(dict.fromkeys(key for row in self.rows for key in row.figures))
        lines = [f"{self.title}", f"  {'':44}{'s':>9}{self.error_name:>22}" + "".join(
            f"{key:>22}" for key in keys)]  # fmt: skip
        for row in self.rows:
            mark = ("*" if row.default else " ") + ("+" if row in best else " ")
            cells = "".join(f"{_text(row.figures.get(key, '')):>22}" for key in keys)
            lines.append(f"{mark}{row.name:44}{row.seconds:9.3f}{_text(row.error):>22}{cells}")
        return "\n".join([*lines, *(f"  {note}" for note in self.notes)])

    def write(self, folder: Path) -> list[Path]:
        """Write NAME.json and NAME.svg; return where."""
        folder.mkdir(parents=True, exist_ok=True)
        document: dict[str, Any] = {
            "name": self.name,
            "title": self.title,
            "error": self.error_name,
            "date": time.strftime("%Y-%m-%d"),
            "machine": f"{platform.machine()}, {platform.python_version()}",
            "rows": [
                asdict(row) | {"error": row.error if math.isfinite(row.error) else None}
                for row in self.rows
            ],
            "frontier": [row.name for row in self.frontier()],
            "notes": self.notes,
        }
        text, picture = folder / f"{self.name}.json", folder / f"{self.name}.svg"
        text.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
        picture.write_text(self.svg(), encoding="utf-8")
        return [text, picture]

    def svg(self) -> str:
        """Draw error over time, both logarithmic: the frontier as a line, the default filled."""
        shown = [row for row in self.rows if row.error > 0 and row.seconds > 0]
        if not shown:
            return '<svg xmlns="http://www.w3.org/2000/svg"/>\n'
        width, height, edge, plot = 980, max(420, 90 + 22 * len(shown)), 64, 560
        x = _scale([row.seconds for row in shown], edge, plot)
        y = _scale([row.error for row in shown], height - edge, 50)
        best = [row for row in self.frontier() if row in shown]
        path = " ".join(f"{x(row.seconds):.1f},{y(row.error):.1f}" for row in best)
        parts = [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" '
            'font-family="sans-serif" font-size="12">',
            '<rect width="100%" height="100%" fill="#fff"/>',
            f'<text x="{edge}" y="22" font-size="15">{_safe(self.title)}</text>',
            f'<text x="{edge}" y="{height - 14}">run time, s (logarithmic)</text>',
            f'<text x="8" y="42">{_safe(self.error_name)}</text>',
            f'<path d="M{edge} 50V{height - edge}H{plot}" fill="none" stroke="#999"/>',
            f'<polyline points="{path}" fill="none" stroke="#8a4b2a"/>',
        ]
        seconds, errors = ([getattr(row, key) for row in shown] for key in ("seconds", "error"))
        parts += [
            f'<text x="{x(value) - 12:.1f}" y="{height - edge + 18}">{value:.2g}</text>'
            for value in (min(seconds), max(seconds))
        ]
        parts += [
            f'<text x="8" y="{y(value) + 4:.1f}">{value:.3g}</text>'
            for value in (min(errors), max(errors))
        ]
        for number, row in enumerate(shown, start=1):
            colour = "#777" if row.peer else "#1d4f91"
            fill, ink = (colour, "#fff") if row.default else ("#fff", colour)
            left, top = x(row.seconds), y(row.error)
            parts.append(
                f'<circle cx="{left:.1f}" cy="{top:.1f}" r="9" fill="{fill}" stroke="{colour}"/>'
                f'<text x="{left:.1f}" y="{top + 4:.1f}" fill="{ink}" font-size="10" '
                f'text-anchor="middle">{number}</text>'
                f'<text x="{plot + 24}" y="{50 + 22 * number}" fill="{colour}">{number}  '
                f"{_safe(row.name)}: {row.seconds:.3g} s, {row.error:.3g}</text>"
            )
        return "".join(parts) + "</svg>\n"


def timed(action: Callable[[], Any], turns: int = 3) -> tuple[float, Any]:
    """Return the median time of some calls after one to warm up, and the last result."""
    found = action()
    seconds = []
    for _ in range(turns):
        started = time.perf_counter()
        found = action()
        seconds.append(time.perf_counter() - started)
    return statistics.median(seconds), found


def _scale(values: list[float], start: float, end: float) -> Callable[[float], float]:
    low, high = math.log(min(values)) - 0.1, math.log(max(values)) + 0.1
    return lambda value: start + (math.log(value) - low) / (high - low) * (end - start)


def _text(value: float | str) -> str:
    return value if isinstance(value, str) else "-" if math.isnan(value) else f"{value:.4g}"


def _safe(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
