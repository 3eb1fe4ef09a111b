"""How much of each box's relief is drawn, from the parallax that a flat picture would miss."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import UsageError
from pipeline.formats.boxes import Boxes
from renderers.view import View


@dataclass(frozen=True)
class Adaptive:
    """The sensitivity of the choice between bump and relief mapping.

    Parameters
    ----------
    K
        Factor on r = |IB| / |CI|, > 0; the focal length in px if left out, so that K r bounds,
        near the middle of the picture, the parallax in px that bump mapping leaves out.
    e_min, e_max
        K r below ``e_min`` leaves the box out, above ``e_max`` draws it opaque;
        0 <= e_min < e_max.
    """

    K: float | None = None
    e_min: float = 0.5
    e_max: float = 1.0

    def __post_init__(self) -> None:
        if self.K is not None and not self.K > 0:
            raise UsageError(f"the sensitivity K is {self.K}", expected="a positive number")
        if not 0 <= self.e_min < self.e_max:
            raise UsageError(
                f"the limits e_min and e_max are {self.e_min} and {self.e_max}",
                expected="0 <= e_min < e_max",
            )


def box_alphas(
    boxes: Boxes, spacing_mm: float, view: View, adaptive: Adaptive
) -> NDArray[np.float32]:
    """Return each box's opacity (N,), in [0, 1].

    With I the box's highest point, B its projection on the plane at d0 along the view direction
    and C the camera's centre:

        r = |IB| / |CI|,  alpha = clamp((K r - e_min) / (e_max - e_min), 0, 1).

    A point at or above the camera's height, whose B does not exist, gives 1.
    """
    columns_rows = boxes.highest_at.astype(np.float64)
    highest = np.stack(
        [
            columns_rows[:, 0] * spacing_mm,
            -columns_rows[:, 1] * spacing_mm,
            boxes.highest_mm.astype(np.float64),
        ],
        axis=-1,
    )
    # I, B and C are on one line, so |IB| / |CI| is the ratio of their heights.
    above_plane = np.maximum(highest[:, 2] - boxes.d0_mm, 0.0)
    below_camera = view.camera.centre_mm[2] - highest[:, 2]
    ratio = np.divide(
        above_plane, below_camera, out=np.full(len(boxes), np.inf), where=below_camera > 0
    )
    lens = view.camera.lens
    K = adaptive.K if adaptive.K is not None else float(max(lens.K[0, 0], lens.K[1, 1]))
    alpha = (K * ratio - adaptive.e_min) / (adaptive.e_max - adaptive.e_min)
    return np.asarray(np.clip(alpha, 0.0, 1.0), dtype=np.float32)
