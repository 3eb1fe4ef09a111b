"""What acquisition asks of devices; a real driver and a simulated one answer to the same names.

Every call returns when the device has done what was asked, or raises
:class:`~pipeline.errors.HardwareError`; none waits without end.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.patterns import Pattern


@dataclass(frozen=True)
class Frame:
    """One image as a camera delivers it.

    Parameters
    ----------
    image
        (rows, columns) or (rows, columns, 3 RGB) uint16, proportional to light, full scale 65535.
    exposure_s
        That the camera reports; it may differ from what was asked for.
    """

    image: NDArray[np.uint16]
    exposure_s: float


class Camera(Protocol):
    """A camera that stands still."""

    def capture(self, exposure_s: float) -> Frame:
        """Take one frame with the exposure nearest to that asked for."""


class Projector(Protocol):
    """A projector with its own pixels."""

    def show(self, pattern: Pattern | None) -> None:
        """Show a pattern pixel to pixel, or nothing at all."""


class Turntable(Protocol):
    """The table that the object lies on."""

    def move_to(self, angle_deg: float) -> None:
        """Turn to an angle, counter-clockwise seen from above, and settle."""


class LampArc(Protocol):
    """The carriage of the lamp on its arc."""

    def move_to(self, stop: str) -> None:
        """Move to a marked stop and settle."""


class Lamp(Protocol):
    """The lamp on the carriage."""

    def switch(self, on: bool) -> None:
        """Switch on or off, and wait until the light is steady."""


class Operator(Protocol):
    """Whoever puts things before the cameras."""

    def place(self, what: str) -> None:
        """Put something in place (``board-3``, ``painting``); return when it lies still."""


@dataclass(frozen=True)
class Rig:
    """The devices of one rig."""

    cameras: Mapping[str, Camera]
    projector: Projector
    turntable: Turntable
    arc: LampArc
    lamp: Lamp
    operator: Operator
