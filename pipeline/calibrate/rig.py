"""The rig put together: lenses, poses, projector, table and lamps, each given or calibrated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pipeline.calibrate.bundle_adjustment import Adjusted, BoardView, Start, adjust
from pipeline.calibrate.given import (
    given_lenses,
    given_projector,
    is_complete,
    lens_of,
    pose_of,
    scan_camera_of,
    to_calibrate,
)
from pipeline.calibrate.initial import FEWEST_VIEWS, board_pose, start_lens, start_projector
from pipeline.calibrate.residuals import PROJECTOR, view_residuals
from pipeline.calibrate.turntable import turntable_axis
from pipeline.calibrate.views import Views, find_views
from pipeline.engine.stage import Log
from pipeline.errors import ImpastoError
from pipeline.formats.board_residuals import BoardResiduals, Correlation, ViewResiduals
from pipeline.formats.bundle import Bundle
from pipeline.formats.calibration import Calibration, Light, Residuals, Turntable
from pipeline.formats.capture import Capture
from pipeline.geometry.camera import Camera, Lens
from pipeline.geometry.rigid import RigidTransform

_SIGNIFICANT = 3.0


def calibrate_rig(
    bundle: Bundle, worst_view: float, log: Log
) -> tuple[Calibration, BoardResiduals]:
    """Take what the bundle gives and calibrate the rest; tell how the boards fit.

    Raises
    ------
    ImpastoError
        Something that the scan needs is neither given nor to be found, naming the key.
    """
    capture = bundle.capture
    scan_camera = scan_camera_of(capture)
    wanted = to_calibrate(capture, scan_camera)
    sequences = [s for s in capture.sequences if s.purpose == "calibrate" and s.camera in wanted]
    views = Views()
    if sequences:
        needs_projector = capture.projector is not None and not is_complete(capture.projector)
        views = find_views(
            bundle,
            sequences,
            capture.projector.camera if needs_projector and capture.projector else None,
            lambda done, total: log.progress(done, total, "boards"),
        )
    elif capture.sequences:
        log.skipped("calibration from boards", "the bundle gives the calibration")
    for name, reason in views.left_out.items():
        log.warning(f"{name} is left out: {reason}")

    lenses = given_lenses(capture)
    residuals: dict[str, Residuals] = {}
    origin = dict.fromkeys(lenses, "given")
    projector: Camera | None = given_projector(capture.projector)
    if projector is not None:
        origin[PROJECTOR] = "given"
    boards: dict[str, RigidTransform] = {}
    seen: list[ViewResiduals] = []
    correlations: list[Correlation] = []
    left_out = dict(views.left_out)
    for name in wanted:
        own = views.by_camera.get(name, [])
        with_projector = capture.projector is not None and name == capture.projector.camera
        if name in lenses and not (with_projector and projector is None):
            continue
        adjusted, kept = _calibrate(
            capture, name, own, lenses.get(name), with_projector, worst_view, log
        )
        boards |= dict(zip((view.name for view in kept), adjusted.boards, strict=True))
        seen += view_residuals(name, kept, adjusted)
        if adjusted.correlation is not None and adjusted.parameters:
            correlations.append(Correlation(adjusted.parameters, adjusted.correlation))
        gone = {view.name for view in own} - {view.name for view in kept}
        left_out |= dict.fromkeys(sorted(gone), "its corners disagree with the other views")
        if name not in lenses:
            lenses[name], origin[name] = adjusted.camera, "calibrated"
            residuals[name] = Residuals(
                adjusted.camera_rms_px,
                sum(len(view.points) for view in kept),
                adjusted.camera_deviation,
            )
        if with_projector and projector is None:
            projector, origin[PROJECTOR] = adjusted.projector, "calibrated"
            residuals[PROJECTOR] = Residuals(
                adjusted.projector_rms_px,
                sum(_decoded(view) for view in kept),
                adjusted.projector_deviation,
            )
    for name, camera in capture.cameras.items():
        if camera.lens_of is not None and camera.lens_of in lenses:
            lenses[name], origin[name] = lenses[camera.lens_of], origin[camera.lens_of]
    for name in sorted(capture.cameras.keys() - lenses.keys()):
        log.skipped(f"camera {name}", "no lens is given for it and no board was recorded with it")
    calibration = _assemble(capture, scan_camera, lenses, residuals, origin, projector, boards)
    fit = BoardResiduals(tuple(seen), tuple(correlations), tuple(left_out.items()))
    return calibration, fit


def _calibrate(
    capture: Capture,
    name: str,
    views: list[BoardView],
    lens: Lens | None,
    with_projector: bool,
    worst_view: float,
    log: Log,
) -> tuple[Adjusted, list[BoardView]]:
    """Adjust one camera, with the projector if it is its own, leaving out views that disagree."""
    start_from = lens or start_lens(
        [view.points for view in views],
        [view.camera_px for view in views],
        capture.cameras[name].size_px,
        f"camera {name}",
    )
    while True:
        boards = tuple(board_pose(start_from, view.points, view.camera_px) for view in views)
        projector, entry = None, capture.projector
        if with_projector and entry is not None:
            projector = start_projector(views, boards, lens_of(entry), entry.size_px)
            pose = pose_of(entry)
            projector = projector if pose is None else Camera(projector.lens, pose)
        start = Start(
            start_from,
            projector,
            boards,
            camera_given=lens is not None,
            projector_given=entry is not None and entry.K is not None,
            projector_pose_given=entry is not None and entry.R is not None,
        )
        adjusted = _with_third_term(views, start, adjust(views, start))
        typical = float(np.median(list(adjusted.view_rms_px.values())))
        worst = max(views, key=lambda view: adjusted.view_rms_px[view.name])
        if adjusted.view_rms_px[worst.name] <= worst_view * typical or len(views) <= FEWEST_VIEWS:
            return adjusted, views
        log.warning(
            f"{worst.name} is left out: its corners disagree with the other views "
            f"({adjusted.view_rms_px[worst.name]:.2f} px, median {typical:.2f} px)"
        )
        views = [view for view in views if view is not worst]


def _with_third_term(views: list[BoardView], start: Start, adjusted: Adjusted) -> Adjusted:
    """Free the third radial term of a lens where the views show that it has one."""
    if start.camera_given:
        return adjusted
    free = replace(
        start,
        camera=adjusted.camera,
        projector=adjusted.projector,
        boards=adjusted.boards,
        free_k3=(True, False),
    )
    try:
        richer = adjust(views, free)
    except ImpastoError:
        return adjusted  # the views cannot tell it
    k3 = richer.camera.distortion[4]
    return richer if abs(k3) > _SIGNIFICANT * richer.camera_deviation["k3"] else adjusted


def _decoded(view: BoardView) -> int:
    return 0 if view.projector_px is None else int(np.isfinite(view.projector_px).all(axis=1).sum())


def _assemble(
    capture: Capture,
    scan_camera: str,
    lenses: dict[str, Lens],
    residuals: dict[str, Residuals],
    origin: dict[str, str],
    projector: Camera | None,
    boards: dict[str, RigidTransform],
) -> Calibration:
    """Put all devices into the scan's frame: the rig's where it is defined, else the camera's."""
    in_rig = pose_of(capture.cameras[scan_camera]) is not None
    if in_rig:
        poses = {n: p for n in lenses if (p := pose_of(capture.cameras[n])) is not None}
    else:
        poses = {scan_camera: RigidTransform()}
    if projector is not None and capture.projector is not None:
        base = poses.get(capture.projector.camera)
        if base is None:
            raise ImpastoError(
                f"the projector is placed from {capture.projector.camera}, a camera without a pose",
                where=f"capture.json: cameras.{capture.projector.camera}.R",
                expected="its R and t_mm, or the scan's own camera",
            )
        projector = Camera(projector.lens, projector.pose @ base)
    lights = {
        name: Light(
            np.array(light.position_mm), light.intensity or 1.0, light.intensity is not None
        )
        for name, light in capture.lights.items()
        if in_rig and light.position_mm is not None
    }
    return Calibration(
        frame="rig" if in_rig else "camera",
        scan_camera=scan_camera,
        lenses=dict(sorted(lenses.items())),
        poses=dict(sorted(poses.items())),
        projector=projector,
        turntable=_turntable(capture, scan_camera, poses, boards, in_rig),
        lights=lights,
        residuals=residuals,
        origin=dict(sorted(origin.items())),
        scale_known=all(board.scale_known for board in capture.boards.values()),
    )


def _turntable(
    capture: Capture,
    scan_camera: str,
    poses: dict[str, RigidTransform],
    boards: dict[str, RigidTransform],
    in_rig: bool,
) -> Turntable | None:
    """Return the table's axis as given, else from the boards that turned with it."""
    if capture.turntable is not None and in_rig:
        direction = np.array(capture.turntable.axis_direction)
        return Turntable(
            np.array(capture.turntable.axis_point_mm), direction / np.linalg.norm(direction)
        )
    to_frame = poses[scan_camera].inverse() if scan_camera in poses else RigidTransform()
    return turntable_axis(
        {
            sequence.turntable_deg: to_frame @ boards[sequence.name]
            for sequence in capture.sequences
            if sequence.on_turntable
            and sequence.camera == scan_camera
            and sequence.turntable_deg is not None
            and sequence.name in boards
        }
    )
