"""Frames of one sequence become projector coordinates, whatever patterns they show."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import ImpastoError
from pipeline.formats.bundle import Bundle
from pipeline.formats.capture import Sequence
from pipeline.structured_light.circle import without_harmonic
from pipeline.structured_light.coordinates import ProjectorCoordinates
from pipeline.structured_light.frames import FrameReader, exposure
from pipeline.structured_light.fringes import Fringes, solve_fringes
from pipeline.structured_light.gains import (
    evenly_spread,
    frame_basis,
    measured_noise,
    nominal_basis,
    redundant,
)
from pipeline.structured_light.gray import bit_score, cells
from pipeline.structured_light.motion import shift_between
from pipeline.structured_light.noise import NoiseModel, excess, noise_model
from pipeline.structured_light.plan import AxisPlan, PhaseGroup, Plan, make_plan
from pipeline.structured_light.unwrap import (
    refine,
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

SURE_DIFFERENCE = 6.0
"""Standard deviations by which light and dark must differ where Gray code stands alone."""

MOST_STEPS_WITH_HARMONIC = 6
"""More steps mistake only harmonics that no projector shows."""

SYSTEMATIC = 0.002
"""Radians that no phase is better known than: the projector's own rounding."""


def decode_sequence(
    bundle: Bundle,
    sequence: Sequence,
    *,
    minimum_modulation: float = 0.3,
    progress: Callable[[int, int], None] | None = None,
) -> ProjectorCoordinates:
    """Decode a sequence of any patterns and exposures.

    Parameters
    ----------
    bundle, sequence
        The frames; ``bundle.capture.projector`` needs its size only.
    minimum_modulation
        Least contrast of the fringes, as a share of the picture's median. Light that reached a
        pixel by way of other surfaces has little, for they average fine patterns away (Nayar,
        Krishnan, Grossberg and Raskar 2006).
    progress
        Told how many frames of how many were read.

    Raises
    ------
    ImpastoError
        The bundle has no projector, the patterns are not enough, or no pixel could be decoded.
    """
    if bundle.capture.projector is None:
        raise ImpastoError("a projector is needed to decode", where="capture.json: projector")
    size_px = bundle.capture.projector.size_px
    plan = make_plan(sequence, size_px)
    with FrameReader(bundle, plan.frames(), progress) as reader:
        noise = noise_model(bundle.capture.cameras[sequence.camera], reader.stored_bits)
        decoder = _Decoder(plan, reader, noise, minimum_modulation)
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

    def __init__(
        self, plan: Plan, reader: FrameReader, noise: NoiseModel, minimum_modulation: float
    ) -> None:
        self.plan, self.reader, self.noise = plan, reader, noise
        self.minimum_modulation = minimum_modulation
        self.statistics: dict[str, float] = {
            f"bits_{name}": axis.bits for name, axis in plan.axes.items()
        }
        self.white = reader.light(plan.white, noise)
        self.black = reader.light(plan.black, noise)
        self.plain: Image | None = None
        if self.white is not None and self.black is not None:
            self.plain = self.white - self.black
        self.fringes: Fringes | None = None
        self.lit: Image | None = None
        self.still: Image | None = None

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
        if not groups:
            return self._by_gray_alone(axis, size_px)
        if self.fringes is None:
            self.fringes = groups[0]
        wrapped = [wrapped_coordinate(g.phase, p) for g, p in zip(groups, periods, strict=True)]
        sigmas = [
            np.hypot(g.sigma, np.float32(SYSTEMATIC)) * np.float32(p / (2 * math.pi))
            for g, p in zip(groups, periods, strict=True)
        ]
        certain = self._certain(groups)
        if axis.bits:
            longest = len(periods) - 1
            coordinate = self._by_cells(
                name, axis, groups[longest], wrapped[longest], certain, size_px
            )
            sigma = sigmas[longest]
            for i in reversed(range(longest)):
                coordinate, sigma = refine(coordinate, sigma, wrapped[i], sigmas[i], periods[i])
        else:
            coordinate, sigma = unwrap_by_periods(
                np.stack(wrapped), np.stack(sigmas), np.array(periods, dtype=np.float64), size_px
            )
            if certain.any():
                self.statistics[f"share_agree_{name}"] = float(
                    np.mean(np.isfinite(coordinate[certain]))
                )
            coordinate[~certain] = np.nan
        coordinate, shifted = repair_jumps(coordinate, periods[0])
        key = f"jumps_repaired_{name}"
        self.statistics[key] = self.statistics.get(key, 0) + shifted
        return coordinate, np.where(np.isfinite(coordinate), sigma, np.nan).astype(np.float32)

    def _fringes(self, name: str, group: PhaseGroup) -> Fringes:
        """Solve one period, each exposure's frames with their own brightness."""
        stack = self.reader.stack(group.frames)
        shifts = np.array(group.shifts)
        seconds = np.array([exposure(frame) for frame in group.frames])
        basis = nominal_basis(shifts)
        redundancy = 0
        for exposed in np.unique(seconds):
            same = seconds == exposed
            redundancy = max(redundancy, redundant(shifts[same]))
            basis[same] = frame_basis(stack[same], shifts[same], self.reader.full_scale, self.plain)
        turned = np.arctan2(-basis[:, 2], basis[:, 1]) - shifts
        self._note(f"redundant_steps_{name}", redundancy, max)
        self._note(f"frame_brightness_spread_{name}", float(np.abs(basis[:, 0] - 1).max()), max)
        self._note(f"frame_shift_rad_{name}", float(np.abs(np.sin(turned / 2)).max() * 2), max)
        noise = self.noise
        if not noise.given:
            found = measured_noise(stack, shifts, basis, seconds, self.reader.full_scale)
            noise = noise if found is None else found
        fringes = solve_fringes(stack, basis, seconds, self.reader.full_scale, noise)
        self._watch(name, fringes.offset)
        fringes = self._without_harmonic(name, fringes, shifts)
        self._note(f"share_steps_saturated_{name}", fringes.share_dropped, max)
        if redundancy > 0 and noise.given:
            # The given model leaves out what is not the sensor's: flicker, harmonics, vibration.
            lit = fringes.chi2[fringes.sigma < LARGEST_PHASE_SIGMA]
            scale = np.float32(max(excess(lit, len(shifts) - 3), 1.0))
            self._note(f"noise_excess_{name}", float(scale), max)
            fringes = replace(fringes, sigma=fringes.sigma * scale, chi2=fringes.chi2 / scale**2)
        return fringes

    def _without_harmonic(
        self, name: str, fringes: Fringes, shifts: NDArray[np.float64]
    ) -> Fringes:
        """Correct the projector's harmonic that evenly spread steps mistake for the fringe."""
        steps = evenly_spread(shifts)
        if not 3 <= steps <= MOST_STEPS_WITH_HARMONIC:
            return fringes
        found = without_harmonic(fringes, self.plain, steps)
        if found is None:
            return fringes
        self._note(f"harmonic_{name}", abs(found[1]), max)
        return replace(fringes, phase=found[0])

    def _watch(self, name: str, light: Image) -> None:
        """Note how far what is seen has moved since the first picture in even light."""
        if self.still is None:
            self.still = light if self.white is None else self.white
        if self.still is not light:
            self._note(f"motion_px_{name}", shift_between(self.still, light), max)

    def _note(self, key: str, value: float, merge: Callable[[float, float], float]) -> None:
        self.statistics[key] = (
            merge(self.statistics[key], value) if key in self.statistics else value
        )

    def _certain(self, groups: list[Fringes]) -> NDArray[np.bool_]:
        """Mask pixels whose phase is noise, contradicts itself, or is not the projector's light."""
        certain = np.ones(groups[0].phase.shape, np.bool_)
        for group in groups:
            certain &= group.sigma < LARGEST_PHASE_SIGMA
            certain &= ~(group.chi2 > WORST_CHI2)
        if self.minimum_modulation > 0 and certain.any():
            with np.errstate(invalid="ignore", divide="ignore"):
                if self.plain is not None:
                    contrast = 2 * groups[0].amplitude / self.plain
                else:
                    contrast = groups[0].amplitude / groups[0].offset
            usual = float(np.nanmedian(contrast[certain]))
            if math.isfinite(usual):
                certain &= ~(contrast < self.minimum_modulation * usual)
        return certain

    def _by_cells(
        self,
        name: str,
        axis: AxisPlan,
        fringes: Fringes,
        wrapped: Image,
        certain: NDArray[np.bool_],
        size_px: int,
    ) -> Image:
        """Unwrap the longest period by the Gray code; leave out where the two contradict."""
        period = max(axis.phases)
        cell, doubt, neighbour = self._cells(axis, fringes)
        coordinate, away = unwrap_by_cells(
            wrapped, period, cell, doubt, neighbour, axis.cell_px, size_px
        )
        # Phase and Gray code may differ by the half cell that the code leaves open, no more.
        reach = 0.5 * axis.cell_px + max(2.0, 0.15 * axis.cell_px)
        known = certain & np.isfinite(coordinate)
        self.statistics[f"share_agree_{name}"] = (
            float(np.mean(away[known] <= reach)) if known.any() else 0.0
        )
        coordinate[~(away <= max(reach, 0.35 * period)) | ~certain] = np.nan
        coordinate, shifted = repair_jumps(coordinate, period)
        self.statistics[f"jumps_repaired_{name}"] = shifted
        return coordinate

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
            plain = self.reader.light(axis.plain.get(bit, []), self.noise, at_least=True)
            inverted = self.reader.light(axis.inverted.get(bit, []), self.noise, at_least=True)
            dark, bright = self._levels(plain, inverted, fringes)
            self.lit = bright if self.lit is None else np.fmax(self.lit, bright)
            score = bit_score(plain, inverted, dark, bright)
            if fringes is None:  # then nothing else will tell that no pattern reaches a pixel
                score[~(bright - dark > self._faint(axis, bright))] = 0
            scores.append(score)
        return cells(np.stack(scores))

    def _faint(self, axis: AxisPlan, bright: Image) -> Image:
        """Return the difference of light that noise alone can make."""
        frames = [frame for group in (axis.plain, axis.inverted) for frame in group.get(0, [])]
        seconds = np.float32(max(exposure(frame) for frame in frames))
        variance = self.noise.shot * np.maximum(bright * seconds, 0) + self.noise.floor
        return np.asarray(SURE_DIFFERENCE * np.sqrt(2 * variance) / seconds)

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
