"""Reprojection of many views with what they share: the layout of the parameters and the sums.

Shared are the lenses and the table's axis, each held to what is known of it already by its standard
deviation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.camera import Lens
from pipeline.geometry.rigid import RigidTransform, rotation_about_axis
from pipeline.reflectance.axis_motion import AXIS
from pipeline.reflectance.projection import LENS, changed, lens_derivative, point_derivative

Array = NDArray[np.float64]

CAUCHY = 2.5
"""Residuals of this many standard deviations have half their weight."""

_TILES = 12
"""Points of one of so many by so many tiles of the image err together."""

_BEHIND_PX = 1e6


@dataclass(frozen=True)
class View:
    """Points seen by a camera from one place.

    Parameters
    ----------
    lens
        Name of the camera's lens.
    points_mm
        (N, 3) in the frame that the pose is wanted from.
    pixels, sigma_px
        (N, 2), (N,).
    axis_motion
        (N, 3, 4) derivative of the points by the axis's parameters; None if it has no part.
    """

    lens: str
    points_mm: Array
    pixels: Array
    sigma_px: Array
    axis_motion: Array | None = None


@dataclass(frozen=True)
class State:
    """What is adjusted: a pose per view, the lenses by name, the axis's change (4,)."""

    poses: tuple[RigidTransform, ...]
    lenses: Mapping[str, Lens]
    axis: Array = field(default_factory=lambda: np.zeros(AXIS))


@dataclass(frozen=True)
class Known:
    """Standard deviations of what is known already; what is not named stays put.

    Parameters
    ----------
    lenses
        (8,) by lens, in the order of :data:`pipeline.reflectance.projection.LENS`.
    axis
        (4,).
    axis_moved
        (4,) by how much the views' axis has been moved from the one that is known.
    """

    lenses: Mapping[str, Array] = field(default_factory=dict)
    axis: Array | None = None
    axis_moved: Array = field(default_factory=lambda: np.zeros(AXIS))


