"""What a frame tells the shaders, packed as ``painting.wgsl`` lays it out; no device is needed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.asset import Asset
from renderers.adaptive import Adaptive, box_alphas
from renderers.view import Light, View, canvas_corners

Array = NDArray[np.float64]

NEAR_MM = 0.01
SHADOW_MARGIN = 0.05
"""Start of a shadow ray that is not tested, in sample spacings: the surface's own rounding."""

_FAR = 1e30

FRAME = np.dtype(
    [
        ("clip_from_canvas", "<f4", (4, 4)),
        ("ray_column", "<f4", 3),
        ("plane", "<f4"),
        ("ray_row", "<f4", 3),
        ("bottom", "<f4"),
        ("ray_first", "<f4", 3),
        ("top", "<f4"),
        ("camera", "<f4", 3),
        ("near", "<f4"),
        ("to_grid", "<f4", 3),
        ("shadow_margin", "<f4"),
        ("last_sample", "<f4", 2),
        ("lamp_count", "<u4"),
        ("shadows", "<u4"),
    ]
)
LAMP = np.dtype(
    [
        ("position", "<f4", 3),
        ("padding", "<f4"),
        ("radiant_intensity", "<f4", 3),
        ("padding_2", "<f4"),
    ]
)
BOX = np.dtype([("low", "<f4", 3), ("alpha", "<f4"), ("high", "<f4", 3), ("padding", "<f4")])


def pack_frame(
    asset: Asset, view: View, offset_px: tuple[float, float], lamp_count: int, shadows: bool
) -> NDArray[np.void]:
    """Fill the uniform block for rays through pixel centres moved by ``offset_px``."""
    lens, pose = view.camera.lens, view.camera.pose
    K = lens.K.copy()
    K[:2, 2] -= offset_px
    rays = pose.rotation.T @ np.linalg.inv(K)
    bottom, top = height_range(asset)
    rows, columns = asset.heights_mm.shape
    per_mm = 1 / asset.spacing_mm
    frame = np.zeros((), FRAME)
    clip = _clip_from_camera(K, lens.size_px) @ pose.matrix
    frame["clip_from_canvas"] = clip.T  # WGSL stores columns
    frame["ray_column"], frame["ray_row"], frame["ray_first"] = rays.T
    frame["plane"], frame["bottom"], frame["top"] = asset.boxes.d0_mm, bottom, top
    frame["camera"], frame["near"] = view.camera.centre_mm, NEAR_MM
    frame["to_grid"] = per_mm, per_mm, 1.0
    frame["shadow_margin"] = SHADOW_MARGIN * asset.spacing_mm
    frame["last_sample"] = columns - 1, rows - 1
    frame["lamp_count"], frame["shadows"] = lamp_count, shadows
    return frame


def pack_lamps(asset: Asset, lights: Sequence[Light]) -> tuple[NDArray[np.void], float]:
    """Pack the lights; the shaders' radiance must be multiplied by the returned power of two.

    That factor keeps the picture within float16, whatever unit the lights are given in.
    """
    lamps = np.zeros(len(lights), LAMP)
    if not lights:
        return lamps, 1.0
    corners = canvas_corners(asset)
    positions = np.array([light.position_mm for light in lights], dtype=np.float64)
    intensities = np.array(
        [light.intensity * np.asarray(light.colour, dtype=np.float64) for light in lights]
    )
    nearest = np.clip(positions, corners.min(axis=0), corners.max(axis=0))
    distance_m = np.maximum(np.linalg.norm(positions - nearest, axis=-1) * 1e-3, 1e-3)
    brightest = float((intensities.max(axis=1) / distance_m**2).sum())
    scale = float(2.0 ** np.ceil(np.log2(brightest))) if brightest > 0 else 1.0
    lamps["position"] = positions
    lamps["radiant_intensity"] = intensities * (1e6 / scale)  # the shaders' r is in mm
    return lamps, scale


def pack_whole_box(asset: Asset) -> NDArray[np.void]:
    """Pack one opaque box around the whole field."""
    bottom, top = height_range(asset)
    rows, columns = asset.heights_mm.shape
    return _pack(
        asset.spacing_mm,
        np.zeros((1, 2)),
        np.array([[columns - 1.0, rows - 1.0]]),
        np.array([bottom]),
        np.array([top]),
        np.ones(1, np.float32),
    )


