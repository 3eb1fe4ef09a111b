"""A canvas larger than the field: its placements found and registered."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import ImpastoError
from pipeline.extract.correlate import SIGNIFICANT, CoarseMap, Match, coarse, coarse_spacing, match
from pipeline.extract.patch import Patch, find_patch, make_map, map_spacing
from pipeline.extract.register import Registration, register
from pipeline.formats.placement_scans import PlacementScan
from pipeline.geometry.camera import Camera
from pipeline.geometry.rigid import RigidTransform

Array = NDArray[np.float64]
Image = NDArray[np.float32]


@dataclass(frozen=True)
class Together:
    """Patches that were registered, in the order of their scans; the first is the first scan's.

    Parameters
    ----------
    patches
        Those that belong together.
    registration
        Their motions.
    left_out
        Why each of the others does not, by name.
    """

    patches: list[Patch]
    registration: Registration | None
    left_out: dict[str, str]


def find_together(
    scans: list[PlacementScan],
    camera: Camera,
    projector_mm: Array,
    erosion_px: int,
    progress: Callable[[int, int], None],
) -> Together:
    """Find the canvas in every placement and register what overlaps, over others, with the first.

    Raises
    ------
    ImpastoError
        If there is no canvas in the first.
    """
    patches: list[Patch] = []
    left_out: dict[str, str] = {}
    for done, scan in enumerate(scans):
        progress(done, len(scans))
        try:
            patches.append(
                find_patch(
                    scan.name,
                    scan.range_image,
                    scan.texture,
                    camera,
                    projector_mm,
                    erosion_px,
                )
            )
        except ImpastoError as problem:
            if not patches:
                raise
            left_out[scan.name] = problem.problem
    spacing = map_spacing(patches)
    maps = [make_map(patch, spacing) for patch in patches]
    start, weakest = _first_guess([coarse(one, coarse_spacing(maps)) for one in maps])
    for k, patch in enumerate(patches):
        if k not in start:
            left_out[patch.name] = "no overlap with the others was found"
    while len(start) > 1:
        used = sorted(start)
        try:
            found = register([maps[k] for k in used], [start[k] for k in used])
        except ValueError as problem:
            for k in used[1:]:
                left_out[patches[k].name] = str(problem)
            break
        wrong = _disagreeing(found, used, weakest)
        if wrong is None:
            return Together([patches[k] for k in used], found, left_out)
        left_out[patches[wrong].name] = "its relief does not agree with the others' where they meet"
        start = {k: motion for k, motion in start.items() if k != wrong}
    return Together(patches[:1], None, left_out)


def _first_guess(maps: list[CoarseMap]) -> tuple[dict[int, RigidTransform], dict[int, float]]:
    """Return rough motions by number, and the score by which each patch was joined.

    The strongest match joins first (the maximum spanning tree of Prim 1957), so that a weak overlap
    is left aside where there is a way round it.
    """
    pairs: dict[tuple[int, int], Match] = {
        (i, j): match(maps[i], maps[j]) for i, j in combinations(range(len(maps)), 2)
    }
    motions, scores = {0: RigidTransform()}, {0: np.inf}
    while True:
        reach = [
            (pair.score, i, j)
            for (i, j), pair in pairs.items()
            if pair.score >= SIGNIFICANT and (i in motions) != (j in motions)
        ]
        if not reach:
            return motions, scores
        score, i, j = max(reach)
        motion = pairs[i, j].motion
        if i in motions:
            motions[j], scores[j] = motions[i] @ motion, score
        else:
            motions[i], scores[i] = motions[j] @ motion.inverse(), score


def _disagreeing(found: Registration, used: list[int], scores: dict[int, float]) -> int | None:
    """Return the patch, not the first, that was joined most weakly of those that do not agree."""
    held = {k for o in found.overlaps for k in (o.first, o.second)}
    wrong = {k for o in found.overlaps if not o.agrees for k in (o.first, o.second)}
    wrong |= set(range(len(used))) - held
    wrong.discard(0)
    return min((used[k] for k in wrong), key=lambda k: scores[k], default=None)
