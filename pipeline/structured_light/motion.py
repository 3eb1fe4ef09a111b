"""Whether the object or the camera moved during a sequence: pictures in even light must agree."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]

_SMOOTH_PX = 1.0
_FEWEST_PIXELS = 1000
_CLEAR = 5.0
"""A shift counts if it is so many of its own standard deviations."""


def shift_between(reference: Image, image: Image) -> float:
    """Return how far a picture is shifted against another in the same light, px.

    Parameters
    ----------
    reference, image
        (rows, columns) light, of any two scales; NaN where it is not known.

    Returns
    -------
    The length of the shift; 0 if it is not clear, or the pictures show no texture. One step of
    Lucas and Kanade (1981), so that large shifts come out too small, but not as nothing.
    """
    known = np.isfinite(reference) & np.isfinite(image)
    if np.count_nonzero(known) < _FEWEST_PIXELS:
        return 0.0
    smooth = [
        cv2.GaussianBlur(np.where(known, part, 0).astype(np.float32), (0, 0), _SMOOTH_PX)
        for part in (reference, image)
    ]
    # What was filled in must not look like texture.
    near = cv2.erode(known.astype(np.uint8), np.ones((7, 7), np.uint8), borderValue=0) > 0
    if np.count_nonzero(near) < _FEWEST_PIXELS:
        return 0.0
    slopes = [cv2.Sobel(smooth[0], cv2.CV_32F, dx, 1 - dx, ksize=1, scale=0.5) for dx in (1, 0)]
    design = np.stack([smooth[0][near], *(slope[near] for slope in slopes)], axis=1)
    design = np.column_stack([design, np.ones(len(design))]).astype(np.float64)
    target = smooth[1][near].astype(np.float64)
    scale = np.sqrt(np.mean(design**2, axis=0))
    if not (scale > 1e-12).all():
        return 0.0
    design /= scale
    weight = np.ones(len(target))
    for _ in range(4):
        weighted = design * weight[:, None]
        normal = weighted.T @ design
        solution = np.linalg.lstsq(normal, weighted.T @ target, rcond=None)[0]
        residual = np.abs(target - design @ solution)
        spread = 1.4826 * float(np.median(residual)) + 1e-15
        weight = np.minimum(1, 2 * spread / (residual + 1e-15))
    gain, across, down = (solution / scale)[:3]
    if not gain > 0:
        return 0.0
    # Neighbours are alike after smoothing: fewer of them are independent.
    alike = 4 * np.pi * _SMOOTH_PX**2
    deviation = np.sqrt(alike * np.diag(np.linalg.pinv(normal))) * spread / scale
    length = float(np.hypot(across, down) / gain)
    doubt = float(np.hypot(deviation[1], deviation[2]) / gain)
    return length if length > _CLEAR * doubt else 0.0
