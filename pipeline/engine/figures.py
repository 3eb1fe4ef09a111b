"""Metrics in words: ``share_filled`` 0.021 is "2.1 % filled", ``rms_px`` 0.2 is "rms 0.2 px"."""

from __future__ import annotations

from collections.abc import Mapping

UNITS = {"mm": "mm", "um": "µm", "px": "px", "deg": "°", "s": "s", "percent": "%", "per_sr": "1/sr"}


def in_words(name: str, value: float | int | str | None) -> str:
    """Return one metric for people; the unit is taken from the end of its name."""
    if value is None:
        return f"{name.replace('_', ' ')} not finite"
    if name.startswith("share_") and isinstance(value, (int, float)):
        return f"{100 * value:.1f} % {name.removeprefix('share_').replace('_', ' ')}"
    unit = next((unit for unit in UNITS if name.endswith("_" + unit)), "")
    words = name.removesuffix("_" + unit).replace("_", " ") if unit else name.replace("_", " ")
    if isinstance(value, float):
        number = f"{value:.4g}"
    else:
        number = str(value)
    return f"{words} {number} {UNITS[unit]}" if unit else f"{words} {number}"


def telling(metrics: Mapping[str, float | int | str | None], most: int = 3) -> str:
    """Return the first metrics in words."""
    return ", ".join(in_words(name, value) for name, value in list(metrics.items())[:most])
