"""The exact CPU reference: every ray meets the bilinear surface itself, in float64.

What the GPU painter draws is held against this. It is also what is drawn where there is no adapter.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.asset import Asset
from pipeline.geometry.camera import Camera
from pipeline.geometry.height_grid import sample_bilinear
from pipeline.geometry.raycast import RayCaster
from renderers.packing import SHADOW_MARGIN
from renderers.shading import reflectance, unit_normals
from renderers.view import Light, View

Array = NDArray[np.float64]

_ROWS_AT_ONCE = 128


def render_reference(
    asset: Asset,
    view: View,
    lights: Sequence[Light],
    *,
    samples: int = 1,
    shadows: bool = True,
) -> NDArray[np.float32]:
    """Draw the asset.

    Parameters
    ----------
    samples
        Rays per pixel, a square number, on a regular grid inside it.
    shadows
        Whether the relief casts shadows on itself.

    Returns
    -------
    (h, w, 4) float32 linear RGB radiance, premultiplied by the coverage in the last channel.
    """
    side = round(samples**0.5)
    caster, heights = _caster(asset)
    width, height = view.size_px
    image = np.zeros((height, width, 4))
    offsets = (np.arange(side) + 0.5) / side - 0.5
    for top in range(0, height, _ROWS_AT_ONCE):
        rows = np.arange(top, min(top + _ROWS_AT_ONCE, height), dtype=np.float64)
        for dy in offsets:
            for dx in offsets:
                pixels = np.stack(np.meshgrid(np.arange(width) + dx, rows + dy), axis=-1)
                image[top : top + len(rows)] += _shade(
                    asset, caster, heights, view.camera, lights, pixels, shadows
                )
    mean: NDArray[np.float32] = (image / side**2).astype(np.float32)
    return mean


def reference_depth(asset: Asset, view: View) -> Array:
    """Return the camera-frame z (h, w) of the surface at the pixels' centres, mm; inf: none."""
    caster, _ = _caster(asset)
    distance, _, _ = _meet(caster, view.camera, view.camera.lens.pixel_grid())
    return distance


def _caster(asset: Asset) -> tuple[RayCaster, NDArray[np.float32]]:
    heights = np.where(asset.mask, asset.heights_mm, np.nan).astype(np.float32)
    return RayCaster(heights, asset.spacing_mm), heights


def _meet(caster: RayCaster, camera: Camera, pixels: Array) -> tuple[Array, Array, Array]:
    """Return distances in camera z (inf: miss), the rays' origin and directions."""
    origin, directions = camera.rays(pixels)
    flat = np.ascontiguousarray(directions.reshape(-1, 3))
    origins = np.ascontiguousarray(np.broadcast_to(origin, flat.shape))
    distance = caster.first_hit(origins, flat)
    return distance.reshape(directions.shape[:-1]), origin, directions


def _shade(
    asset: Asset,
    caster: RayCaster,
    heights: NDArray[np.float32],
    camera: Camera,
    lights: Sequence[Light],
    pixels: Array,
    shadows: bool,
) -> Array:
    """Return radiance and coverage (rows, columns, 4) of one ray per pixel."""
    distance, origin, directions = _meet(caster, camera, pixels)
    hit = np.isfinite(distance)
    result = np.zeros((*hit.shape, 4))
    if not hit.any():
        return result
    points = origin + directions[hit] * distance[hit][:, None]
    last_row, last_column = (size - 1 for size in heights.shape)
    columns = np.clip(points[:, 0] / asset.spacing_mm, 0, last_column)
    rows = np.clip(-points[:, 1] / asset.spacing_mm, 0, last_row)
    normals = unit_normals(sample_bilinear(asset.normals, columns, rows))
    diffuse, specular, lobe = (
        sample_bilinear(image, columns, rows).astype(np.float64)
        for image in (asset.diffuse, asset.specular, asset.lobe)
    )
    to_eye = origin - points
    to_eye /= np.linalg.norm(to_eye, axis=1, keepdims=True)
    radiance = np.zeros((len(points), 3))
    for light in lights:
        to_light = light.position_mm - points
        length = np.linalg.norm(to_light, axis=1, keepdims=True)
        to_light /= length
        cosine = (to_light * normals).sum(axis=1)
        lit = cosine > 0
        if shadows and lit.any():
            targets = np.ascontiguousarray(np.broadcast_to(light.position_mm, points[lit].shape))
            margin = SHADOW_MARGIN * asset.spacing_mm
            lit[lit] = ~caster.occluded(points[lit], targets, margin)
        irradiance = np.where(lit, cosine, 0) / (length[:, 0] * 1e-3) ** 2
        brdf = reflectance(diffuse, specular, lobe, normals, to_eye, to_light)
        radiance += brdf * irradiance[:, None] * (light.intensity * light.colour)
    result[hit, :3] = radiance
    result[hit, 3] = 1
    return result
