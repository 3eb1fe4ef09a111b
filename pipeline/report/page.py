"""The report of a workspace: one HTML page without outside resources, for people to read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from pipeline.engine.manifest import Manifest
from pipeline.engine.workspace import Workspace
from pipeline.errors import ImpastoError
from pipeline.formats.artifact import Artifact
from pipeline.formats.atomic import write_text_atomically
from pipeline.formats.board_residuals import BOARD_RESIDUALS
from pipeline.formats.boxes import BOXES
from pipeline.formats.bundle import Bundle, open_bundle
from pipeline.formats.calibration import CALIBRATION
from pipeline.formats.height_field import HEIGHT, HeightField
from pipeline.formats.range_image import RANGE, TEXTURE
from pipeline.recipe import RECIPE
from pipeline.report import calibration, html, sections
from pipeline.report.truth import TruthErrors

FOLDERS = {"pack": "asset"}
"""Stages whose folder in the workspace has another name than they."""

T = TypeVar("T")


@dataclass(frozen=True)
class Contents:
    """What a workspace holds, as far as it got; None for what is not there."""

    name: str
    bundle: Bundle | None
    manifests: dict[str, Manifest]
    height_field: HeightField | None


def write_report(
    workspace: Workspace,
    out: Path,
    *,
    pictures: Sequence[tuple[Path, str]] = (),
    truth: TruthErrors | None = None,
) -> None:
    """Write the page, atomically.

    Parameters
    ----------
    pictures
        Renders with their captions.
    truth
        The errors against a known truth, if there is one.

    Raises
    ------
    ImpastoError
        The workspace holds no result of any stage.
    """
    contents = read_contents(workspace)
    if not contents.manifests:
        raise ImpastoError(
            "no stage has run yet", where=str(workspace.folder), fix="impasto run it first"
        )
    parts = list(_parts(workspace, contents, pictures, truth))
    page = html.document(contents.name, html.facts(key_figures(contents, truth)), parts)
    write_text_atomically(out, page)


def read_contents(workspace: Workspace) -> Contents:
    """Load what the report's head and sections share."""
    manifests = {}
    for stage in RECIPE:
        manifest = workspace.manifest(FOLDERS.get(stage.name, stage.name))
        if manifest is not None:
            manifests[stage.name] = manifest
    try:
        bundle = open_bundle(workspace.bundle)
    except ImpastoError:
        bundle = None  # the capture may have been archived elsewhere since
    name = bundle.capture.name if bundle else workspace.folder.name
    field = _load(workspace, manifests, "extract", HEIGHT)
    return Contents(name, bundle, manifests, field)


def key_figures(contents: Contents, truth: TruthErrors | None) -> list[tuple[str, str]]:
    """Return what stands under the title: (name, value)."""
    figures = []
    field = contents.height_field
    if field is not None:
        import numpy as np

        width, tall = field.canvas_size_mm
        low, high = np.nanpercentile(field.heights_mm, (0.5, 99.5))
        figures = [
            ("canvas, mm", f"{width:.0f} × {tall:.0f}"),
            ("sampling, mm", f"{field.spacing_mm:.3f}"),
            ("relief, mm", f"{low:.2f} to {high:.2f}"),
            ("height noise (median), µm", f"{np.nanmedian(field.sigma_mm) * 1000:.0f}"),
        ]
    if truth is not None:
        figures.append(("height error (median), µm", f"{truth.median_mm * 1000:.0f}"))
    elapsed = sum(float(m.run.get("elapsed_s", 0)) for m in contents.manifests.values())
    figures.append(("processing, s", f"{elapsed:.1f}"))
    return figures


def _parts(
    workspace: Workspace,
    contents: Contents,
    pictures: Sequence[tuple[Path, str]],
    truth: TruthErrors | None,
) -> list[tuple[str, str, str]]:
    manifests, field = contents.manifests, contents.height_field
    parts = []
    if pictures:
        parts.append(("renders", "Renders", sections.pictures(pictures)))
    if contents.bundle is not None:
        parts.append(("capture", "Capture", sections.capture(contents.bundle)))
    rig = _load(workspace, manifests, "calibrate", CALIBRATION)
    fit = _load(workspace, manifests, "calibrate", BOARD_RESIDUALS)
    if rig is not None and fit is not None:
        parts.append(("calibration", "Calibration", calibration.calibration(rig, fit)))
    range_image = _load(workspace, manifests, "scan", RANGE)
    if range_image is not None:
        texture = _load(workspace, manifests, "scan", TEXTURE)
        radiance = None if texture is None else texture.radiance
        parts.append(("range", "Range map", sections.range_map(range_image, radiance)))
    if field is not None:
        parts.append(("height", "Height field", sections.height(field)))
        boxes = _load(workspace, manifests, "classify", BOXES)
        if boxes is not None:
            parts.append(("relief", "Relief", sections.relief(field, boxes.boxes)))
    if truth is not None:
        parts.append(("truth", "Truth", sections.truth(truth)))
    parts.append(("stages", "Stages", sections.stages(manifests)))
    return parts


def _load(
    workspace: Workspace, manifests: dict[str, Manifest], stage: str, artifact: Artifact[T]
) -> T | None:
    manifest = manifests.get(stage)
    if manifest is None or manifest.outcome != "done":
        return None
    return artifact.load(workspace.folder)
