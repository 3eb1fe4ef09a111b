"""The report's section on calibration: residuals, coverage, and what to photograph next."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.board_residuals import BoardResiduals, Correlation, ViewResiduals
from pipeline.formats.calibration import Calibration
from pipeline.report import html

CELLS = 4
"""The picture is cut into CELLS x CELLS parts to see which of them held a corner."""

LEAST_TILT, LEAST_TILT_RANGE, LEAST_DISTANCE_RATIO = 20.0, 15.0, 1.1
SUGGESTED_VIEWS = 8
STRONG = 0.95
_MOST_CORRELATIONS = 6
_ARROW_SHARE = 0.03
"""Length of a typical residual's line, of the picture's width."""

_PLACES = ("top", "upper middle", "lower middle", "bottom")
_SIDES = ("left", "left of the middle", "right of the middle", "right")


def calibration(rig: Calibration, fit: BoardResiduals) -> str:
    """Show how every corner fits, how sure the parameters are, and what would help."""
    if not fit.views:
        text = "Cameras and projector were given with the capture; nothing was calibrated."
        return html.section("calibration", "The calibration", text, _parameters(rig))
    devices = sorted({view.device for view in fit.views})
    figures = []
    for device in devices:
        size = _size_px(rig, device)
        if size is not None:
            figures.append(residual_plot([v for v in fit.views if v.device == device], size))
    text = (
        "Each line starts where a corner of the board was seen and points to where the calibration "
        "puts it. Lines that point the same way over a whole area would betray a lens that the "
        "model does not describe."
    )
    body = html.grid(figures, "pair") + _parameters(rig) + _views(fit) + _correlations(fit)
    advice = [line for device in devices for line in advise(rig, fit, device)]
    heading = "What to photograph next:" if advice else "The boards cover what they should."
    body += f"<p>{heading}</p>" + html.bullets(advice)
    return html.section("calibration", "The calibration", text, body)


def residual_plot(views: Sequence[ViewResiduals], size_px: tuple[int, int]) -> str:
    """Draw one device's residuals as lines over its picture, as SVG."""
    width, height = size_px
    pixels = np.concatenate([view.pixels for view in views])
    residuals = np.concatenate([view.residuals for view in views])
    typical = float(np.sqrt(np.mean(np.sum(residuals**2, axis=1)))) if len(residuals) else 0.0
    scale = _ARROW_SHARE * width / typical if typical > 0 else 0.0
    unit = width / 400
    lines = "".join(
        f'<path d="M{x:.1f} {y:.1f}l{dx * scale:.1f} {dy * scale:.1f}"/>'
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{unit:.2f}"/>'
        for (x, y), (dx, dy) in zip(pixels.tolist(), residuals.tolist(), strict=True)
    )
    drawing = (
        f'<svg class="plot" viewBox="0 0 {width} {height}" role="img" aria-label="residuals">'
        f'<rect width="{width}" height="{height}" fill="#fff" stroke="#999" '
        f'stroke-width="{unit:.2f}"/><g fill="#1d4f91" stroke="#b5402a" '
        f'stroke-width="{unit:.2f}">{lines}</g></svg>'
    )
    caption = (
        f"{views[0].device}: {len(pixels)} corners, RMS {typical:.3f} px; lines are "
        f"{scale:.0f} times as long as the residuals"
    )
    return html.drawing(drawing, caption)


