"""Stage ``fit``: one Lafortune lobe per texel from the samples of all photographs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydantic import BaseModel, ConfigDict

from pipeline.engine.stage import Log, Stage, reads, writes
from pipeline.formats.height_field import HEIGHT, HeightField
from pipeline.formats.reflectance_maps import MAPS, SAMPLES, ReflectanceMaps, ReflectanceSamples

ROWS_AT_ONCE = 64
"""Rows fitted between two reports of progress; it also bounds the memory that is touched."""


@dataclass(frozen=True)
class Inputs:
    """The samples and the canvas they lie on."""

    samples: ReflectanceSamples = reads(SAMPLES)
    height_field: HeightField = reads(HEIGHT)


@dataclass(frozen=True)
class Outputs:
    """The fitted maps."""

    maps: ReflectanceMaps = writes(MAPS)


class Config(BaseModel):
    """The fit has nothing to set yet."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def run(inputs: Inputs, config: Config, log: Log) -> Outputs:  # noqa: ARG001 - every stage's form
    """Fit every texel that was seen; texels are independent of one another."""
    from pipeline.fit.lobe import fit_lobes
    from pipeline.geometry.height_grid import normals

    field, samples = inputs.height_field, inputs.samples
    points = field.canvas_points()
    surface_normals = normals(field.surface_mm, field.spacing_mm)
    rows, columns = field.heights_mm.shape
    parameters = np.empty((rows, columns, 9), np.float32)
    residual = np.empty((rows, columns), np.float32)
    count = np.empty((rows, columns), np.int32)
    observed = np.empty((rows, columns), np.bool_)
    for top in range(0, rows, ROWS_AT_ONCE):
        log.progress(top, rows, "rows")
        part = slice(top, top + ROWS_AT_ONCE)
        parameters[part], residual[part], count[part], observed[part] = fit_lobes(
            np.ascontiguousarray(samples.brdf[:, part]),
            points[part],
            surface_normals[part],
            samples.view_mm,
            samples.light_mm,
        )
    maps = ReflectanceMaps(
        diffuse=parameters[..., :3],
        specular=parameters[..., 3:6],
        lobe=parameters[..., 6:9],
        residual=residual,
        count=count,
        lobe_observed=observed,
        absolute=samples.absolute,
    )
    canvas, seen = np.isfinite(field.heights_mm), count > 0
    glossy = seen & (maps.specular.max(axis=2) > 0)
    log.metric("texels_fitted", int(np.count_nonzero(seen)))
    log.metric("share_glossy", _share(glossy, seen))
    log.metric("share_highlight_observed", _share(observed, seen))
    if seen.any():
        log.metric("median_residual_per_sr", float(np.median(residual[seen])))
    unseen = int(np.count_nonzero(canvas & ~seen))
    if unseen:
        log.warning(f"{unseen} texels of the canvas were seen in no photograph")
    return Outputs(maps)


def _share(part: np.ndarray, whole: np.ndarray) -> float:
    return int(np.count_nonzero(part & whole)) / max(1, int(np.count_nonzero(whole)))


STAGE = Stage("fit", version=1, inputs=Inputs, outputs=Outputs, config=Config, run=run)
