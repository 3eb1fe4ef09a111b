"""The sections of the report, each from the data it shows; None where there is nothing to show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypeGuard, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.engine.manifest import Manifest
from pipeline.formats.boxes import Boxes
from pipeline.formats.bundle import Bundle
from pipeline.formats.height_field import HeightField
from pipeline.formats.range_image import RangeImage
from pipeline.report import html
from pipeline.report.figures import Picture, display, false_colour, fit_width, shaded_relief
from pipeline.report.truth import TruthErrors

MOST_FRAMES = 8
MOST_PHOTOS = 8
_PURPOSES = {
    "scan": "frames of the scan",
    "calibrate": "of boards",
    "pose": "of the camera's places",
    "light": "of the lamp's places",
}
T = TypeVar("T")


def capture(bundle: Bundle) -> str:
    """Show some frames of the scan and some photographs, as the camera saw them."""
    shown = []
    for sequence in bundle.sequences("scan")[:1]:
        for frame in _spread(sequence.frames, MOST_FRAMES):
            label = f"{frame.pattern.type}, {_exposure(frame.exposure_s)}"
            shown.append(_thumbnail(bundle, frame.file, label))
    for photo in _spread(bundle.capture.photos, MOST_PHOTOS):
        turned = "" if photo.turntable_deg is None else f", table at {photo.turntable_deg:g}°"
        shown.append(_thumbnail(bundle, photo.file, f"{photo.camera}, lamp {photo.light}{turned}"))
    counts = [
        (sum(len(sequence.frames) for sequence in bundle.sequences(purpose)), what)
        for purpose, what in _PURPOSES.items()
    ]
    counts.append((len(bundle.capture.photos), "photographs under the lamp"))
    taken = ", ".join(f"{count} {what}" for count, what in counts if count)
    return html.section(
        "capture",
        "The capture",
        f"What the camera recorded: {taken}. Some of the images, brightened for the eye:",
        html.grid(shown, "small"),
    )


def range_map(range_image: RangeImage, texture: NDArray[np.float32] | None) -> str:
    """Show the distance of every camera pixel, and what the camera saw in plain light."""
    z = range_image.points_mm[..., 2]
    scale = false_colour(z, "mm")
    figures = [html.figure(scale.picture, "Third coordinate of the scan's frame", scale=scale)]
    if texture is not None:
        figures.append(html.figure(display(texture), "The projector's light alone"))
    share = float(np.isfinite(z).mean())
    text = (
        f"One measured point per camera pixel, {share:.1%} of them; pale areas were not measured "
        "(in shadow, too dark, or contradictory)."
    )
    return html.section("range", "The range map", text, html.grid(figures, "pair"))


def height(field: HeightField) -> str:
    """Show the height field as plaster under raking light, in false colour, and its uncertainty."""
    rows, columns = field.heights_mm.shape
    bar = html.scale_bar(rows, columns, field.spacing_mm)
    scale = false_colour(field.heights_mm, "mm")
    sigma = false_colour(field.sigma_mm * 1000, "µm")
    figures = [
        html.figure(
            shaded_relief(field.heights_mm, field.spacing_mm),
            "As plaster, lit from the upper left",
            overlay=bar,
        ),
        html.figure(scale.picture, "Height above the canvas plane", scale=scale, overlay=bar),
        html.figure(sigma.picture, "Standard deviation of the height", scale=sigma, overlay=bar),
    ]
    width, tall = field.canvas_size_mm
    filled = float(field.filled.mean())
    text = (
        f"The canvas alone, {width:.0f} x {tall:.0f} mm, {columns} x {rows} samples "
        f"{field.spacing_mm:.3f} mm apart. {filled:.2%} of the samples lie in small holes and were "
        "interpolated."
    )
    return html.section("height", "The height field", text, html.grid(figures, "pair"))


def relief(field: HeightField, boxes: Boxes) -> str:
    """Show which parts stand out enough to be drawn with true parallax, and their boxes."""
    heights = field.heights_mm
    tone = shaded_relief(heights, field.spacing_mm).astype(np.float32)
    raised = np.isfinite(heights) & (np.nan_to_num(heights, nan=-np.inf) > boxes.d0_mm)
    tone[raised] = 0.55 * tone[raised] + 0.45 * np.array([224, 130, 40], np.float32)
    outlines = "".join(
        f'<rect x="{x}" y="{y}" width="{w}" height="{h}"/>'
        for (x, y), (w, h) in zip(boxes.position.tolist(), boxes.size.tolist(), strict=True)
    )
    stroke = max(heights.shape) / 900
    overlay = f'<g fill="none" stroke="#1d4f91" stroke-width="{stroke:.2f}">{outlines}</g>'
    text = (
        f"Above {boxes.d0_mm:.2f} mm (orange) the paint stands out enough to need true parallax; "
        f"{len(boxes)} boxes of {boxes.cell} x {boxes.cell} samples hold it, up to "
        f"{boxes.top_mm:.2f} mm. All else is drawn as a bump-mapped plane."
        if len(boxes)
        else "The relief is so low that a bump-mapped plane shows all of it: there are no boxes."
    )
    picture: Picture = np.rint(tone).astype(np.uint8)
    body = html.figure(picture, "Relief classes and boxes", overlay=overlay)
    return html.section("relief", "The relief classes", text, html.grid([body], "pair"))


def truth(errors: TruthErrors) -> str:
    """Show the errors against a known truth: a table and a map."""
    scale = false_colour(errors.error_mm * 1000, "µm", symmetric=True)
    rows, columns = errors.error_mm.shape
    bar = html.scale_bar(rows, columns, errors.spacing_mm)
    body = html.grid(
        [
            html.table(("figure", "value", "unit"), errors.rows()),
            html.figure(scale.picture, "Measured minus true height", scale=scale, overlay=bar),
        ],
        "pair",
    )
    text = "This capture's truth is known; the result was laid over it by a rigid motion only."
    return html.section("truth", "Errors against the truth", text, body)


def stages(manifests: Mapping[str, Manifest]) -> str:
    """List the stages: outcome, time, memory, figures; what was skipped and why; warnings."""
    rows, skipped, warnings = [], [], []
    for name, manifest in manifests.items():
        outcome = "done" if manifest.outcome == "done" else f"no work: {manifest.reason}"
        figures = ", ".join(
            f"{key.replace('_', ' ')} {html.number(value) if _is_number(value) else value}"
            for key, value in manifest.metrics.items()
        )
        memory = float(manifest.run.get("peak_memory_bytes", 0)) / 2**20
        rows.append((name, outcome, float(manifest.run.get("elapsed_s", 0)), memory, figures))
        skipped += [(name, entry["what"], entry["why"]) for entry in manifest.skipped]
        warnings += [(name, text) for text in manifest.warnings]
    body = html.table(("stage", "outcome", "time, s", "peak memory, MiB", "figures"), rows)
    if skipped:
        body += "<p>Not computed, because the scene did not need it:</p>"
        body += html.table(("stage", "what", "why"), skipped)
    if warnings:
        body += "<p>Warnings:</p>" + html.table(("stage", "warning"), warnings)
    text = "How each stage ended, how long it took, and what it left out."
    return html.section("stages", "The stages", text, body)


def pictures(entries: Sequence[tuple[Path, str]]) -> str:
    """Show the renders, each with its caption."""
    figures = []
    for path, caption in entries:
        image = cv2.imread(str(path), cv2.IMREAD_COLOR)
        if image is not None:
            picture: Picture = np.ascontiguousarray(image[..., ::-1]).astype(np.uint8)
            figures.append(html.figure(picture, caption))
    text = "The asset drawn under several lamps and from several places."
    return html.section("renders", "Seen again", text, html.grid(figures, "pair"))


def _is_number(value: object) -> TypeGuard[float]:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _thumbnail(bundle: Bundle, file: str, caption: str) -> str:
    return html.figure(fit_width(display(bundle.read(file), percentile=99.9), 260), caption)


def _exposure(seconds: float | None) -> str:
    return "exposure not known" if seconds is None else f"{seconds * 1000:.3g} ms"


def _spread(items: Sequence[T], most: int) -> list[T]:
    """Pick at most ``most`` items, evenly spread, the first always among them."""
    step = max(1, -(-len(items) // most))
    return list(items[::step])
