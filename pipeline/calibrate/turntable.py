"""The turntable's axis from a board that turns with it."""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np

from pipeline.formats.calibration import Turntable
from pipeline.geometry.rigid import RigidTransform

FEWEST_ANGLES = 3
LARGEST_TURN = 170.0


def turntable_axis(boards: Mapping[float, RigidTransform]) -> Turntable | None:
    """Find the axis from a board's poses by table angle (degrees); None for fewer than three.

    The direction is the mean of the pairs' rotation axes, weighted by their angles; the point is
    the least-squares fixed point of all pairs, the one nearest to the frame's origin.
    """
    angles = sorted(boards)
    if len(angles) < FEWEST_ANGLES:
        return None
    direction = np.zeros(3)
    pairs = []
    for i, first in enumerate(angles):
        for second in angles[i + 1 :]:
            motion = boards[second] @ boards[first].inverse()
            turn = (second - first + 180) % 360 - 180
            # A half turn has two axes, and none of them is surer than the noise.
            if not 1e-6 < abs(turn) < LARGEST_TURN:
                continue
            direction += np.sign(turn) * cv2.Rodrigues(motion.rotation)[0].ravel()
            pairs.append(motion)
    norm = np.linalg.norm(direction)
    if not pairs or norm < 1e-9:
        return None
    direction /= norm
    # A fixed point c of every motion: (I - R) c = t; along the axis any c will do, so 0.
    system = np.concatenate([*(np.eye(3) - motion.rotation for motion in pairs), direction[None]])
    right = np.concatenate([*(motion.translation_mm for motion in pairs), np.zeros(1)])
    point = np.linalg.lstsq(system, right, rcond=None)[0]
    return Turntable(point, direction)
