"""How patches lie to each other, exactly: least squares over all their overlaps at once."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pipeline.extract.overlap import FEWEST, Layers, layers_of, look_up
from pipeline.extract.patch import PatchMap
from pipeline.geometry.rigid import RigidTransform

Array = NDArray[np.float64]

_SMOOTHING = (8.0, 3.0, 0.0)  # samples: from the start's error down to the maps' own detail
_ITERATIONS = 25
_SETTLED_MM = 1e-4
_HUBER, _FAR = 1.5, 6.0  # robust standard deviations
_MAD_TO_SIGMA = 1.4826
_CORRELATED = 7.0  # samples that share their noise through the maps' kernel
_LIT_ALIKE = 30.0  # and that share what the light makes of relief, which differs as it moves
_ALIKE = 0.7  # of the relief's own deviation: two surfaces that differ by more are not one
_WITHIN_NOISE = 3.0


@dataclass(frozen=True)
class Overlap:
    """How two patches agree.

    Parameters
    ----------
    first, second
        Their numbers.
    rms_mm, expected_mm
        Robust standard deviation of the height difference, and what the maps' own ones foretell.
    relief_mm
        Robust deviation of the heights themselves, without tilt.
    area_mm2
        Where both are known.
    """

    first: int
    second: int
    rms_mm: float
    expected_mm: float
    relief_mm: float
    area_mm2: float

    @property
    def agrees(self) -> bool:
        """Whether the two show one surface."""
        return self.rms_mm < max(_ALIKE * self.relief_mm, _WITHIN_NOISE * self.expected_mm)


@dataclass(frozen=True)
class Registration:
    """Where the patches lie.

    Parameters
    ----------
    motions
        Take each patch's axes to the first one's; the first is the identity.
    covariances
        (6, 6) of each one's turn (rad) about ``centre_mm`` and shift (mm); zeros for the first.
    centre_mm
        (3,) in the first's axes.
    overlaps
        All pairs that lie over each other.
    """

    motions: tuple[RigidTransform, ...]
    covariances: tuple[Array, ...]
    centre_mm: Array
    overlaps: tuple[Overlap, ...]


def register(maps: list[PatchMap], start: list[RigidTransform]) -> Registration:
    """Refine the patches' motions until all overlaps agree as well as they can.

    Parameters
    ----------
    maps
        The patches; each must overlap, over others, with the first.
    start
        Their motions to the first one's axes, right within a few samples.

    Raises
    ------
    ValueError
        If the overlaps leave a motion free: neither relief nor albedo holds it.

    Notes
    -----
    Gauss-Newton on two kinds of residuals: the distance to the other patch's tangent plane (Chen
    and Medioni 1992) and the difference of albedo along its gradient (as Park, Zhou and Koltun
    2017), each over its own standard deviation, with Huber's weights. Relief alone leaves a flat
    canvas free to slide, albedo alone leaves its height free. Each sample counts from both sides
    and shares noise with its neighbours, which the covariance makes up for.
    """
    motions = list(start)
    count = len(maps)
    centre = np.mean([m.apply(_middle(one)) for m, one in zip(motions, maps, strict=True)], axis=0)
    system = np.eye(6 * (count - 1))
    for width in _SMOOTHING:
        layers = [layers_of(one, width) for one in maps]
        points = [one.points() for one in layers]
        for _ in range(_ITERATIONS):
            system, right = _normal_equations(layers, points, motions, centre)
            if np.linalg.matrix_rank(_scaled(system), tol=1e-10, hermitian=True) < len(system):
                raise ValueError("neither relief nor albedo holds them in place")
            step = np.linalg.solve(system, right).reshape(-1, 6)
            for k, (turn, shift) in enumerate(zip(step[:, :3], step[:, 3:], strict=True), start=1):
                rotation = Rotation.from_rotvec(turn).as_matrix()
                own = RigidTransform(rotation, centre - rotation @ centre + shift)
                motions[k] = own @ motions[k]
            reach = max(np.ptp(p[:, :2], axis=0).max() for p, _ in points)
            moved = np.linalg.norm(step[:, :3], axis=1) * reach + np.linalg.norm(
                step[:, 3:], axis=1
            )
            if moved.max() < _SETTLED_MM * (1 + 10 * width):
                break
    covariance = np.asarray(np.linalg.inv(system), dtype=np.float64)
    blocks: list[Array] = [covariance[i : i + 6, i : i + 6] for i in range(0, 6 * (count - 1), 6)]
    overlaps = [
        found
        for i, j in combinations(range(count), 2)
        if (found := _overlap(layers, points, motions, i, j)) is not None
    ]
    return Registration(tuple(motions), (np.zeros((6, 6)), *blocks), centre, tuple(overlaps))


def _middle(one: PatchMap) -> Array:
    rows, columns = one.heights.shape
    half = 0.5 * one.spacing_mm
    return np.array([one.left_mm + half * (columns - 1), one.top_mm - half * (rows - 1), 0.0])


def _normal_equations(
    layers: list[Layers],
    points: list[tuple[Array, Array]],
    motions: list[RigidTransform],
    centre: Array,
) -> tuple[Array, Array]:
    """Sum the residuals of all overlaps; the first patch stays where it is."""
    size = 6 * len(layers)
    system, right = np.zeros((size, size)), np.zeros(size)
    for i in range(len(layers)):
        for j in range(len(layers)):
            if i == j or (found := look_up(layers, points, motions, i, j)) is None:
                continue
            arm = found.points - centre
            for residual, direction, sigma, together in (
                (found.height, found.normal, found.sigma, _CORRELATED),
                (found.albedo, found.gradient, np.ones(len(arm)), _LIT_ALIKE),
            ):
                # Two sides of each overlap, and samples that share errors, count for fewer.
                share = 0.5 * min(1.0, found.stride / together)
                good = np.isfinite(residual) & np.isfinite(direction).all(axis=1)
                if np.count_nonzero(good) < FEWEST:
                    continue
                r, s = residual[good], sigma[good]
                spread = _MAD_TO_SIGMA * float(np.median(np.abs(r / s)))
                s = s * max(spread, 1e-6) if direction is found.gradient else s * max(spread, 1.0)
                size_of = np.abs(r) / s
                w = share * np.where(size_of > _FAR, 0.0, _HUBER / np.maximum(size_of, _HUBER))
                jacobian = np.hstack([np.cross(arm[good], direction[good]), direction[good]])
                weighted = jacobian * (w / s**2)[:, None]
                square, side = weighted.T @ jacobian, weighted.T @ r
                a, b = np.s_[6 * i : 6 * i + 6], np.s_[6 * j : 6 * j + 6]
                system[a, a] += square
                system[b, b] += square
                system[a, b] -= square
                system[b, a] -= square
                right[a] -= side
                right[b] += side
    return system[6:, 6:], right[6:]


def _scaled(system: Array) -> Array:
    """Bring turns and shifts to one scale, so that a rank can be told."""
    scale = np.sqrt(np.maximum(np.diag(system), 1e-300))
    return np.asarray(system / np.outer(scale, scale))


def _overlap(
    layers: list[Layers],
    points: list[tuple[Array, Array]],
    motions: list[RigidTransform],
    i: int,
    j: int,
) -> Overlap | None:
    found = look_up(layers, points, motions, i, j)
    if found is None:
        return None
    plane = np.column_stack([found.points[:, :2], np.ones(len(found.points))])
    z = found.points[:, 2]
    relief = z - plane @ np.linalg.lstsq(plane, z)[0]
    return Overlap(
        i,
        j,
        _robust(found.height),
        float(np.sqrt(np.median(found.sigma**2))),
        _robust(relief),
        len(found.height) * found.stride * layers[i].map.spacing_mm ** 2,
    )


def _robust(values: Array) -> float:
    """Return a robust RMS about zero."""
    return _MAD_TO_SIGMA * float(np.median(np.abs(values)))
