"""Frames of one sequence become projector coordinates, whatever patterns they show."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import ImpastoError
from pipeline.formats.bundle import Bundle
from pipeline.formats.capture import Sequence
from pipeline.structured_light.coordinates import ProjectorCoordinates
from pipeline.structured_light.frames import FrameReader, exposure
from pipeline.structured_light.fringes import Fringes, frame_gains, solve_fringes
from pipeline.structured_light.gray import bit_score, cells
from pipeline.structured_light.noise import NoiseModel, noise_model
from pipeline.structured_light.plan import AxisPlan, PhaseGroup, Plan, make_plan
from pipeline.structured_light.unwrap import (
    repair_jumps,
    unwrap_by_cells,
    unwrap_by_periods,
    wrapped_coordinate,
)

Image = NDArray[np.float32]

LARGEST_PHASE_SIGMA = 0.2
"""Radians; a less certain phase is not light from the projector but noise."""

WORST_CHI2 = 30.0
"""Reduced residual, relative to the picture's median, beyond which steps contradict each other."""

LEAST_GRAY_SCORE = 0.12
"""Without phase, a pixel whose weakest bit is less sure than this is left out."""

_SIGMA_FLOOR_PX = 0.01


def decode_sequence(
    bundle: Bundle,
    sequence: Sequence,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> ProjectorCoordinates:
    """Decode a sequence of any patterns and exposures.

    Raises
    ------
    ImpastoError
        The bundle has no projector, the patterns are not enough, or no pixel could be decoded.
    """
    if bundle.capture.projector is None:
        raise ImpastoError("a projector is needed to decode", where="capture.json: projector")
    size_px = bundle.capture.projector.size_px
    plan = make_plan(sequence, size_px)
    reader = FrameReader(bundle, sequence.frames, progress)
    noise = noise_model(bundle.capture.cameras[sequence.camera], reader.stored_bits)
    decoder = _Decoder(plan, reader, noise)
    axes = {
        name: decoder.axis(name, axis, size_px[0] if name == "x" else size_px[1])
        for name, axis in sorted(plan.axes.items())
    }
    if not any(np.isfinite(coordinate).any() for coordinate, _ in axes.values()):
        raise ImpastoError(
            "no pixel shows the patterns",
            where=plan.where,
            expected="frames that are neither black nor saturated, in the order they were shown",
        )
    radiance, source = decoder.radiance()
    x, sigma_x = axes.get("x", (None, None))
    y, sigma_y = axes.get("y", (None, None))
    return ProjectorCoordinates(
        x, y, sigma_x, sigma_y, radiance, source, dict(sorted(decoder.statistics.items()))
    )


class _Decoder:
    """What the axes of one sequence share: plain light, fringes, and the figures to report."""

    def __init__(self, plan: Plan, reader: FrameReader, noise: NoiseModel) -> None:
        self.plan, self.reader, self.noise = plan, reader, noise
        self.statistics: dict[str, float] = {}
        self.white = reader.light(plan.white, noise)
        self.black = reader.light(plan.black, noise)
        self.fringes: Fringes | None = None
        self.lit: Image | None = None

    def radiance(self) -> tuple[Image, str]:
        """Return the projector's light alone, and where it was taken from."""
        if self.white is not None:
            dark = 0.0 if self.black is None else self.black
            return np.maximum(self.white - dark, 0).astype(np.float32), "white"
        if self.fringes is not None:
            return 2 * self.fringes.amplitude, "fringes"
        assert self.lit is not None  # a Gray code without white frames has inverted ones
        return self.lit, "white"

    def axis(self, name: str, axis: AxisPlan, size_px: int) -> tuple[Image, Image]:
        """Decode one axis: the coordinate and its standard deviation, px."""
        periods = sorted(axis.phases)
        groups = [self._fringes(name, axis.phases[period]) for period in periods]
        if groups and self.fringes is None:
            self.fringes = groups[0]
        if not groups:
            return self._by_gray_alone(axis, size_px)
        finest, period = groups[0], periods[0]
        wrapped = [wrapped_coordinate(g.phase, p) for g, p in zip(groups, periods, strict=True)]
        sigmas = [
            np.hypot(g.sigma * np.float32(p / (2 * math.pi)), np.float32(_SIGMA_FLOOR_PX))
            for g, p in zip(groups, periods, strict=True)
        ]
        if axis.bits:
            cell, doubt, neighbour = self._cells(axis, finest)
            coordinate, away = unwrap_by_cells(
                wrapped[0], period, cell, doubt, neighbour, axis.cell_px, size_px
            )
            sigma = sigmas[0]
            # Phase and Gray code may differ by the half cell that the code leaves open, no more.
            reach = 0.5 * axis.cell_px + max(2.0, 0.15 * axis.cell_px)
            known = np.isfinite(coordinate) & (finest.sigma < LARGEST_PHASE_SIGMA)
            self.statistics[f"share_agree_{name}"] = float(np.mean(away[known] <= reach))
            coordinate[~(away <= max(reach, 0.35 * period))] = np.nan
        else:
            coordinate, sigma = unwrap_by_periods(
                np.stack(wrapped), np.stack(sigmas), np.array(periods, dtype=np.float64), size_px
            )
        certain = finest.sigma < LARGEST_PHASE_SIGMA
        usual = np.nanmedian(finest.chi2[certain]) if np.isfinite(finest.chi2[certain]).any() else 1
        certain &= ~(finest.chi2 > WORST_CHI2 * usual)
        coordinate[~certain] = np.nan
        coordinate, shifted = repair_jumps(coordinate, period)
        self.statistics[f"jumps_repaired_{name}"] = shifted
        return coordinate, np.where(np.isfinite(coordinate), sigma, np.nan).astype(np.float32)

    def _fringes(self, name: str, group: PhaseGroup) -> Fringes:
        """Solve one period, each exposure's frames with their own brightness."""
        stack = self.reader.stack(group.frames)
        shifts = np.array(group.shifts)
        light = np.array([exposure(frame) for frame in group.frames])
        uneven = 0.0
        for seconds in np.unique(light):
            same = light == seconds
            gains = frame_gains(stack[same], shifts[same], self.reader.full_scale)
            uneven = max(uneven, float(np.abs(gains - 1).max()))
            light[same] *= gains
        key = f"frame_brightness_spread_{name}"
        self.statistics[key] = max(self.statistics.get(key, 0.0), uneven)
        fringes = solve_fringes(stack, shifts, light, self.reader.full_scale, self.noise)
        return _rescaled(fringes, self.noise)

    def _by_gray_alone(self, axis: AxisPlan, size_px: int) -> tuple[Image, Image]:
        cell, doubt, _ = self._cells(axis, None)
        coordinate = (cell * axis.cell_px + 0.5 * (axis.cell_px - 1)).astype(np.float32)
        coordinate[(doubt < LEAST_GRAY_SCORE) | (coordinate > size_px)] = np.nan
        sigma = np.full(cell.shape, axis.cell_px / math.sqrt(12), np.float32)
        return coordinate, np.where(np.isfinite(coordinate), sigma, np.nan).astype(np.float32)

    def _cells(
        self, axis: AxisPlan, fringes: Fringes | None
    ) -> tuple[NDArray[np.int32], Image, NDArray[np.int32]]:
        """Decide the bits, one at a time so that no more than two images of light are held."""
        scores = []
        for bit in range(axis.bits):
            plain = self.reader.brightest(axis.plain.get(bit, []))
            inverted = self.reader.brightest(axis.inverted.get(bit, []))
            dark, bright = self._levels(plain, inverted, fringes)
            self.lit = bright if self.lit is None else np.maximum(self.lit, bright)
            scores.append(bit_score(plain, inverted, dark, bright))
        return cells(np.stack(scores))

    def _levels(
        self, plain: Image | None, inverted: Image | None, fringes: Fringes | None
    ) -> tuple[Image, Image]:
        """Return light without and with the projector's, from the best source there is."""
        if self.white is not None and self.black is not None:
            return self.black, self.white
        if plain is not None and inverted is not None:
            return np.minimum(plain, inverted), np.maximum(plain, inverted)
        assert fringes is not None  # the plan was checked
        return fringes.offset - fringes.amplitude, fringes.offset + fringes.amplitude


def _rescaled(fringes: Fringes, noise: NoiseModel) -> Fringes:
    """Scale the standard deviations by the residuals where the noise model was only assumed."""
    seen = np.isfinite(fringes.chi2) & (fringes.sigma < LARGEST_PHASE_SIGMA)
    if not seen.any():
        return fringes
    scale = math.sqrt(float(np.mean(np.minimum(fringes.chi2[seen], WORST_CHI2))))
    if noise.given:
        scale = max(scale, 1.0)
    sigma = (fringes.sigma * np.float32(scale)).astype(np.float32)
    return Fringes(fringes.phase, sigma, fringes.amplitude, fringes.offset, fringes.chi2)
