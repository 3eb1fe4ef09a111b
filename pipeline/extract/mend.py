"""Mending a grown region: what steep paint cut off, bit out or enclosed; and its doubtful rim."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from pipeline.extract.steps import Sampling, link_ends

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

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


def join_parts(
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


def close_notches(region: Mask, valid: Mask, heights: Array, sampling: Sampling) -> Mask:
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


def fill_islands(
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


def doubtful_rim(region: Mask, heights: Array, noise_mm: float, width_px: int) -> Mask:
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
    return ~link_ends((~broken[0], ~broken[1]), shape)
