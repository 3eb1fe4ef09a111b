"""A synthetic painting with known truth: a landscape in thick paint, in a wooden frame.

Everything is drawn on one fine grid, row 0 at the top, from a seeded generator: heights, colours
and gloss. The canvas frame is x right, y up, z out of the paint, its origin at the canvas's centre.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from hardware.simulated import motif
from hardware.simulated.brush import Layers, Map, Strokes, lay
from hardware.simulated.motif import CANVAS_MM

FRAME_WIDTH_MM, FRAME_TOP_MM, FRAME_LIP_MM = 11.0, 6.0, 1.5
"""The frame, its height above the canvas, and how far it reaches over the canvas's edges."""

WALL_MM = 30.0
"""The frame's outer side goes this far down, through the table that it lies on."""

HIGHEST_MM = 2.5
_WEAVE_MM, _THREAD_MM, _RIDGE_MM = 0.03, 1.1, 0.8
_POINTS = 9

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Painting:
    """The canvas in its frame as one height field; arrays (rows, columns) or (rows, columns, 3).

    Parameters
    ----------
    spacing_mm
        Of the grid; sample (row, column) lies at x = left_mm + column spacing, y = top_mm - row
        spacing.
    heights_mm
        float32, above the canvas.
    normals
        float32 unit normals.
    diffuse, specular
        float32 rho_d, rho_s, RGB, 1/sr.
    lobe
        float32 C_xy, C_z, k: f = rho_d + rho_s max(0, C_xy (v_x l_x + v_y l_y) + C_z v_z l_z)^k.
    canvas
        True where the canvas is to be seen, False on the frame.
    """

    spacing_mm: float
    left_mm: float
    top_mm: float
    heights_mm: Map
    normals: Map
    diffuse: Map
    specular: Map
    lobe: Map
    canvas: NDArray[np.bool_]

    @property
    def x_mm(self) -> Array:
        """Of the columns."""
        return np.asarray(self.left_mm + self.spacing_mm * np.arange(self.canvas.shape[1]))

    @property
    def y_mm(self) -> Array:
        """Of the rows, descending."""
        return np.asarray(self.top_mm - self.spacing_mm * np.arange(self.canvas.shape[0]))


def paint(seed: int = 1, spacing_mm: float = 0.2) -> Painting:
    """Paint the picture; every seed lays other strokes.

    Parameters
    ----------
    spacing_mm
        Of the grid, 0.1 to 1.
    """
    half = CANVAS_MM[0] / 2, CANVAS_MM[1] / 2
    rim = np.ceil((FRAME_WIDTH_MM + 1) / spacing_mm) * spacing_mm
    left, top = -half[0] - rim, half[1] + rim
    columns, rows = (round(2 * side / spacing_mm) + 1 for side in (-left, top))
    x, y = np.meshgrid(left + spacing_mm * np.arange(columns), top - spacing_mm * np.arange(rows))

    random = np.random.default_rng(seed)
    layers = _primed_canvas(x, y)
    for strokes in _sessions(random, spacing_mm, left, top):
        lay(layers, strokes)
    relief = cv2.GaussianBlur(layers.relief, (0, 0), 0.25 / spacing_mm).astype(np.float64)
    relief = HIGHEST_MM * np.tanh(relief / HIGHEST_MM)

    # The threads show where the paint is thin.
    thread = np.sin(np.pi * x / _THREAD_MM) ** 2 + np.sin(np.pi * y / _THREAD_MM) ** 2
    heights = relief + (thread - 1) * _WEAVE_MM / 2 * np.exp(-relief / 0.5)
    out = np.maximum(np.abs(x) - half[0], np.abs(y) - half[1]) + FRAME_LIP_MM
    wood = out > 0
    heights = np.where(wood, _moulding(out), heights)

    colour = np.clip(np.where(wood[..., None], _wood(x, y, out), layers.colour), 0.015, 0.88)
    gloss = np.where(wood, 0.3, np.clip(layers.gloss, 0, 1)).astype(np.float64)
    # Glossier paint has a narrower lobe, in the mirror direction.
    lobe = np.stack([-np.ones_like(x), np.ones_like(x), 5 + 55 * gloss**1.5], axis=-1)
    down, right = np.gradient(heights, spacing_mm)
    normals = np.stack([-right, down, np.ones_like(down)], axis=-1)
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    return Painting(
        spacing_mm,
        left,
        top,
        heights.astype(np.float32),
        normals.astype(np.float32),
        (colour / np.pi).astype(np.float32),
        np.repeat((0.5 * gloss**1.5)[..., None], 3, axis=2).astype(np.float32),
        lobe.astype(np.float32),
        ~wood,
    )