class Problem:
    """The layout of the parameters, and the sums over all views."""

    def __init__(self, views: Sequence[View], start: State, known: Known) -> None:
        self.views, self.start, self.known = views, start, known
        prior = [np.zeros(6 * len(views))]
        self.axis_at: slice | None = None
        self.lens_at: dict[str, slice] = {}
        at = 6 * len(views)
        if known.axis is not None and any(view.axis_motion is not None for view in views):
            self.axis_at = slice(at, at + AXIS)
            prior.append(known.axis**-2.0)
            at += AXIS
        used = {view.lens for view in views}
        for name in sorted(known.lenses.keys() & used):
            self.lens_at[name] = slice(at, at + len(LENS))
            prior.append(known.lenses[name] ** -2.0)
            at += len(LENS)
        self.size = at
        self.prior = np.concatenate(prior)

    def moved(self, state: State, step: Array) -> State:
        """Return the state a step further."""
        poses = tuple(_moved(pose, step[6 * i : 6 * i + 6]) for i, pose in enumerate(state.poses))
        lenses = {
            name: changed(lens, step[self.lens_at[name]]) if name in self.lens_at else lens
            for name, lens in state.lenses.items()
        }
        axis = state.axis if self.axis_at is None else state.axis + step[self.axis_at]
        return State(poses, lenses, axis)

    def away(self, state: State) -> Array:
        """Return how far the shared parameters are from where they started, (size,)."""
        away = np.zeros(self.size)
        if self.axis_at is not None:
            away[self.axis_at] = state.axis + self.known.axis_moved
        for name, at in self.lens_at.items():
            now, then = state.lenses[name], self.start.lenses[name]
            K = now.K - then.K
            distortion = now.distortion - then.distortion
            away[at] = [K[0, 0], K[1, 1], K[0, 2], K[1, 2], *distortion[:4]]
        return away

    def points(self, state: State, index: int) -> Array:
        """Return a view's points in its camera's frame."""
        view = self.views[index]
        points = view.points_mm
        if view.axis_motion is not None and self.axis_at is not None:
            points = points + view.axis_motion @ state.axis
        return state.poses[index].apply(points)

    def residual(self, state: State, index: int) -> Array:
        """Return projected minus seen; a large number for points behind the camera."""
        view, there = self.views[index], self.points(state, index)
        with np.errstate(all="ignore"):
            residual = state.lenses[view.lens].project(there) - view.pixels
        residual[~((there[:, 2] > 0) & np.isfinite(residual).all(axis=1))] = _BEHIND_PX
        return residual

    def squares(self, index: int, residual: Array, widths: Sequence[float]) -> Array:
        """Return squared residuals in units of variance."""
        sigma = widths[index] * self.views[index].sigma_px
        return np.asarray((residual**2).sum(axis=1) / sigma**2)

    def widths(self, state: State) -> list[float]:
        """Return the residuals' robust deviations: their size's median over Rayleigh's law's."""
        found = []
        for index in range(len(self.views)):
            squares = self.squares(index, self.residual(state, index), [1.0] * len(self.views))
            found.append(max(float(np.sqrt(np.median(squares) / (2 * np.log(2)))), 1e-9))
        return found

    def cost(self, state: State, widths: Sequence[float]) -> float:
        """Return the robust sum with that of what was known before."""
        total = float(self.prior @ self.away(state) ** 2)
        for index in range(len(self.views)):
            squares = self.squares(index, self.residual(state, index), widths)
            total += CAUCHY**2 * float(np.log1p(squares / CAUCHY**2).sum())
        return total

    def normal_equations(self, state: State, widths: Sequence[float]) -> tuple[Array, Array, Array]:
        """Return J'WJ and J'Wr with what was known, and J'Wr's scatter between tiles."""
        hessian = np.diag(self.prior)
        slope = self.prior * self.away(state)
        scatter = np.zeros_like(hessian)
        for index, view in enumerate(self.views):
            residual, there = self.residual(state, index), self.points(state, index)
            seen = residual[:, 0] < _BEHIND_PX
            weight = 1 / (1 + self.squares(index, residual, widths) / CAUCHY**2)
            weight = np.where(seen, np.sqrt(weight), 0) / (widths[index] * view.sigma_px)
            there[~seen] = (0, 0, 1)
            where, blocks = self._blocks(state, index, there)
            rows = np.concatenate(blocks, axis=2) * weight[:, None, None]
            pull = np.einsum("nij,ni->nj", rows, residual * weight[:, None])
            flat = rows.reshape(-1, len(where))
            at = np.ix_(where, where)
            hessian[at] += flat.T @ flat
            slope[where] += pull.sum(axis=0)
            sums = np.zeros((_TILES * _TILES, len(where)))
            np.add.at(sums, _tile(view, state.lenses[view.lens]), pull)
            scatter[at] += sums.T @ sums
        return hessian, slope, scatter

    def _blocks(self, state: State, index: int, there: Array) -> tuple[list[int], list[Array]]:
        """Return the derivatives of a view's pixels, and the parameters they are of."""
        view = self.views[index]
        lens = state.lenses[view.lens]
        by_point = point_derivative(lens, there)
        where = list(range(6 * index, 6 * index + 6))
        # Turning by omega moves a point X of the camera's frame by omega x X = -[X] omega.
        x, y, z = there.T
        zero = np.zeros_like(x)
        turn = np.stack([zero, z, -y, -z, zero, x, y, -x, zero], axis=1).reshape(-1, 3, 3)
        blocks = [by_point @ turn, by_point]
        if view.axis_motion is not None and self.axis_at is not None:
            blocks.append(by_point @ (state.poses[index].rotation @ view.axis_motion))
            where += range(self.axis_at.start, self.axis_at.stop)
        if view.lens in self.lens_at:
            blocks.append(lens_derivative(lens, there))
            where += range(self.lens_at[view.lens].start, self.lens_at[view.lens].stop)
        return where, blocks


def _moved(pose: RigidTransform, step: Array) -> RigidTransform:
    """Turn and then shift a pose, in the camera's frame."""
    angle = float(np.linalg.norm(step[:3]))
    axis = step[:3] / angle if angle > 0 else np.array([0.0, 0, 1])
    turn = rotation_about_axis(np.zeros(3), axis, np.degrees(angle)).rotation
    return RigidTransform(turn @ pose.rotation, turn @ pose.translation_mm + step[3:])


def _tile(view: View, lens: Lens) -> NDArray[np.intp]:
    place = np.floor(view.pixels / lens.size_px * _TILES).astype(np.intp)
    column, row = np.clip(place, 0, _TILES - 1).T
    return np.asarray(row * _TILES + column)