def advise(rig: Calibration, fit: BoardResiduals, device: str) -> list[str]:
    """Say in words which boards would make a device's calibration better."""
    views, size = [v for v in fit.views if v.device == device], _size_px(rig, device)
    if size is None or not views:
        return []
    lines = []
    if len(views) < SUGGESTED_VIEWS:
        lines.append(f"{device}: only {len(views)} boards; record {SUGGESTED_VIEWS} or more")
    empty = empty_cells(np.concatenate([view.pixels for view in views]), size)
    if empty:
        named = ", ".join(f"{_PLACES[row]} {_SIDES[column]}" for row, column in empty[:4])
        more = f" and {len(empty) - 4} other parts" if len(empty) > 4 else ""
        lines.append(f"{device}: no corner lies in the {named}{more}; put the board there")
    tilts = np.array([view.tilt_deg for view in views])
    if tilts.max() < LEAST_TILT or np.ptp(tilts) < LEAST_TILT_RANGE:
        lines.append(
            f"{device}: the boards tilt by {tilts.min():.0f} to {tilts.max():.0f} degrees; tilt "
            "some by 10 and some by 35 degrees, in different directions"
        )
    distances = np.array([view.distance_mm for view in views])
    if distances.max() < LEAST_DISTANCE_RATIO * distances.min():
        lines.append(f"{device}: all boards are equally far; record some nearer, some farther")
    return lines


def empty_cells(pixels: NDArray[np.float64], size_px: tuple[int, int]) -> list[tuple[int, int]]:
    """Return (row, column) of the parts of the picture without any of (N, 2) corners."""
    share = pixels / np.array(size_px, dtype=np.float64)
    column, row = np.clip((share * CELLS).astype(np.int64), 0, CELLS - 1).T
    held = np.zeros((CELLS, CELLS), dtype=bool)
    held[row, column] = True
    return [(int(r), int(c)) for r, c in zip(*np.nonzero(~held), strict=True)]


def strongest(found: Correlation) -> list[tuple[str, str, float]]:
    """Return the pairs of parameters that the views hardly tell apart, the strongest first."""
    first, second = np.nonzero(np.triu(np.abs(found.matrix) > STRONG, k=1))
    pairs = [
        (found.parameters[i], found.parameters[j], float(found.matrix[i, j]))
        for i, j in zip(first, second, strict=True)
    ]
    return sorted(pairs, key=lambda pair: -abs(pair[2]))[:_MOST_CORRELATIONS]


def _size_px(rig: Calibration, device: str) -> tuple[int, int] | None:
    if device in rig.lenses:
        return rig.lenses[device].size_px
    return None if rig.projector is None else rig.projector.lens.size_px


def _parameters(rig: Calibration) -> str:
    lenses = dict(rig.lenses)
    if rig.projector is not None:
        lenses["projector"] = rig.projector.lens
    rows = []
    for name, lens in lenses.items():
        fit = rig.residuals.get(name)
        values = {
            "fx": lens.K[0, 0], "fy": lens.K[1, 1], "cx": lens.K[0, 2], "cy": lens.K[1, 2],
        }  # fmt: skip
        deviation = {} if fit is None else fit.standard_deviation
        shown = [
            f"{value:.2f}" + (f" ± {deviation[key]:.2f}" if key in deviation else "")
            for key, value in values.items()
        ]
        rms = "" if fit is None or fit.rms_px is None else f"{fit.rms_px:.3f}"
        rows.append((name, rig.origin.get(name, ""), *shown, rms))
    headings = ("device", "origin", "fx, px", "fy, px", "cx, px", "cy, px", "RMS, px")
    return html.table(headings, rows)


def _views(fit: BoardResiduals) -> str:
    rows: list[Sequence[object]] = [
        (
            view.view,
            view.device,
            len(view.pixels),
            float(np.sqrt(np.mean(np.sum(view.residuals**2, axis=1)))),
            view.tilt_deg,
            view.distance_mm,
        )
        for view in fit.views
        if len(view.pixels)
    ]
    headings = ("board", "device", "corners", "RMS, px", "tilt, °", "distance, mm")
    body = html.details(f"{len(rows)} board views", html.table(headings, rows))
    if fit.left_out:
        body += "<p>Left out:</p>" + html.table(("board", "why"), fit.left_out)
    return body


def _correlations(fit: BoardResiduals) -> str:
    pairs = [pair for found in fit.correlations for pair in strongest(found)]
    if not pairs:
        return ""
    table = html.table(("parameter", "parameter", "correlation"), pairs)
    return html.details("Parameters that the boards hardly tell apart", table)
