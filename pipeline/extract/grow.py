"""Region growing: the canvas is what goes on without a step from the middle of the picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from pipeline.errors import ImpastoError
from pipeline.extract.mend import close_notches, doubtful_rim, fill_islands, join_parts
from pipeline.extract.steps import (
    Sampling,
    bridge,
    link_ends,
    measure_sampling,
    slopes,
    smoothing_for,
)

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

STEEPEST_FLAT, STEEPEST_DEEP = 0.8, 3.5
"""Range of the slope (rise over run) that ends the canvas; see :func:`steepest_slope`."""

_TIMES_TYPICAL = 6.0
_MOST_SMOOTHING_PX = 6.0  # noise of some twenty sample distances: no surface can be told
_LINK_SIGMAS = 4.0
_EIGHT = np.ones((3, 3), bool)


@dataclass(frozen=True)
class Region:
    """What was grown.

    Parameters
    ----------
    mask
        (rows, columns) bool; measured pixels of the canvas only.
    slope
        The slope that ended it.
    smoothing_px
        The Gaussian that the noise asked for.
    sampling
        Distances and noise inside.
    """

    mask: Mask
    slope: float
    smoothing_px: float
    sampling: Sampling


def grow(
    canvas: Array,
    sigma_mm: NDArray[np.floating],
    near: Mask,
    weight: NDArray[np.floating],
    erosion_px: int,
) -> Region:
    """Find the canvas in a range image.

    Parameters
    ----------
    canvas
        (rows, columns, 3) x, y along the plane and the height above it, mm; NaN if not measured.
    sigma_mm
        (rows, columns) standard deviation of the heights.
    near
        (rows, columns) bool: pixels that are likely canvas, from which noise and typical slope
        are taken.
    weight
        (rows, columns) >= 0: the part with the largest sum is the canvas.
    erosion_px
        Width of the rim that is left out where it does not agree with what lies inside.

    Raises
    ------
    ImpastoError
        If nothing goes on for more than a few pixels.

    Notes
    -----
    A pixel with a step to a neighbour is *rough*. What remains, opened so that no bridge narrower
    than three pixels counts, falls in connected parts; the one with most weight is
    the canvas (region growing: Adams and Bischof 1994). Parts that strokes have cut off join if
    they go on across the gap; islands inside join if they do not stand higher than paint can.
    """
    valid: Mask = np.asarray(np.isfinite(canvas).all(axis=2))
    sampling = measure_sampling(canvas, sigma_mm, near & valid)
    if not sampling.distance_mm > 0:
        raise _nothing()
    limit = steepest_slope(canvas, valid, near & valid, sampling)
    smoothing = smoothing_for(sampling, limit)
    if smoothing > _MOST_SMOOTHING_PX:
        raise _nothing()
    bridged, known = bridge(canvas, valid)
    broken = _broken(slopes(bridged, known, sampling, smoothing), limit, sampling, smoothing)
    rough = link_ends(broken, known.shape)
    core = ndimage.binary_erosion(known & ~rough, _EIGHT, border_value=1)
    parts, count = ndimage.label(core)
    if count == 0:
        raise _nothing()
    total = np.bincount(parts.ravel(), weight.ravel(), minlength=count + 1)
    total[0] = 0
    region = parts == int(np.argmax(total))
    region = join_parts(region, parts, bridged[..., 2], sampling, limit)
    raw = _broken(slopes(bridged, known, sampling, 0.0), limit, sampling, 0.0)
    region = _spread(region, known, raw, steps=2 + round(2 * smoothing))
    region = close_notches(region, valid, bridged[..., 2], sampling)
    region = fill_islands(region, valid, raw, bridged[..., 2], sampling)
    region &= valid
    if erosion_px:
        region &= ~doubtful_rim(region, canvas[..., 2], sampling.noise_mm, erosion_px)
    region = _largest(region)
    if not region.any():
        raise _nothing()
    return Region(region, limit, smoothing, sampling)


def steepest_slope(canvas: Array, valid: Mask, near: Mask, sampling: Sampling) -> float:
    """Return the slope that ends the surface.

    Six times the typical (median) one, measured on heights so smooth that noise adds little: a
    flat canvas ends at the frame's foot, a deep relief goes on over its own walls. Steep strokes
    do not raise it: they are islands, notches or cuts, and are mended as such.
    """
    across, down = slopes(canvas, valid, sampling, smoothing_for(sampling, STEEPEST_FLAT))
    steep = np.hypot(across[:-1], down[:, :-1])[near[:-1, :-1]]
    steep = steep[np.isfinite(steep)]
    if not steep.size:
        return STEEPEST_FLAT
    limit = _TIMES_TYPICAL * float(np.median(steep))
    return float(np.clip(limit, STEEPEST_FLAT, STEEPEST_DEEP))


def _broken(
    found: tuple[Array, Array], limit: float, sampling: Sampling, smoothing: float
) -> tuple[Mask, Mask]:
    """Return which neighbours are parted by more than the slope and the noise explain."""
    noise = sampling.noise_mm / sampling.distance_mm * np.sqrt(2)
    if smoothing:
        noise = 0.0
    allowed = limit + _LINK_SIGMAS * noise
    return found[0] > allowed, found[1] > allowed


def _spread(region: Mask, known: Mask, broken: tuple[Mask, Mask], steps: int) -> Mask:
    """Grow over unbroken links, a few pixels: what smoothing and opening have shaved off."""
    across, down = ~broken[0], ~broken[1]
    for _ in range(steps):
        reached = region.copy()
        reached[:, 1:] |= region[:, :-1] & across
        reached[:, :-1] |= region[:, 1:] & across
        reached[1:] |= region[:-1] & down
        reached[:-1] |= region[1:] & down
        region = reached & known
    return region


def _largest(region: Mask) -> Mask:
    parts, count = ndimage.label(region)
    if count <= 1:
        return region
    sizes = np.bincount(parts.ravel())
    sizes[0] = 0
    return np.asarray(parts == int(np.argmax(sizes)))


def _nothing() -> ImpastoError:
    return ImpastoError(
        "no surface goes on for more than a few pixels in the middle of the picture",
        where="scan/range.exr",
        expected="the object in the middle of the scan camera's picture",
        fix="look at the range map (impasto report); a noisy scan needs longer exposures",
    )
