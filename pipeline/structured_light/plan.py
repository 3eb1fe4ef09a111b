"""A sequence's frames, sorted by what their patterns say."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from pipeline.errors import ImpastoError
from pipeline.formats.capture import Frame, Sequence
from pipeline.formats.patterns import Black, Gray, Pattern, Phase, Product, White

ALIKE = 0.02
"""Difference of two phases, as a share of their period, that noise can hide."""


@dataclass
class PhaseGroup:
    """Frames of one period; ``shifts`` is each one's phase against the coordinate, radians."""

    frames: list[Frame] = field(default_factory=list)
    shifts: list[float] = field(default_factory=list)


@dataclass
class AxisPlan:
    """What codes one axis: Gray bits, plain and inverted, and phase by period (px)."""

    bits: int = 0
    cell_px: int = 1
    plain: dict[int, list[Frame]] = field(default_factory=dict)
    inverted: dict[int, list[Frame]] = field(default_factory=dict)
    phases: dict[float, PhaseGroup] = field(default_factory=dict)


@dataclass
class Plan:
    """All frames of a sequence; ``axes`` by name, x the projector's columns, y its rows."""

    name: str
    white: list[Frame] = field(default_factory=list)
    black: list[Frame] = field(default_factory=list)
    axes: dict[str, AxisPlan] = field(default_factory=dict)

    def frames(self) -> list[Frame]:
        """Return all frames in the order in which the decoder reads them."""
        ordered = [*self.white, *self.black]
        for _, axis in sorted(self.axes.items()):
            for period in sorted(axis.phases):
                ordered += axis.phases[period].frames
            for bit in range(axis.bits):
                ordered += [*axis.plain.get(bit, []), *axis.inverted.get(bit, [])]
        return ordered

    @property
    def where(self) -> str:
        """The place that errors name."""
        return f"capture.json: sequence {self.name!r}"


def make_plan(sequence: Sequence, projector_px: tuple[int, int]) -> Plan:
    """Sort the frames of a sequence.

    Raises
    ------
    ImpastoError
        Naming what is missing for the sequence to be decoded.
    """
    plan = Plan(sequence.name)
    for frame in sequence.frames:
        _place(plan, frame)
    if not plan.axes:
        raise ImpastoError(
            "no frame shows a Gray code or a phase pattern",
            where=plan.where,
            expected="patterns that code the projector's columns (x), its rows (y), or both",
        )
    for name, axis in plan.axes.items():
        _check(plan, name, axis, projector_px[0] if name == "x" else projector_px[1])
    return plan


def _place(plan: Plan, frame: Frame) -> None:
    pattern = _simplified(frame.pattern)
    match pattern:
        case White():
            plan.white.append(frame)
        case Black():
            plan.black.append(frame)
        case Gray() as gray:
            axis = plan.axes.setdefault(gray.axis, AxisPlan())
            if axis.bits and (axis.bits, axis.cell_px) != (gray.bits, gray.cell_px):
                raise ImpastoError(
                    f"{frame.file} has a Gray code of {gray.bits} bits in cells of {gray.cell_px}",
                    where=plan.where,
                    expected=f"{axis.bits} bits in cells of {axis.cell_px}, as the frames before",
                )
            axis.bits, axis.cell_px = gray.bits, gray.cell_px
            (axis.inverted if gray.inverted else axis.plain).setdefault(gray.bit, []).append(frame)
        case Phase() as phase:
            group = plan.axes.setdefault(phase.axis, AxisPlan()).phases.setdefault(
                phase.period_px, PhaseGroup()
            )
            group.frames.append(frame)
            turn = phase.sign * 2 * math.pi * phase.step / phase.steps
            group.shifts.append(phase.phase_offset + turn)
        case Product():
            raise ImpastoError(
                f"{frame.file} shows a product of patterns, which cannot be decoded",
                where=plan.where,
                expected="white, black, gray or phase",
            )


def _simplified(pattern: Pattern) -> Pattern:
    """Drop white factors; a black one makes everything black."""
    if not isinstance(pattern, Product):
        return pattern
    first, second = (_simplified(part) for part in pattern.of)
    if isinstance(first, White) or isinstance(second, Black):
        return second
    if isinstance(second, White) or isinstance(first, Black):
        return first
    return pattern


def _check(plan: Plan, name: str, axis: AxisPlan, size_px: int) -> None:
    for period, group in axis.phases.items():
        different = {round(shift % (2 * math.pi), 6) for shift in group.shifts}
        if len(different) < 3:
            raise ImpastoError(
                f"the phase along {name} with period {period:g} has {len(different)} steps",
                where=plan.where,
                expected="at least 3 different ones",
            )
    missing = [bit for bit in range(axis.bits) if bit not in axis.plain | axis.inverted]
    if missing:
        raise ImpastoError(
            f"bits {missing} of the Gray code along {name} are missing",
            where=plan.where,
            expected=f"all {axis.bits} bits, plain or inverted",
        )
    if axis.bits:
        lone = [
            bit for bit in range(axis.bits) if bit not in axis.plain or bit not in axis.inverted
        ]
        if lone and not (plan.white and plan.black) and not axis.phases:
            raise ImpastoError(
                f"nothing tells light from dark for bits {lone} of the Gray code along {name}",
                where=plan.where,
                expected="inverted frames, white and black frames, or phase steps",
            )
        if axis.cell_px << axis.bits < size_px:
            raise ImpastoError(
                f"{axis.bits} bits in cells of {axis.cell_px} px code "
                f"{axis.cell_px << axis.bits} of {size_px} px along {name}",
                where=plan.where,
                expected="a Gray code that covers the projector",
            )
        if axis.phases and max(axis.phases) < axis.cell_px:
            raise ImpastoError(
                f"Gray cells of {axis.cell_px} px do not tell the periods of {max(axis.phases):g} "
                f"px along {name} apart",
                where=plan.where,
                expected="a finer Gray code, or a period of at least one cell",
            )
    elif (repeat := repeats_after(sorted(axis.phases), size_px)) < size_px:
        raise ImpastoError(
            f"phase along {name} at {', '.join(f'{p:g}' for p in sorted(axis.phases))} px repeats "
            f"itself after {repeat:g} px",
            where=plan.where,
            expected=f"Gray code, or periods that together tell {size_px} px apart",
        )


def repeats_after(periods_px: list[float], size_px: int) -> float:
    """Return the distance at which phases of all periods look alike again; ``size_px`` if none.

    Alike means within ALIKE of each period, about what noise leaves in a phase.
    """
    first, *others = periods_px
    for order in range(1, math.ceil(size_px / first)):
        distance = order * first
        if all(abs(distance / p - round(distance / p)) < ALIKE for p in others):
            return distance
    return size_px