def _primed_canvas(x: Array, y: Array) -> Layers:
    """Return a thin underpainting of the whole motif."""
    seen = motif.look_at(x, y)
    ground = 0.35 * seen.colour + 0.65 * motif.pigment("a8845c")
    glaze = seen.region == motif.LAKE
    ground[glaze] = seen.colour[glaze]
    # The lake is a smooth glaze over bare canvas.
    gloss = np.where(glaze, 0.85, 0.1)
    return Layers(
        np.full(x.shape, 0.04, np.float32), ground.astype(np.float32), gloss.astype(np.float32)
    )


def _sessions(
    random: np.random.Generator, spacing_mm: float, left: float, top: float
) -> list[Strokes]:
    """Return the strokes of each session, from broad and thin to small and thick."""
    broad = _scatter(random, 5.0, 3.2, 0.10, length=(10, 14))
    middle = _scatter(random, 2.5, 1.5, 0.26, length=(7, 13))
    small = _scatter(random, 2.2, 1.0, 0.45, length=(4, 9))
    dabs = _dabs(random)
    return [
        _trace(random, *session, spacing_mm, left, top) for session in (broad, middle, small, dabs)
    ]


# Thickness and gloss of a region's paint, relative; strokes leave the lake's glaze alone.
_LOAD = {
    motif.SKY: (0.8, 0.35),
    motif.SUN_DISC: (2.6, 0.55),
    motif.FAR: (0.3, 0.06),
    motif.LAKE: (0.12, 0.85),
    motif.HILL: (0.8, 0.15),
    motif.FIELD: (1.5, 0.30),
    motif.CYPRESS: (1.6, 0.5),
    motif.HOUSE: (0.7, 0.05),
    motif.ROOF: (1.1, 0.2),
}

Session = tuple[Array, Array, Array, Array, Array, Array]


def _scatter(
    random: np.random.Generator,
    pitch_mm: float,
    half_mm: float,
    thick_mm: float,
    *,
    length: tuple[int, int],
) -> Session:
    """Scatter strokes over the canvas: start, half width, thickness, colour, gloss, length."""
    width, height = CANVAS_MM
    x, y = np.meshgrid(
        np.arange(-width / 2, width / 2 + pitch_mm, pitch_mm),
        np.arange(-height / 2, height / 2 + pitch_mm, pitch_mm),
    )
    start = np.stack([x.ravel(), y.ravel()], axis=1)
    start += random.uniform(-0.5, 0.5, start.shape) * pitch_mm
    random.shuffle(start)
    seen = motif.look_at(start[:, 0], start[:, 1])
    count = len(start)
    load, gloss = (np.array([_LOAD[r][i] for r in seen.region.tolist()]) for i in (0, 1))
    colour = seen.colour * random.normal(1, 0.10, (count, 1)) + random.normal(0, 0.02, (count, 3))
    # The lake is left alone, but for a few strokes.
    keep = (seen.region != motif.LAKE) | (random.uniform(size=count) < 0.15)
    session = (
        start,
        half_mm * random.uniform(0.75, 1.3, count),
        thick_mm * load * random.gamma(4.0, 0.25, count),
        np.clip(colour, 0.01, 0.9),
        np.clip(gloss + random.normal(0, 0.05, count), 0.02, 1.0),
        random.uniform(*length, count),
    )
    return tuple(part[keep] for part in session)


