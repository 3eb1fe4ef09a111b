"""Which sequences have to place a camera or a lamp, and what they give the photographs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from pipeline.engine.stage import Log
from pipeline.errors import ImpastoError
from pipeline.formats.bundle import Bundle
from pipeline.formats.calibration import Calibration, Light
from pipeline.formats.capture import Capture, Photo, Sequence
from pipeline.formats.height_field import HeightField
from pipeline.formats.reflectance_maps import FoundCamera
from pipeline.geometry.camera import Camera
from pipeline.geometry.rigid import RigidTransform
from pipeline.reflectance.axis_motion import AXIS_SIGMA
from pipeline.reflectance.projection import LENS
from pipeline.reflectance.registration import Registration, register
from pipeline.reflectance.reprojection import Known
from pipeline.reflectance.single_pose import Recording
from pipeline.reflectance.surface_points import Surface
from pipeline.structured_light.decode import decode_sequence

_DOUBTFUL = 4.0


@dataclass(frozen=True)
class Places:
    """Where cameras and lamps stood, as far as sequences told.

    Parameters
    ----------
    poses
        By the file of the photograph: the scan's frame to the camera.
    reasons
        By the file of the photograph: why its camera's pose was not found.
    lamp_reasons
        By lamp: why its position was not found.
    cameras
        All that were found, canvas coordinates with the table as in the scan.
    """

    poses: Mapping[str, RigidTransform] = field(default_factory=dict)
    reasons: Mapping[str, str] = field(default_factory=dict)
    lamp_reasons: Mapping[str, str] = field(default_factory=dict)
    cameras: tuple[FoundCamera, ...] = ()


def pose_sequence(photo: Photo, capture: Capture) -> str:
    """Name the sequence that finds a photograph's pose: its own, else the only one that can.

    Empty if there is none, or none in particular.
    """
    if photo.pose is not None:
        return photo.pose
    own = [s for s in capture.sequences if s.purpose == "pose" and s.camera == photo.camera]
    if len(own) > 1:
        own = [s for s in own if s.turntable_deg == photo.turntable_deg]
    return own[0].name if len(own) == 1 else ""


def needed(capture: Capture, calibration: Calibration, log: Log) -> list[Sequence]:
    """Choose the sequences that place what a photograph needs and the bundle does not give."""
    cameras = {
        pose_sequence(photo, capture)
        for photo in capture.photos
        if photo.camera not in calibration.poses
    }
    lamps = {photo.light for photo in capture.photos} - calibration.lights.keys()
    chosen = []
    for sequence in capture.sequences:
        what = sequence.name
        if sequence.purpose == "pose" and what not in cameras:
            given = sequence.camera in calibration.poses
            log.skipped(what, "the pose is given" if given else "no photograph needs it")
        elif sequence.purpose == "light" and sequence.light not in lamps:
            given = sequence.light in calibration.lights
            log.skipped(what, "the position is given" if given else "no photograph needs it")
        elif sequence.purpose in ("pose", "light"):
            chosen.append(sequence)
    return chosen


def find_places(
    bundle: Bundle,
    calibration: Calibration,
    height_field: HeightField,
    scan_turntable_deg: float | None,
    *,
    worst_rms_px: float,
    refine_lenses: bool,
    log: Log,
) -> tuple[Calibration, Places]:
    """Place the cameras and lamps that have to be found.

    Returns
    -------
    The calibration with the lamps that were found, and with lenses and axis as refined; and the
    places.
    """
    capture = bundle.capture
    chosen = needed(capture, calibration, log)
    left_out: dict[str, str] = {}
    found = Registration({}, {}, calibration.lenses, calibration.turntable)
    recordings: dict[str, Recording] = {}
    if calibration.projector is None:
        left_out = {sequence.name: "the projector is not calibrated" for sequence in chosen}
    elif chosen:
        for index, sequence in enumerate(chosen):
            log.progress(index, len(chosen), "sequences of cameras and lamps")
            if sequence.camera not in calibration.lenses:
                left_out[sequence.name] = f"the lens of camera {sequence.camera} is not calibrated"
                continue
            turned = 0.0
            if sequence.turntable_deg is not None:
                turned = sequence.turntable_deg - (scan_turntable_deg or 0.0)
            try:
                coordinates = decode_sequence(bundle, sequence)
            except ImpastoError as error:
                left_out[sequence.name] = error.problem
                continue
            recordings[sequence.name] = Recording(
                coordinates, _body(capture, sequence.camera), turned
            )
        found = register(
            recordings,
            calibration.lenses,
            calibration.projector,
            Surface.of(height_field),
            calibration.turntable,
            _known(capture, calibration, refine_lenses),
            worst_rms_px=worst_rms_px,
        )
        left_out |= found.left_out
    for name, reason in left_out.items():
        log.warning(f"{name} is left out: {reason}")
    _warn_of_lenses(found, calibration, log)
    by_photo = {
        photo.file: pose_sequence(photo, capture)
        for photo in capture.photos
        if photo.camera not in calibration.poses
    }
    return _calibration(capture, calibration, chosen, found), Places(
        poses={
            file: found.placed[name].pose for file, name in by_photo.items() if name in found.placed
        },
        reasons={
            file: f"its pose sequence {name} is left out"
            for file, name in by_photo.items()
            if name in left_out
        },
        lamp_reasons={
            sequence.light: f"its sequence {sequence.name} is left out"
            for sequence in chosen
            if sequence.light is not None and sequence.name in left_out
        },
        cameras=tuple(
            _found_camera(sequence, capture, found, height_field)
            for sequence in chosen
            if sequence.name in found.placed
        ),
    )


def _known(capture: Capture, calibration: Calibration, refine_lenses: bool) -> Known:
    """Return what may be refined: what was calibrated, not what was given."""
    lenses = {}
    for name, residuals in calibration.residuals.items():
        deviation = residuals.standard_deviation
        known = np.array([deviation.get(parameter, 0.0) for parameter in LENS])
        if refine_lenses and name in calibration.lenses and (known > 0).all():
            lenses[name] = known
    axis_given = capture.turntable is not None and calibration.frame == "rig"
    return Known(lenses, None if axis_given else AXIS_SIGMA)


def _calibration(
    capture: Capture, calibration: Calibration, chosen: list[Sequence], found: Registration
) -> Calibration:
    lights = dict(calibration.lights)
    surest: dict[str, float] = {}
    for sequence in chosen:
        placed, light = found.placed.get(sequence.name), sequence.light
        if sequence.purpose != "light" or placed is None or light is None:
            continue
        if placed.sigma_mm < surest.get(light, np.inf):
            surest[light] = placed.sigma_mm
            given = capture.lights.get(light)
            intensity = None if given is None else given.intensity
            lights[light] = Light(
                placed.pose.inverse().translation_mm, intensity or 1.0, intensity is not None
            )
    lenses = {name: found.lenses[_body(capture, name)] for name in calibration.lenses}
    return replace(calibration, lights=lights, lenses=lenses, turntable=found.turntable)


def _found_camera(
    sequence: Sequence, capture: Capture, found: Registration, height_field: HeightField
) -> FoundCamera:
    placed = found.placed[sequence.name]
    return FoundCamera(
        sequence.name,
        sequence.camera,
        sequence.light,
        Camera(
            found.lenses[_body(capture, sequence.camera)],
            placed.pose @ height_field.scan_from_canvas,
        ),
        placed.rms_px,
        placed.points,
        placed.share,
        placed.sigma_mm,
        placed.sigma_deg,
    )


def _warn_of_lenses(found: Registration, calibration: Calibration, log: Log) -> None:
    """Say where the canvas and the boards contradict each other."""
    for name, lens in found.lenses.items():
        known = calibration.residuals.get(name)
        deviation = {} if known is None else known.standard_deviation
        change = np.abs(lens.K - calibration.lenses[name].K)
        for parameter, size in (("fx", change[0, 0]), ("cx", change[0, 2]), ("cy", change[1, 2])):
            if size > _DOUBTFUL * deviation.get(parameter, np.inf):
                log.warning(
                    f"{parameter} of camera {name} is {size:.2f} px from its calibration as the "
                    f"canvas shows it, {size / deviation[parameter]:.1f} standard deviations: was "
                    "the lens refocused, or the canvas moved?"
                )


def report(cameras: tuple[FoundCamera, ...], log: Log) -> None:
    """Record how the cameras that were found fit."""
    if not cameras:
        return
    log.metric("registration_error_px", max(found.rms_px for found in cameras))
    for found in cameras:
        log.metric(f"registration_error_{found.sequence}_px", found.rms_px)
        log.metric(f"registration_points_{found.sequence}", found.points)
        log.metric(f"registration_sigma_{found.sequence}_mm", found.sigma_mm)


def _body(capture: Capture, camera: str) -> str:
    """Name the camera whose lens this one has."""
    return capture.cameras[camera].lens_of or camera
