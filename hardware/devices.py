"""What acquisition asks of devices; a real driver and a simulated one answer to the same names."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.patterns import Pattern


class Camera(Protocol):
    """A camera that stands still."""

    def expose(self, exposure_s: float) -> NDArray[np.uint8] | NDArray[np.uint16]:
        """Take one frame: (rows, columns) or (rows, columns, 3 RGB), proportional to light."""


class Projector(Protocol):
    """A projector with its own pixels."""

    def show(self, pattern: Pattern | None) -> None:
        """Show a pattern pixel to pixel, or nothing at all."""


class Turntable(Protocol):
    """The table that the object lies on."""

    def turn_to(self, angle_deg: float) -> None:
        """Turn to an angle, counter-clockwise seen from above, and settle."""


class LampArc(Protocol):
    """The lamp on its arc."""

    def light_from(self, stop: str | None) -> None:
        """Move to a marked stop and switch on; None switches off."""