def _dabs(random: np.random.Generator) -> Session:
    """Return the last touches: poppies in the field, stars of light on the lake, the sun's rays."""
    poppies = np.stack([random.uniform(-78, 78, 90), random.uniform(-58, -33, 90)], axis=1)
    red = motif.pigment("d8321e") * random.uniform(0.8, 1.15, (90, 1))
    sparks = np.stack([random.normal(36, 4.5, 26), random.uniform(-12, -9, 26)], axis=1)
    gold = np.repeat(motif.pigment("fde9b0")[None], 26, axis=0)
    angle = np.arange(22) * 2 * np.pi / 22 + random.normal(0, 0.05, 22)
    away = random.uniform(12, 24, 22)
    rays = np.stack([motif.SUN[0] + away * np.cos(angle), motif.SUN[1] + away * np.sin(angle)], 1)
    cream = np.repeat(motif.pigment("fcdf8a")[None], 22, axis=0)
    dabs = (
        np.concatenate([poppies, sparks, rays]),
        np.concatenate([random.uniform(0.9, 1.6, 90), np.full(26, 0.55), np.full(22, 0.8)]),
        np.concatenate([random.uniform(0.9, 1.8, 90), np.full(26, 0.5), np.full(22, 0.8)]),
        np.clip(np.concatenate([red, gold, cream]), 0.01, 0.9),
        np.full(90 + 26 + 22, 0.45),
        np.concatenate([np.full(90, 1.8), np.full(26, 2.2), np.full(22, 5.0)]),
    )
    # Poppies grow in the field only, and light falls on the lake.
    wanted = np.repeat([motif.FIELD, motif.LAKE, motif.SKY], [90, 26, 22])
    keep = motif.look_at(dabs[0][:, 0], dabs[0][:, 1]).region == wanted
    return tuple(part[keep] for part in dabs)


def _trace(
    random: np.random.Generator,
    start: Array,
    half_mm: Array,
    thickness: Array,
    colour: Array,
    gloss: Array,
    length_mm: Array,
    spacing_mm: float,
    left: float,
    top: float,
) -> Strokes:
    """Draw each stroke along the motif's flow, and give it its bristles."""
    count = len(start)
    step = (length_mm / (_POINTS - 1))[:, None]
    lean = random.normal(0, 0.12, count)
    place, path = start.copy(), [start.copy()]
    heading = np.zeros((count, 2))
    for _ in range(_POINTS - 1):
        angle = motif.look_at(place[:, 0], place[:, 1]).flow + lean
        ahead = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        # A flow has no sign: go on as before, and turn no faster than a brush does.
        ahead *= np.where((ahead * heading).sum(axis=1, keepdims=True) < 0, -1, 1)
        heading = 0.5 * heading + 0.5 * ahead
        heading /= np.linalg.norm(heading, axis=1, keepdims=True)
        place = place + heading * step
        path.append(place.copy())
    along = np.stack(path, axis=1)
    samples = np.stack([along[..., 0] - left, top - along[..., 1]], axis=-1) / spacing_mm
    waves = random.uniform(3, 5, (count, 3)) * np.array([1.0, 2.1, 3.4])
    # No ridge is narrower than a bristle with its paint.
    waves = np.minimum(waves, 2 * np.pi * half_mm[:, None] / _RIDGE_MM)
    phases = random.uniform(0, 2 * np.pi, (count, 3))
    return Strokes(
        samples, half_mm / spacing_mm, thickness, colour, gloss, np.hstack([waves, phases])
    )


def _moulding(out: Array) -> Array:
    """Return the height of the frame by the distance from its inner edge."""
    width = FRAME_WIDTH_MM + FRAME_LIP_MM
    across = np.clip(out / width, 0, 1)
    profile = FRAME_TOP_MM * (0.45 + 0.55 * np.sin(np.pi * np.clip(across * 1.1, 0, 1)) ** 0.7)
    profile -= 0.8 * np.exp(-(((across - 0.22) / 0.05) ** 2))
    return np.asarray(np.where(out > width, -WALL_MM, profile))


def _wood(x: Array, y: Array, out: Array) -> Array:
    """Return the frame's albedo: grain along its sides, mitred at the corners."""
    upright = np.abs(x) - CANVAS_MM[0] / 2 > np.abs(y) - CANVAS_MM[1] / 2
    along, across = np.where(upright, y, x), np.where(upright, x, y)
    grain = np.sin(2.6 * across + 1.6 * np.sin(0.07 * along) + 0.6 * np.sin(0.31 * along))
    shade = 0.82 + 0.12 * grain + 0.06 * np.sin(11 * across + 0.2 * along)
    gilt = np.exp(-(((out - 0.9) / 0.8) ** 2))[..., None]
    tone = shade[..., None] * motif.pigment("7a4a26")
    return np.asarray((1 - gilt) * tone + gilt * motif.pigment("c79a45"))
