"""Cameras and lamp stops placed by what they see of the projector's light on the canvas."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.calibration import Turntable
from pipeline.geometry.camera import Camera, Lens
from pipeline.geometry.rigid import RigidTransform
from pipeline.reflectance.axis_motion import axis_motion, moved_axis
from pipeline.reflectance.pose_refinement import Refined, refine
from pipeline.reflectance.reprojection import Known, State, View
from pipeline.reflectance.single_pose import DoesNotFitError, Recording, place_alone, turn
from pipeline.reflectance.surface_points import Surface, surface_points

Array = NDArray[np.float64]

LEAST_SHARE = 0.5
"""Of the points must agree with the pose."""

LARGEST_SIGMA = 0.01
"""Of a camera's centre, as a share of its distance from the canvas."""

_ROUNDS = 3


@dataclass(frozen=True)
class Placed:
    """A camera placed through the canvas.

    Parameters
    ----------
    pose
        The scan's frame to the camera.
    rms_px, points, share
        RMS over the points that agree, how many those are, and their share of all.
    sigma_mm, sigma_deg
        Largest standard deviations, over all directions, of the camera's centre and of its
        orientation, those of a refined lens included, those of projector and scan not.
    """

    pose: RigidTransform
    rms_px: float
    points: int
    share: float
    sigma_mm: float
    sigma_deg: float


@dataclass(frozen=True)
class Registration:
    """What was placed and what was not, by sequence; the lenses and the axis as refined."""

    placed: dict[str, Placed]
    left_out: dict[str, str]
    lenses: Mapping[str, Lens]
    turntable: Turntable | None


def register(
    recordings: Mapping[str, Recording],
    lenses: Mapping[str, Lens],
    projector: Camera,
    surface: Surface,
    turntable: Turntable | None,
    known: Known,
    *,
    worst_rms_px: float = 1.0,
) -> Registration:
    """Place the cameras of all recordings.

    Parameters
    ----------
    recordings
        By sequence.
    lenses
        By the names that recordings use.
    projector, turntable
        In the scan's frame.
    known
        How well lenses and axis are known; those that are not named are taken as they are.
    worst_rms_px
        A recording that fits worse is left out.

    Source: spec of the painting, 1.4.
    """
    left_out: dict[str, str] = {}
    poses: dict[str, RigidTransform] = {}
    spread: dict[str, float] = {}
    for name, recording in recordings.items():
        try:
            poses[name], spread[name] = place_alone(
                recording, lenses[recording.lens], projector, surface, turntable
            )
        except DoesNotFitError as doubt:
            left_out[name] = str(doubt)
    together: dict[str, Placed] = {}
    while poses:
        fit, table = _together(
            {name: recordings[name] for name in poses},
            poses,
            spread,
            lenses,
            projector,
            surface,
            turntable,
            known,
        )
        together = {name: _placed(fit, index) for index, name in enumerate(poses)}
        doubts = {
            name: reason
            for name, placed in together.items()
            if (reason := _doubt(placed, worst_rms_px, surface)) is not None
        }
        if not doubts:
            return Registration(together, left_out, fit.state.lenses, table)
        # One that does not fit may have drawn the lens along: leave out the worst, ask again.
        worst = max(doubts, key=lambda name: together[name].rms_px)
        left_out[worst] = doubts[worst]
        poses = {name: placed.pose for name, placed in together.items() if name != worst}
    return Registration({}, left_out, lenses, turntable)


def _together(
    recordings: Mapping[str, Recording],
    starts: Mapping[str, RigidTransform],
    spread: Mapping[str, float],
    lenses: Mapping[str, Lens],
    projector: Camera,
    surface: Surface,
    turntable: Turntable | None,
    known: Known,
) -> tuple[Refined, Turntable | None]:
    """Refine all at once, the rays cast anew as the axis moves; poses take the scan's frame."""
    state = State(tuple(starts[name] for name in recordings), lenses)
    turned = any(recording.turned_deg != 0 for recording in recordings.values())
    free = known.axis is not None and turned and turntable is not None
    table, fit = turntable, None
    for _ in range(_ROUNDS if free else 1):
        views = [
            _view(recording, spread[name], projector, surface, table, free)
            for name, recording in recordings.items()
        ]
        fit = refine(views, state, known)
        if table is not None and free:
            table = Turntable(
                *moved_axis(table.axis_point_mm, table.axis_direction, fit.state.axis)
            )
            known = replace(known, axis_moved=known.axis_moved + fit.state.axis)
            state = State(fit.state.poses, lenses)
    assert fit is not None
    return fit, table


def _view(
    recording: Recording,
    variance: float,
    projector: Camera,
    surface: Surface,
    turntable: Turntable | None,
    free_axis: bool,
) -> View:
    canvas = turn(turntable, recording.turned_deg) @ surface.field.scan_from_canvas
    points = surface_points(recording.coordinates, projector, surface, canvas)
    view = View(
        recording.lens,
        canvas.apply(points.points_mm),
        points.pixels + variance * points.edges,
        points.sigma_px,
    )
    if not free_axis or recording.turned_deg == 0 or turntable is None:
        return view
    motion = axis_motion(
        view.points_mm,
        canvas.rotate(points.normals),
        canvas.rotate(points.rays),
        turntable.axis_point_mm,
        turntable.axis_direction,
        recording.turned_deg,
    )
    return replace(view, axis_motion=motion)


def _placed(fit: Refined, index: int) -> Placed:
    """Sum up one view of a fit."""
    pose, block = fit.state.poses[index], slice(6 * index, 6 * index + 6)
    covariance = fit.covariance[block, block]
    # c = -R't; a turn omega of the camera carries t along, so that only the shift moves c.
    residual, agree = fit.residuals_px[index], fit.weights[index] > 0.3
    rms = float(np.sqrt((residual[agree] ** 2).sum(axis=1).mean())) if agree.any() else np.inf
    return Placed(
        pose,
        rms,
        int(agree.sum()),
        float(agree.mean()),
        _largest(covariance[3:, 3:]),
        float(np.degrees(_largest(covariance[:3, :3]))),
    )


def _largest(covariance: Array) -> float:
    return float(np.sqrt(max(np.linalg.eigvalsh(covariance)[-1], 0)))


def _doubt(placed: Placed, worst_rms_px: float, surface: Surface) -> str | None:
    if placed.share < LEAST_SHARE:
        return f"only {placed.share:.0%} of its points agree with one pose"
    if not placed.rms_px <= worst_rms_px:
        return f"its points miss their pixels by {placed.rms_px:.2f} px, allowed {worst_rms_px:g}"
    centre = placed.pose.inverse().translation_mm
    distance = np.linalg.norm(surface.field.scan_from_canvas.inverse().apply(centre))
    if not placed.sigma_mm <= LARGEST_SIGMA * distance:
        return f"it tells the camera's place to no better than {placed.sigma_mm:.1f} mm"
    return None
