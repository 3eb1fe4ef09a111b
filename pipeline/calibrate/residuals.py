"""What is left of each board view after the adjustment, for the report."""

from __future__ import annotations

import numpy as np

from pipeline.calibrate.bundle_adjustment import Adjusted, BoardView
from pipeline.formats.board_residuals import ViewResiduals

PROJECTOR = "projector"


def view_residuals(camera: str, views: list[BoardView], adjusted: Adjusted) -> list[ViewResiduals]:
    """Return one entry per view and device, the camera's first."""
    found = []
    for view, board, (seen, lit) in zip(views, adjusted.boards, adjusted.residuals_px, strict=True):
        middle = board.apply(view.points.mean(axis=0))
        distance = float(np.linalg.norm(middle))
        cosine = abs(float(board.rotation[:, 2] @ middle)) / distance
        tilt = float(np.degrees(np.arccos(min(cosine, 1.0))))
        found.append(ViewResiduals(view.name, camera, view.camera_px, seen, distance, tilt))
        if view.projector_px is not None and len(lit):
            known = np.isfinite(view.projector_px).all(axis=1)
            found.append(
                ViewResiduals(view.name, PROJECTOR, view.projector_px[known], lit, distance, tilt)
            )
    return found
