"""A synthetic painting with known truth: a landscape in strokes of paint, in a wooden frame.

Everything is drawn on one fine grid, row 0 at the top, from a seeded generator: heights, colours
and gloss. The canvas frame is x right, y up, z out of the paint, its origin at the canvas's centre.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Map = NDArray[np.float32]

CANVAS_MM = (160.0, 120.0)
FRAME_WIDTH_MM, FRAME_HEIGHT_MM = 12.0, 9.0
BASE_MM = 8.0
"""Height of the canvas above the table."""

TABLE_MARGIN_MM = 30.0


@dataclass(frozen=True)
class Scene:
    """The painting on its table as one height field; arrays (rows, columns) or (.., 3).

    Parameters
    ----------
    spacing_mm
        Of the grid; sample (row, column) lies at x = (column - centre) spacing, y = (centre - row)
        spacing.
    heights_mm
        Above the table.
    diffuse, specular
        rho_d, rho_s, RGB, 1/sr.
    lobe
        C_xy, C_z, k.
    canvas
        True on the canvas, False on frame and table.
    """

    spacing_mm: float
    heights_mm: Map
    diffuse: Map
    specular: Map
    lobe: Map
    canvas: NDArray[np.bool_]

    @property
    def size_mm(self) -> tuple[float, float]:
        """Width and height between the outermost samples."""
        rows, columns = self.heights_mm.shape
        return (columns - 1) * self.spacing_mm, (rows - 1) * self.spacing_mm


def paint(seed: int = 1, spacing_mm: float = 0.25) -> Scene:
    """Paint the picture."""
    random = np.random.default_rng(seed)
    width, height = (
        round((side + 2 * (FRAME_WIDTH_MM + TABLE_MARGIN_MM)) / spacing_mm) + 1
        for side in CANVAS_MM
    )
    x, y = np.meshgrid(
        (np.arange(width) - (width - 1) / 2) * spacing_mm,
        ((height - 1) / 2 - np.arange(height)) * spacing_mm,
    )
    inside = (np.abs(x) <= CANVAS_MM[0] / 2) & (np.abs(y) <= CANVAS_MM[1] / 2)
    out = np.maximum(np.abs(x) - CANVAS_MM[0] / 2, np.abs(y) - CANVAS_MM[1] / 2)
    in_frame = (out > 0) & (out <= FRAME_WIDTH_MM)

    relief, colour, gloss = _strokes(random, x, y, spacing_mm)
    weave = 0.015 * (np.sin(2 * np.pi * x / 1.3) + np.sin(2 * np.pi * y / 1.3))
    profile = FRAME_HEIGHT_MM * np.sin(np.clip(out / FRAME_WIDTH_MM, 0, 1) * np.pi) ** 0.5
    heights = np.where(inside, BASE_MM + relief + weave, 0.0)
    heights = np.where(in_frame, BASE_MM + profile, heights)

    grain = 0.75 + 0.25 * np.sin(2.2 * x + 3 * np.sin(0.31 * y))
    wood = grain[..., None] * np.array([0.36, 0.21, 0.10])
    albedo = np.where(inside[..., None], colour, np.where(in_frame[..., None], wood, 0.04))
    shine = np.where(inside, gloss, 0.05 * in_frame)
    # Glossier paint has a narrower lobe; the mirror-like direction throughout.
    sharpness = np.where(inside, 6 + 50 * gloss, 8.0)
    lobe = np.stack([-np.ones_like(x), np.ones_like(x), sharpness], axis=-1)
    return Scene(
        spacing_mm,
        heights.astype(np.float32),
        (albedo / np.pi).astype(np.float32),
        np.repeat(0.35 * shine[..., None], 3, axis=2).astype(np.float32),
        lobe.astype(np.float32),
        inside,
    )


def _strokes(
    random: np.random.Generator, x: Map, y: Map, spacing_mm: float
) -> tuple[Map, Map, Map]:
    """Lay strokes over an underpainting; return relief (mm), albedo (RGB), gloss (0..1)."""
    shape = x.shape
    colour = _landscape(x, y)
    relief = np.zeros(shape, np.float32)
    gloss = np.full(shape, 0.25, np.float32)
    inside_x, inside_y = CANVAS_MM[0] / 2, CANVAS_MM[1] / 2
    for _ in range(900):
        cx, cy = random.uniform(-inside_x, inside_x), random.uniform(-inside_y, inside_y)
        length, half = random.uniform(3, 14), random.uniform(0.7, 2.4)
        # Strokes follow the land: level in the sky, along the hills, about the sun.
        angle = 0.25 * np.sin(cx / 24) + random.normal(0, 0.25)
        if np.hypot(cx - 38, cy - 28) < 24:
            angle = np.arctan2(cy - 28, cx - 38) + np.pi / 2
        thick = random.gamma(2.0, 0.13) * (2.0 if cy < -8 or np.hypot(cx - 38, cy - 28) < 14 else 1)
        _stroke(
            (relief, colour, gloss),
            (x, y),
            spacing_mm,
            (cx, cy, angle, length, half, min(thick, 1.2)),
            random,
        )
    return np.minimum(cv2.GaussianBlur(relief, (0, 0), 0.35 / spacing_mm), 3.0), np.clip(colour, 0.02, 0.9), gloss


def _stroke(
    maps: tuple[Map, Map, Map],
    grid: tuple[Map, Map],
    spacing_mm: float,
    stroke: tuple[float, ...],
    random: np.random.Generator,
) -> None:
    """Lay one stroke, in place: its ridges of bristles, its colour, its gloss."""
    cx, cy, angle, length, half, thick = stroke
    reach = int((length / 2 + half) / spacing_mm) + 2
    column = int(np.argmin(np.abs(grid[0][0] - cx)))
    row = int(np.argmin(np.abs(grid[1][:, 0] - cy)))
    part = (
        slice(max(row - reach, 0), row + reach + 1),
        slice(max(column - reach, 0), column + reach + 1),
    )
    dx, dy = grid[0][part] - cx, grid[1][part] - cy
    along = np.cos(angle) * dx + np.sin(angle) * dy
    across = -np.sin(angle) * dx + np.cos(angle) * dy
    away = np.hypot(np.maximum(np.abs(along) - length / 2, 0), across) / half
    body = np.clip(1.25 - away**2, 0, 1) * (away < 1)
    phase, pitch = random.uniform(0, 6), random.uniform(0.5, 0.9)
    bristles = 0.7 + 0.3 * np.sin(2 * np.pi * across / pitch + phase)
    relief, colour, gloss = maps
    relief[part] += (thick * (body * bristles - 0.25 * relief[part] * (body > 0))).astype(
        np.float32
    )
    tint = colour[row, column] * random.uniform(0.8, 1.2) + random.normal(0, 0.02, 3)
    cover = np.clip(3 * body, 0, 1)[..., None]
    colour[part] = colour[part] * (1 - cover) + cover * tint
    gloss[part] = np.where(body > 0.3, np.clip(thick, 0.05, 1.0), gloss[part])


def _landscape(x: Map, y: Map) -> Map:
    """Return the underpainting's albedo: evening sky, a sun, hills, a river."""
    up = np.clip((y + 10) / 70, 0, 1)[..., None]
    sky = (1 - up) * np.array([0.86, 0.55, 0.30]) + up * np.array([0.16, 0.30, 0.62])
    colour = np.broadcast_to(sky, (*x.shape, 3)).copy()
    sun = np.exp(-(((x - 38) ** 2 + (y - 28) ** 2) / 90))[..., None]
    colour = colour * (1 - sun) + sun * np.array([0.88, 0.80, 0.42])
    colour[np.hypot(x - 38, y - 28) < 8] = (0.88, 0.84, 0.60)
    for level, swing, shift, tone in (
        (0, 9, 0.0, (0.30, 0.30, 0.48)),
        (-9, 8, 1.7, (0.16, 0.30, 0.26)),
        (-24, 7, 3.1, (0.20, 0.36, 0.12)),
        (-42, 5, 4.4, (0.11, 0.20, 0.07)),
    ):
        crest = level + swing * np.sin(x / 21 + shift) + 0.3 * swing * np.sin(x / 7.3 + 2 * shift)
        colour[y < crest] = tone
    river = np.abs(x + 18 + 14 * np.sin(y / 13)) < 2 + (-(y + 24)) * 0.14
    colour[river & (y < -24)] = (0.42, 0.50, 0.56)
    colour[(np.abs(x + 52) < 3.2) & (np.abs(y + 16) < 4)] = (0.62, 0.16, 0.10)
    colour[(np.abs(x + 52) < 3.2) & (np.abs(y + 13) < 1.4)] = (0.04, 0.03, 0.03)
    return colour.astype(np.float32)
