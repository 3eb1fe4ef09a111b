"""Stage ``pack``: all that a renderer needs, in the folder ``asset``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from pipeline.engine.stage import Log, Stage, reads, reads_bundle, writes
from pipeline.errors import ImpastoError
from pipeline.formats.asset import ASSET, Asset
from pipeline.formats.boxes import BOXES, Relief
from pipeline.formats.bundle import Bundle
from pipeline.formats.calibration import CALIBRATION, Calibration
from pipeline.formats.height_field import HEIGHT, HeightField
from pipeline.formats.placement_scans import PLACEMENTS, PlacementScan
from pipeline.formats.range_image import TEXTURE, Texture
from pipeline.formats.reflectance_maps import MAPS, ReflectanceMaps

Notes = dict[str, str | bool | float]


@dataclass(frozen=True)
class Inputs:
    """The canvas, its relief, its picture, and its reflectance if that was fitted."""

    bundle: Bundle = reads_bundle()
    calibration: Calibration = reads(CALIBRATION)
    height_field: HeightField = reads(HEIGHT)
    relief: Relief = reads(BOXES)
    texture: Texture = reads(TEXTURE)
    placements: tuple[PlacementScan, ...] = reads(PLACEMENTS)
    maps: ReflectanceMaps | None = reads(MAPS, optional=True)


@dataclass(frozen=True)
class Outputs:
    """The asset."""

    asset: Asset = writes(ASSET)


class Config(BaseModel):
    """What to assume where reflectance is known only up to a factor."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    bright_percentile: float = Field(
        default=99.0, gt=0, le=100, description="Percentile of the albedo that is taken as bright."
    )
    bright_albedo: float = Field(
        default=0.85, gt=0, le=1, description="Albedo assumed for it where none was measured."
    )


def run(inputs: Inputs, config: Config, log: Log) -> Outputs:
    """Put the asset together; source: spec of the painting, 1.6."""
    from pipeline.geometry.height_grid import normals
    from pipeline.pack.reflectance import complete, matte
    from pipeline.pack.white_albedo import (
        blended_albedo,
        fill_from_nearest,
        relative_albedo,
        scale_for,
    )

    field, maps = inputs.height_field, inputs.maps
    canvas = np.isfinite(field.heights_mm)
    calibration = inputs.calibration
    if calibration.projector is None:
        raise ImpastoError("the projector is not calibrated", where="calibration.json: projector")
    camera = calibration.camera(calibration.scan_camera)
    lamp = calibration.projector.centre_mm
    if field.placements:
        relative = blended_albedo(field, _pictures(inputs), camera, lamp)
    else:
        relative = relative_albedo(field, inputs.texture.radiance, camera, lamp)
    relative, unknown = fill_from_nearest(relative, canvas)
    notes: Notes = {
        "colour_calibrated": False,
        "scale_known": calibration.scale_known,
    }
    if maps is None:
        factor = scale_for(relative, canvas, config.bright_percentile, config.bright_albedo)
        reflectance = matte(np.clip(relative * np.float32(factor), 0, 1), canvas)
        source = "white image" if inputs.texture.source == "white" else "fringes"
        why = "no photographs were fitted, so the paint is matte"
        notes |= {"reflectance": source, "reflectance_reason": why, "absolute": False}
        notes |= _assumption(factor, config)
        log.skipped("highlights", why)
        log.metric("texels_without_picture", unknown)
    else:
        _check_shape(maps, canvas.shape)
        reflectance = complete(maps, relative, canvas)
        notes |= {"reflectance": "fitted", "absolute": maps.absolute}
        factor = 1.0
        if not maps.absolute:
            factor = scale_for(
                np.pi * reflectance.diffuse, canvas, config.bright_percentile, config.bright_albedo
            )
            notes |= _assumption(factor, config)
        log.metric("texels_borrowed", reflectance.borrowed)
        notes["texels_borrowed"] = float(reflectance.borrowed)
    lit = np.float32(factor) if maps is not None else np.float32(1)
    normal = normals(field.heights_mm, field.spacing_mm)[..., :2]
    asset = Asset(
        name=inputs.bundle.capture.name,
        spacing_mm=field.spacing_mm,
        heights_mm=np.where(canvas, field.heights_mm, 0).astype(np.float32),
        normals=np.where(canvas[..., None], normal, 0).astype(np.float32),
        mask=canvas,
        diffuse=reflectance.diffuse * lit,
        specular=reflectance.specular * lit,
        lobe=reflectance.lobe,
        boxes=inputs.relief.boxes,
        notes=notes,
    )
    rows, columns = canvas.shape
    log.metric("texels", rows * columns)
    log.metric("reflectance", str(notes["reflectance"]))
    return Outputs(asset)


def _pictures(inputs: Inputs) -> list[NDArray[np.float32]]:
    """Return the pictures of the placements that the canvas was put together from."""
    by_name = {scan.name: scan.texture.radiance for scan in inputs.placements}
    _, *others = inputs.height_field.placements
    missing = [placement.name for placement in others if placement.name not in by_name]
    if missing:
        raise ImpastoError(
            f"it has no picture of the placement {missing[0]!r}",
            where="scan/placements.npz",
            expected="the placements that extract/frame.json names",
            fix="run again from scan: impasto run ... --from scan",
        )
    return [inputs.texture.radiance, *(by_name[placement.name] for placement in others)]


def _assumption(factor: float, config: Config) -> Notes:
    """State what the reflectance was scaled by, and why."""
    return {
        "reflectance_scale": factor,
        "reflectance_assumption": (
            f"percentile {config.bright_percentile:g} of the albedo is taken as "
            f"{config.bright_albedo:g}"
        ),
    }


def _check_shape(maps: ReflectanceMaps, shape: tuple[int, ...]) -> None:
    if maps.count.shape != shape:
        raise ImpastoError(
            f"the maps are {maps.count.shape[1]} x {maps.count.shape[0]}",
            where="fit/diffuse.exr",
            expected=f"{shape[1]} x {shape[0]} as extract/height.exr",
            fix="run again from reflectance: impasto run ... --from reflectance",
        )


STAGE = Stage(
    "pack", version=1, inputs=Inputs, outputs=Outputs, config=Config, run=run, folder="asset"
)
