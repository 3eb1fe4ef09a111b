"""The height d0 that parts bump-mapped from relief-mapped paint."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

BASE_PERCENTILE = 1.0
"""Percentile of the heights that stands for the lowest paint: single wrong samples lie deeper."""


def tolerated_depth_mm(
    error_px: float,
    nearest_mm: float,
    picture_height_px: float,
    vertical_field_deg: float,
    angle_deg: float,
) -> float:
    """Return the depth whose missing parallax moves a texel by ``error_px`` on the screen.

    Parameters
    ----------
    error_px
        Largest tolerated displacement, px.
    nearest_mm
        The eye's smallest distance from the paint.
    picture_height_px, vertical_field_deg
        Rows of the picture and its vertical field of view, which give the focal length in px.
    angle_deg
        Largest angle between the line of sight and the canvas's normal, in (0, 90).

    Notes
    -----
    A texel drawn on the plane instead of z below it is out of place by z sin(angle) across the line
    of sight, which is f z sin(angle) / distance on the screen.
    """
    focal_px = 0.5 * picture_height_px / np.tan(0.5 * np.deg2rad(vertical_field_deg))
    return float(error_px * nearest_mm / (focal_px * np.sin(np.deg2rad(angle_deg))))


def threshold_by_error(heights_mm: NDArray[np.floating], tolerated_mm: float) -> float:
    """Return the highest d0 at which the plane still stands in for all paint below it.

    Parameters
    ----------
    heights_mm
        The canvas's heights, any shape, at least one finite.
    tolerated_mm
        As :func:`tolerated_depth_mm` gives it.
    """
    return float(np.nanpercentile(heights_mm, BASE_PERCENTILE)) + tolerated_mm


def threshold_by_share(heights_mm: NDArray[np.floating], share: float) -> float:
    """Return ``share`` of the maximum height (published: 0.2 to 0.4, chosen by hand).

    The maximum counts from the canvas plane, z = 0; a canvas with nothing above it gets its
    maximum, and so no boxes.
    """
    highest = float(np.nanmax(heights_mm))
    return share * highest if highest > 0 else highest
