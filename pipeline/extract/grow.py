"""Region growing: the canvas is what goes on without a step from the middle of the picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from pipeline.errors import ImpastoError
from pipeline.extract.steps import (
    Sampling,
    bridge,
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
_ISLAND_RISE = 0.015  # of the region's side
_NOTCH = 0.04  # of the region's side
_ISLAND_SHARE = 0.8  # of an island's pixels
_BRIDGE_PX, _BRIDGE = 8.0, 0.06  # at least, and of the surface's side
_CONTACT_PX = 2.0
_GENTLE = 0.25
_OWN_RELIEF = 0.15
_LEAST_PART = 1e-4  # of the region's pixels
_FEWEST_INSIDE = 3
_RIM_SIGMAS = 2.5
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
    rough = _ends(broken, known.shape)
    core = ndimage.binary_erosion(known & ~rough, _EIGHT, border_value=1)
    parts, count = ndimage.label(core)
    if count == 0:
        raise _nothing()
    total = np.bincount(parts.ravel(), weight.ravel(), minlength=count + 1)
    total[0] = 0
    region = parts == int(np.argmax(total))
    region = _join_parts(region, parts, bridged[..., 2], sampling, limit)
    raw = _broken(slopes(bridged, known, sampling, 0.0), limit, sampling, 0.0)
    region = _spread(region, known, raw, steps=2 + round(2 * smoothing))
    region = _close_notches(region, valid, bridged[..., 2], sampling)
    region = _fill_islands(region, valid, raw, bridged[..., 2], sampling)
    region &= valid
    if erosion_px:
        region &= ~_doubtful_rim(region, canvas[..., 2], sampling.noise_mm, erosion_px)
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


def _ends(links: tuple[Mask, Mask], shape: tuple[int, int]) -> Mask:
    """Return the pixels at either end of a marked link."""
    across, down = links
    marked = np.zeros(shape, bool)
    marked[:, :-1] |= across
    marked[:, 1:] |= across
    marked[:-1] |= down
    marked[1:] |= down
    return marked


def _join_parts(
    region: Mask, parts: NDArray[np.integer], heights: Array, sampling: Sampling, limit: float
) -> Mask:
    """Add parts whose heights go on across the gap that a stroke has cut.

    Where a part comes nearest to the region, its height must differ by no more than a gentle slope
    makes over the gap, or than is little beside the relief that the region has itself; a frame
    differs by its whole height over a gap of few pixels.
    """
    side_px = np.sqrt(np.count_nonzero(parts))
    widest = max(_BRIDGE_PX, _BRIDGE * side_px)
    sizes = np.bincount(parts.ravel())
    candidates = {int(i) for i in np.flatnonzero(sizes >= _LEAST_PART * region.sum()) if i}
    candidates -= set(np.unique(parts[region]).tolist())
    while candidates:
        distance, (row, column) = ndimage.distance_transform_edt(~region, return_indices=True)
        facing = (distance <= widest) & ~region & np.isin(parts, sorted(candidates))
        labels, gap = parts[facing], distance[facing]
        rise = np.abs(heights[facing] - heights[row[facing], column[facing]])
        low, high = np.percentile(heights[region], (1, 99))
        small = np.maximum(_GENTLE * limit * gap * sampling.distance_mm, _OWN_RELIEF * (high - low))
        joined = []
        for part in sorted(set(labels.tolist())):
            own = labels == part
            nearest = own & (gap <= gap[own].min() + _CONTACT_PX)
            if np.median(rise[nearest] / small[nearest]) < 1:
                joined.append(part)
        if not joined:
            break
        region = region | np.isin(parts, joined)
        candidates -= set(joined)
    return region


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


def _close_notches(region: Mask, valid: Mask, heights: Array, sampling: Sampling) -> Mask:
    """Add what rough paint has bitten out of the edge: near the region's height, and in line.

    A morphological closing never goes beyond a straight edge, and so never onto a frame.
    """
    side_px = np.sqrt(np.count_nonzero(region))
    radius = _NOTCH * side_px
    around = int(np.ceil(radius)) + 1
    padded = np.pad(region, around)
    grown = ndimage.distance_transform_edt(~padded) <= radius
    closed = ndimage.distance_transform_edt(grown) > radius
    notch = closed[around:-around, around:-around] & valid & ~region
    _, (row, column) = ndimage.distance_transform_edt(~region, return_indices=True)
    rise = np.abs(heights - heights[row, column])
    return np.asarray(region | (notch & (rise <= _ISLAND_RISE * side_px * sampling.distance_mm)))


def _fill_islands(
    region: Mask, valid: Mask, broken: tuple[Mask, Mask], heights: Array, sampling: Sampling
) -> Mask:
    """Add enclosed pixels that may be paint; leave spikes and what is seen through holes."""
    islands, count = ndimage.label(ndimage.binary_fill_holes(region) & ~region & valid, _EIGHT)
    if count == 0:
        return region
    _, (row, column) = ndimage.distance_transform_edt(~region, return_indices=True)
    low, high = np.percentile(heights[region], (1, 99))
    side = np.sqrt(np.count_nonzero(region)) * sampling.distance_mm
    fits = np.abs(heights - heights[row, column]) <= _ISLAND_RISE * side + (high - low)
    size = np.bincount(islands.ravel(), minlength=count + 1)
    fitting = np.bincount(islands.ravel(), (fits & ~_lonely(broken, valid.shape)).ravel())
    paint = fitting >= _ISLAND_SHARE * size
    paint[0] = False
    return np.asarray(region | (paint[islands] & fits & ~_lonely(broken, valid.shape)))


def _doubtful_rim(region: Mask, heights: Array, noise_mm: float, width_px: int) -> Mask:
    """Return the rim's pixels that do not agree with what lies inside.

    A pixel on the rim may see canvas and frame at once. It stays if it lies within the scatter of
    the interior's heights around it, so that no good canvas is given away.
    """
    filled = ndimage.binary_fill_holes(region)
    outside = ndimage.binary_dilation(~filled, _EIGHT, iterations=width_px)
    inside = region & ~outside
    window = 2 * width_px + 3
    share = ndimage.uniform_filter(inside.astype(np.float64), window)
    known = share > _FEWEST_INSIDE / window**2
    weight = np.maximum(share, 1 / window**2)
    # Differences to a nearby height keep the variance free of cancellation.
    level = float(np.median(heights[region]))
    z = np.where(inside, heights - level, 0.0)
    mean = ndimage.uniform_filter(z, window) / weight
    variance = np.maximum(ndimage.uniform_filter(z * z, window) / weight - mean**2, 0)
    scatter = np.sqrt(variance + noise_mm**2)
    agrees = known & (np.abs(heights - level - mean) <= _RIM_SIGMAS * scatter)
    return np.asarray(region & outside & ~agrees)


def _lonely(broken: tuple[Mask, Mask], shape: tuple[int, int]) -> Mask:
    """Return the pixels parted from all their neighbours: spikes of wrong decoding."""
    return ~_ends((~broken[0], ~broken[1]), shape)


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
