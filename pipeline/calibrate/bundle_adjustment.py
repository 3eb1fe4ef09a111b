"""Camera, projector and boards adjusted together, with standard deviations.

All parameters that are not given are free at once (Triggs et al. 2000); the loss is Huber's, in
units of the residuals' own spread, which is estimated for each device.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from pipeline.calibrate.covariance import (
    ViewBlock,
    correlation,
    jackknife_variance,
    joint_covariance,
)
from pipeline.calibrate.parameters import (
    LENS_PARAMETERS,
    POSE_PARAMETERS,
    lens_vector,
    pose_vector,
    vector_lens,
    vector_pose,
)
from pipeline.errors import ImpastoError
from pipeline.geometry.camera import Camera, Lens
from pipeline.geometry.rigid import RigidTransform

Array = NDArray[np.float64]

WORST_CONDITION = 1e5
"""Of the scaled Jacobian: beyond it the views do not determine all parameters."""

_HUBER = 2.0
_SMALLEST_SPREAD_PX = 1e-4


@dataclass(frozen=True)
class BoardView:
    """One board in one pose: (N, 3) board points (mm), (N, 2) pixels; NaN where not decoded."""

    name: str
    points: Array
    camera_px: Array
    projector_px: Array | None = None


@dataclass(frozen=True)
class Start:
    """Where the adjustment starts; ``given`` lenses and poses are held."""

    camera: Lens
    projector: Camera | None
    boards: tuple[RigidTransform, ...]
    camera_given: bool = False
    projector_given: bool = False
    projector_pose_given: bool = False
    free_k3: tuple[bool, bool] = (False, False)


@dataclass(frozen=True)
class Adjusted:
    """The result; standard deviations by parameter name, RMS in px by device and by view.

    ``correlation`` is that of ``parameters``, ``camera.fx`` to ``projector.t_z``, as far as they
    were free; ``residuals_px`` are each view's, (N, 2) in the camera, (M, 2) in the projector.
    """

    camera: Lens
    projector: Camera | None
    boards: tuple[RigidTransform, ...]
    camera_rms_px: float
    projector_rms_px: float | None
    camera_deviation: dict[str, float]
    projector_deviation: dict[str, float]
    view_rms_px: dict[str, float]
    condition: float
    parameters: tuple[str, ...] = ()
    correlation: Array | None = None
    residuals_px: tuple[tuple[Array, Array], ...] = ()


def adjust(views: Sequence[BoardView], start: Start) -> Adjusted:
    """Find the parameters that explain all corners best.

    Raises
    ------
    ImpastoError
        The views do not determine the parameters (too few, or all boards parallel).
    """
    problem = _Problem(views, start)
    vector = problem.pack()
    spread = np.ones(2)
    for _ in range(4):
        fit = least_squares(
            problem.residuals,
            vector,
            jac=problem.jacobian,
            args=(spread,),
            loss="huber",
            f_scale=_HUBER,
            x_scale="jac",
            max_nfev=100,
        )
        vector = fit.x
        spread = problem.spread(vector)
    return problem.result(vector, problem.jacobian(vector, spread), spread)


class _Problem:
    """The unknowns in one vector: camera lens, projector lens, projector pose, board poses."""

    def __init__(self, views: Sequence[BoardView], start: Start) -> None:
        self.views, self.start = views, start
        self.free_camera = _free(start.camera_given, start.free_k3[0])
        self.free_projector = _free(start.projector_given, start.free_k3[1])
        if start.projector is None:
            self.free_projector = np.zeros(9, dtype=bool)
        free_pose = start.projector is not None and not start.projector_pose_given
        self.sizes = [
            int(self.free_camera.sum()),
            int(self.free_projector.sum()),
            6 if free_pose else 0,
            *[6] * len(views),
        ]
        self.ends = np.cumsum(self.sizes)
        self.decoded = [
            None
            if view.projector_px is None or start.projector is None
            else np.isfinite(view.projector_px).all(axis=1)
            for view in views
        ]

    def pack(self) -> Array:
        parts = [lens_vector(self.start.camera)[self.free_camera]]
        if self.start.projector is not None:
            parts.append(lens_vector(self.start.projector.lens)[self.free_projector])
            if self.sizes[2]:
                parts.append(pose_vector(self.start.projector.pose))
        return np.concatenate([*parts, *(pose_vector(board) for board in self.start.boards)])

    def unpack(self, vector: Array) -> tuple[Lens, Camera | None, list[RigidTransform]]:
        camera_part, lens_part, pose_part, *board_parts = np.split(vector, self.ends[:-1])
        camera = _with(self.start.camera, self.free_camera, camera_part)
        projector = self.start.projector
        if projector is not None:
            lens = _with(projector.lens, self.free_projector, lens_part)
            pose = vector_pose(pose_part) if self.sizes[2] else projector.pose
            projector = Camera(lens, pose)
        return camera, projector, [vector_pose(part) for part in board_parts]

    def view_residuals(
        self, index: int, camera: Lens, projector: Camera | None, board: RigidTransform
    ) -> tuple[Array, Array]:
        """Return the camera's and the projector's residuals of one view, (N, 2) and (M, 2) px."""
        view, decoded = self.views[index], self.decoded[index]
        placed = board.apply(view.points)
        seen = camera.project(placed) - view.camera_px
        if decoded is None or projector is None or view.projector_px is None:
            return seen, np.zeros((0, 2))
        return seen, projector.project(placed[decoded]) - view.projector_px[decoded]

    def residuals(self, vector: Array, spread: Array) -> Array:
        camera, projector, boards = self.unpack(vector)
        parts = []
        for index, board in enumerate(boards):
            seen, lit = self.view_residuals(index, camera, projector, board)
            parts += [seen.ravel() / spread[0], lit.ravel() / spread[1]]
        return np.concatenate(parts)

    def jacobian(self, vector: Array, spread: Array) -> Array:
        """Differentiate numerically, each board's columns on its own view alone."""
        shared = int(self.ends[2])
        base = self.residuals(vector, spread)
        lengths = [
            2 * (len(view.points) + (0 if decoded is None else int(decoded.sum())))
            for view, decoded in zip(self.views, self.decoded, strict=True)
        ]
        firsts = np.concatenate([[0], np.cumsum(lengths)])
        jacobian = np.zeros((len(base), len(vector)))
        steps = 1e-7 * np.maximum(np.abs(vector), 1e-2)
        for column in range(shared):
            moved = vector.copy()
            moved[column] += steps[column]
            jacobian[:, column] = (self.residuals(moved, spread) - base) / steps[column]
        camera, projector, _ = self.unpack(vector)
        for index in range(len(self.views)):
            rows = slice(firsts[index], firsts[index + 1])
            first = shared + 6 * index
            for column in range(first, first + 6):
                moved = vector[first : first + 6].copy()
                moved[column - first] += steps[column]
                seen, lit = self.view_residuals(index, camera, projector, vector_pose(moved))
                values = np.concatenate([seen.ravel() / spread[0], lit.ravel() / spread[1]])
                jacobian[rows, column] = (values - base[rows]) / steps[column]
        return jacobian

    def spread(self, vector: Array) -> Array:
        """Return the robust standard deviations of the camera's and the projector's residuals."""
        camera, projector, boards = self.unpack(vector)
        pairs = [self.view_residuals(i, camera, projector, b) for i, b in enumerate(boards)]
        result = np.ones(2)
        for device in (0, 1):
            values = np.concatenate([pair[device].ravel() for pair in pairs])
            if values.size:
                deviation = 1.4826 * float(np.median(np.abs(values)))
                result[device] = max(deviation, _SMALLEST_SPREAD_PX)
        return result

    def view_blocks(self, vector: Array, jacobian: Array, spread: Array) -> list[ViewBlock]:
        """Cut the Jacobian into each view's rows: shared columns, its own, its residuals."""
        shared, first = int(self.ends[2]), 0
        residual = np.clip(self.residuals(vector, spread), -_HUBER, _HUBER)
        blocks = []
        for index, (view, decoded) in enumerate(zip(self.views, self.decoded, strict=True)):
            length = 2 * (len(view.points) + (0 if decoded is None else int(decoded.sum())))
            rows = slice(first, first + length)
            own = slice(shared + 6 * index, shared + 6 * index + 6)
            blocks.append((jacobian[rows, :shared], jacobian[rows, own], residual[rows]))
            first += length
        return blocks

    def result(self, vector: Array, jacobian: Array, spread: Array) -> Adjusted:
        covariance, condition = joint_covariance(jacobian)
        if not condition < WORST_CONDITION:
            raise ImpastoError(
                f"{len(self.views)} board views do not determine the calibration "
                f"(condition {condition:.1e})",
                expected="boards tilted by 20 to 40 degrees in different directions",
                fix="record five or more views with the board tilted each time",
            )
        variance, shared = np.diag(covariance).copy(), int(self.ends[2])
        apart = jackknife_variance(self.view_blocks(vector, jacobian, spread))
        variance[:shared] = np.maximum(variance[:shared], apart)
        deviation = np.split(np.sqrt(variance), self.ends[:-1])
        camera, projector, boards = self.unpack(vector)
        pairs = [self.view_residuals(i, camera, projector, b) for i, b in enumerate(boards)]
        lit = np.concatenate([pair[1] for pair in pairs])
        projector_deviation = _named(LENS_PARAMETERS, self.free_projector, deviation[1])
        if self.sizes[2]:
            projector_deviation |= dict(zip(POSE_PARAMETERS, deviation[2].tolist(), strict=True))
        return Adjusted(
            camera=camera,
            projector=projector,
            boards=tuple(boards),
            camera_rms_px=_rms(np.concatenate([pair[0] for pair in pairs])),
            projector_rms_px=_rms(lit) if len(lit) else None,
            camera_deviation=_named(LENS_PARAMETERS, self.free_camera, deviation[0]),
            projector_deviation=projector_deviation,
            view_rms_px={
                view.name: _rms(np.concatenate(pair))
                for view, pair in zip(self.views, pairs, strict=True)
            },
            condition=condition,
            parameters=self.shared_names(),
            correlation=correlation(covariance[:shared, :shared]),
            residuals_px=tuple(pairs),
        )

    def shared_names(self) -> tuple[str, ...]:
        free = zip(LENS_PARAMETERS, self.free_camera, self.free_projector, strict=True)
        chosen = list(free)
        return (
            *(f"camera.{name}" for name, own, _ in chosen if own),
            *(f"projector.{name}" for name, _, own in chosen if own),
            *(f"projector.{name}" for name in POSE_PARAMETERS if self.sizes[2]),
        )


def _with(lens: Lens, free: NDArray[np.bool_], values: Array) -> Lens:
    vector = lens_vector(lens)
    vector[free] = values
    return vector_lens(vector, lens.size_px)


def _free(given: bool, k3: bool) -> NDArray[np.bool_]:
    free = np.full(9, not given)
    free[8] &= k3
    return free


def _named(names: tuple[str, ...], free: NDArray[np.bool_], values: Array) -> dict[str, float]:
    chosen = [name for name, is_free in zip(names, free, strict=True) if is_free]
    return dict(zip(chosen, values.tolist(), strict=True))


def _rms(residuals: Array) -> float:
    """Return the RMS length of (N, 2) residuals, as OpenCV defines a reprojection error."""
    return float(np.sqrt(np.mean((residuals**2).sum(axis=1))))