def drawn_alphas(
    asset: Asset, tops_mm: NDArray[np.floating], view: View, adaptive: Adaptive | None
) -> NDArray[np.float32]:
    """Return the opacity of each box in this view, (N,); 0 where nothing rises above d0.

    Parameters
    ----------
    tops_mm
        (N,) from :func:`box_tops`.
    adaptive
        None makes all boxes opaque.
    """
    boxes = asset.boxes
    if adaptive is None:
        alpha = np.ones(len(boxes), np.float32)
    else:
        alpha = box_alphas(boxes, asset.spacing_mm, view, adaptive)
    return np.where(tops_mm > boxes.d0_mm, alpha, np.float32(0))


def pack_boxes(
    asset: Asset, tops_mm: NDArray[np.floating], alpha: NDArray[np.float32], view: View
) -> NDArray[np.void]:
    """Pack the boxes to draw: the opaque ones, then the blended ones from far to near."""
    boxes = asset.boxes
    drawn = alpha > 0
    listed = _pack(
        asset.spacing_mm,
        boxes.position[drawn].astype(np.float64),
        boxes.size[drawn].astype(np.float64),
        np.full(np.count_nonzero(drawn), boxes.d0_mm),
        tops_mm[drawn],
        alpha[drawn],
    )
    centre = (listed["low"] + listed["high"]) / 2
    distance = np.linalg.norm(centre - view.camera.centre_mm, axis=-1)
    return listed[np.lexsort((-distance, listed["alpha"] < 1))]


def opaque_patches(asset: Asset, alpha: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Mark with 255 the patches, by their first sample, that lie in an opaque box."""
    marked = np.zeros(asset.heights_mm.shape, np.uint8)
    opaque = alpha == 1
    ends = asset.boxes.position + asset.boxes.size
    for (column, row), (last_column, last_row) in zip(
        asset.boxes.position[opaque], ends[opaque], strict=True
    ):
        marked[row:last_row, column:last_column] = 255
    return marked


def box_tops(asset: Asset) -> Array:
    """Return the highest surface in each box, its border samples included, (N,) mm."""
    valid = valid_samples(asset)
    tops = np.full(len(asset.boxes), -np.inf)
    ends = asset.boxes.position + asset.boxes.size
    for i, ((column, row), (last_column, last_row)) in enumerate(
        zip(asset.boxes.position, ends, strict=True)
    ):
        patch = np.s_[row : last_row + 1, column : last_column + 1]
        tops[i] = np.max(asset.heights_mm[patch], where=valid[patch], initial=-np.inf)
    return tops


def pack_bounds(asset: Asset) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
    """Return the highest and lowest heights of cells, (cells, 2) mm, and the levels, (count, 2).

    A level's row is its first cell and its cells per row; row 0 is unused. Infinities become
    numbers beyond all heights, for shaders need not know infinity.
    """
    from pipeline.geometry.maximum_mipmap import build_maximum_mipmap

    mipmap = build_maximum_mipmap(np.where(valid_samples(asset), asset.heights_mm, np.nan))
    return np.clip(mipmap.bounds, -_FAR, _FAR), mipmap.levels.astype(np.uint32)


def valid_samples(asset: Asset) -> NDArray[np.bool_]:
    """Return where the canvas has a height, (rows, columns)."""
    return asset.mask & np.isfinite(asset.heights_mm)


def height_range(asset: Asset) -> tuple[float, float]:
    """Return the canvas's lowest and highest height, mm; 0, 0 for an empty canvas."""
    inside = asset.heights_mm[valid_samples(asset)]
    return (float(inside.min()), float(inside.max())) if inside.size else (0.0, 0.0)


def _clip_from_camera(K: Array, size_px: tuple[int, int]) -> Array:
    """Return the (4, 4) projection: reversed depth, the far plane at infinity."""
    width, height = size_px
    matrix = np.zeros((4, 4))
    matrix[0, :3] = 2 * (K[0] + [0, 0, 0.5]) / width - [0, 0, 1]
    matrix[1, :3] = [0, 0, 1] - 2 * (K[1] + [0, 0, 0.5]) / height
    matrix[2, 3] = NEAR_MM
    matrix[3, 2] = 1
    return matrix


def _pack(
    spacing_mm: float,
    position: Array,
    size: Array,
    low_z: Array,
    high_z: NDArray[np.floating],
    alpha: NDArray[np.floating],
) -> NDArray[np.void]:
    """Pack boxes given in samples; a margin keeps plateaus at top and bottom inside."""
    end = position + size
    margin = 1e-3 * spacing_mm
    listed = np.zeros(len(position), BOX)
    listed["low"] = np.stack(
        [position[:, 0] * spacing_mm, -end[:, 1] * spacing_mm, low_z - margin], axis=-1
    )
    listed["high"] = np.stack(
        [end[:, 0] * spacing_mm, -position[:, 1] * spacing_mm, high_z + margin], axis=-1
    )
    listed["alpha"] = alpha
    return listed
