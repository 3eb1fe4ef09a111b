"""Stage ``reflectance``: what every photograph says of every texel of the canvas."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from pipeline.engine.stage import Log, NoWork, Stage, reads, reads_bundle, writes
from pipeline.formats.bundle import Bundle
from pipeline.formats.calibration import CALIBRATION, Calibration
from pipeline.formats.height_field import HEIGHT, HeightField
from pipeline.formats.reflectance_maps import SAMPLES, ReflectanceSamples

LARGEST_BYTES = 16 * 2**30


@dataclass(frozen=True)
class Inputs:
    """The photographs, the rig and the canvas, and what finds cameras and lamps."""

    bundle: Bundle = reads_bundle("photos", "pose", "light")
    calibration: Calibration = reads(CALIBRATION)
    height_field: HeightField = reads(HEIGHT)


@dataclass(frozen=True)
class Outputs:
    """One sample per photograph and texel."""

    samples: ReflectanceSamples = writes(SAMPLES)


class Config(BaseModel):
    """How photographs are sampled."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    visibility: bool = Field(
        default=True, description="Drop texels in cast shadow or hidden from the camera."
    )
    margin_mm: float = Field(
        default=0.05,
        ge=0,
        le=10,
        description="Length of a ray's start that is not tested, against noise of the height.",
    )
    worst_pose_px: float = Field(
        default=1.0,
        gt=0,
        le=100,
        description="A camera or lamp sequence that fits the canvas worse (RMS) is left out.",
    )
    refine_lenses: bool = Field(
        default=True,
        description="Refine calibrated lenses by what the camera and lamp sequences show.",
    )


def run(inputs: Inputs, config: Config, log: Log) -> Outputs:
    """Sample every photograph that can be placed; source: spec of the painting, 1.4."""
    from pipeline.geometry.height_grid import normals
    from pipeline.geometry.raycast import RayCaster
    from pipeline.reflectance.places import find_places, report
    from pipeline.reflectance.radiance import radiance
    from pipeline.reflectance.sampling import (
        drop_occluded,
        may_be_blocked,
        sample_photo,
        steepest_slope,
    )
    from pipeline.reflectance.stations import stations

    capture = inputs.bundle.capture
    if not capture.photos:
        raise NoWork("the capture has no photographs")
    field = inputs.height_field
    scan = inputs.bundle.sequences("scan")
    scan_deg = scan[0].turntable_deg if scan else None
    calibration, places = find_places(
        inputs.bundle,
        inputs.calibration,
        field,
        scan_deg,
        worst_rms_px=config.worst_pose_px,
        refine_lenses=config.refine_lenses,
        log=log,
    )
    placed, left_out = stations(
        capture.photos, calibration, field.scan_from_canvas, scan_deg, places
    )
    if not placed:
        file, reason = next(iter(left_out.items()))
        raise NoWork(f"none of {len(left_out)} photographs can be placed; {file}: {reason}")
    for file, reason in left_out.items():
        log.warning(f"{file} is left out: {reason}")
    log.metric("photographs", len(placed))
    log.metric("photographs_left_out", len(left_out))
    report(places.cameras, log)

    rows, columns = field.heights_mm.shape
    if len(placed) * rows * columns * 12 > LARGEST_BYTES:
        raise NoWork(
            f"{len(placed)} photographs x {rows} x {columns} texels need more than "
            f"{LARGEST_BYTES / 2**30:.0f} GiB; set a larger extract.spacing_mm"
        )
    points = field.canvas_points()
    surface_normals = normals(field.surface_mm, field.spacing_mm)
    slope = steepest_slope(field.surface_mm, field.spacing_mm)
    caster = RayCaster(field.surface_mm, field.spacing_mm) if config.visibility else None
    brdf = np.empty((len(placed), rows, columns, 3), np.float32)
    occluded = unneeded = 0
    for index, station in enumerate(placed):
        log.progress(index, len(placed), "photographs")
        image = radiance(inputs.bundle, station.photo)
        brdf[index] = sample_photo(image, station, points, surface_normals)
        if caster is None:
            continue
        for target in (station.light_mm, station.camera.centre_mm):
            if may_be_blocked(points, target, slope):
                occluded += drop_occluded(brdf[index], points, target, caster, config.margin_mm)
            else:
                unneeded += 1
    if unneeded:
        log.skipped(
            f"visibility tests of {unneeded} lamp and camera positions",
            "they stand higher over the canvas than its steepest slope",
        )
    seen = np.isfinite(brdf[..., 0]).sum(axis=0)
    log.metric("samples_dropped_as_occluded", occluded)
    log.metric("samples_per_texel", float(seen[np.isfinite(field.heights_mm)].mean()))
    absolute = all(
        station.intensity_known
        and station.photo.exposure_s is not None
        and capture.cameras[station.photo.camera].responsivity_per_s is not None
        for station in placed
    )
    samples = ReflectanceSamples(
        brdf=brdf,
        view_mm=np.array([station.camera.centre_mm for station in placed]),
        light_mm=np.array([station.light_mm for station in placed]),
        names=tuple(station.photo.file for station in placed),
        absolute=absolute,
        cameras=places.cameras,
    )
    return Outputs(samples)


STAGE = Stage("reflectance", version=2, inputs=Inputs, outputs=Outputs, config=Config, run=run)
