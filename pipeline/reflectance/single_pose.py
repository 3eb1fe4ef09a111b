"""One camera placed by what it sees of the projector's light on the canvas."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.calibration import Turntable
from pipeline.geometry.camera import Camera, Lens
from pipeline.geometry.rigid import RigidTransform, rotation_about_axis
from pipeline.reflectance.pnp import FEWEST_POINTS, start_poses
from pipeline.reflectance.pose_refinement import Refined, refine
from pipeline.reflectance.reprojection import State, View
from pipeline.reflectance.surface_points import Surface, SurfacePoints, surface_points
from pipeline.structured_light.coordinates import ProjectorCoordinates
from pipeline.structured_light.footprint import spread_variance

Array = NDArray[np.float64]

AMBIGUOUS = 30.0
"""Two poses whose robust sums differ by less fit alike."""

SAME_POSE_DEG = 0.5

_ROUGH_POINTS = 800


class DoesNotFitError(Exception):
    """A sequence gives no pose; the text says why, for people."""


@dataclass(frozen=True)
class Recording:
    """One decoded sequence; ``lens`` names the camera's, ``turned_deg`` is since the scan."""

    coordinates: ProjectorCoordinates
    lens: str
    turned_deg: float = 0.0


def place_alone(
    recording: Recording,
    lens: Lens,
    projector: Camera,
    surface: Surface,
    turntable: Turntable | None,
) -> tuple[RigidTransform, float]:
    """Return a recording's pose and the variance (px^2) of its camera's point spread."""
    coordinates = recording.coordinates
    if coordinates.x is None or coordinates.y is None:
        raise DoesNotFitError("its patterns code one axis only; both are needed")
    if recording.turned_deg != 0 and turntable is None:
        raise DoesNotFitError(
            "the table was turned and its axis is not known (turntable in capture.json)"
        )
    canvas = turn(turntable, recording.turned_deg) @ surface.field.scan_from_canvas
    points = surface_points(coordinates, projector, surface, canvas)
    if len(points) < FEWEST_POINTS:
        raise DoesNotFitError(
            f"{len(points)} of its pixels show the canvas in the projector's light, "
            f"at least {FEWEST_POINTS} are needed"
        )
    starts = start_poses(points.points_mm, points.pixels, lens)
    view = View(recording.lens, points.points_mm, points.pixels, points.sigma_px)
    best = best_fit(view, lens, [pose for pose in starts if _in_front(pose, points.points_mm)])
    variance = _point_spread(best, points)
    return best.state.poses[0] @ canvas.inverse(), variance


def best_fit(view: View, lens: Lens, starts: list[RigidTransform]) -> Refined:
    """Refine every start and return the best, if there is one and no other is as good."""
    if not starts:
        raise DoesNotFitError("no pose agrees with half of its pixels")
    some = slice(None, None, max(1, len(view.pixels) // _ROUGH_POINTS))
    rough = View(view.lens, view.points_mm[some], view.pixels[some], view.sigma_px[some])
    states: list[State] = []
    for start in starts:
        state = refine([rough], State((start,), {view.lens: lens})).state
        if all(_angle_deg(state.poses[0], other.poses[0]) > SAME_POSE_DEG for other in states):
            states.append(state)
    fits = [refine([view], state) for state in states]
    widths = min(fit.widths for fit in fits)
    if len(fits) > 1:  # sums of robust losses compare only at the same width
        fits = [refine([view], fit.state, widths=widths) for fit in fits]
    fits = [fit for fit in fits if _in_front(fit.state.poses[0], view.points_mm)]
    if not fits:
        raise DoesNotFitError("the pose that fits looks at the canvas's back")
    fits.sort(key=lambda fit: fit.cost)
    for other in fits[1:]:
        if (
            other.cost - fits[0].cost < AMBIGUOUS
            and _angle_deg(other.state.poses[0], fits[0].state.poses[0]) > SAME_POSE_DEG
        ):
            raise DoesNotFitError("two poses fit it alike, for it shows too little relief or depth")
    return fits[0]


def _in_front(pose: RigidTransform, points_mm: Array) -> bool:
    """Say whether a camera sees the canvas, and its front; ``pose`` takes the canvas to it."""
    depth = pose.apply(points_mm)[:, 2]
    return bool(np.median(depth) > 0 and pose.inverse().translation_mm[2] > 0)


def _point_spread(fit: Refined, points: SurfacePoints) -> float:
    """Find by how much albedo edges shift the pixels (see structured_light.footprint)."""
    variance = spread_variance(
        fit.residuals_px[0].ravel().astype(np.float32), points.edges.ravel().astype(np.float32)
    )
    return variance or 0.0


def turn(turntable: Turntable | None, angle_deg: float) -> RigidTransform:
    """Return the motion of the table since the scan."""
    if turntable is None or angle_deg == 0:
        return RigidTransform()
    return rotation_about_axis(turntable.axis_point_mm, turntable.axis_direction, angle_deg)


def _angle_deg(first: RigidTransform, second: RigidTransform) -> float:
    cosine = (np.trace(first.rotation @ second.rotation.T) - 1) / 2
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
