"""Taking a capture: sequences of patterns and photographs, written into a bundle as they come."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hardware.devices import Camera, LampArc, Projector, Turntable
from pipeline.formats.bundle_writer import BundleWriter
from pipeline.formats.patterns import Black, Gray, Pattern, Phase, White

Say = Callable[[str], None]


@dataclass(frozen=True)
class PatternPlan:
    """Which patterns a sequence shows.

    Parameters
    ----------
    periods_px
        Phase period by axis.
    cells_px, bits
        Gray code by axis.
    steps
        Phase steps of each period.
    inverted
        Show each Gray bit inverted, too.
    """

    periods_px: dict[str, float]
    cells_px: dict[str, int]
    bits: dict[str, int]
    steps: int = 4
    inverted: bool = False

    def patterns(self) -> list[Pattern]:
        """List the patterns in the order they are shown."""
        shown: list[Pattern] = [White(), Black()]
        for axis in sorted(self.periods_px):
            code: dict[str, Any] = {"axis": axis, "bits": self.bits[axis]}
            code["cell_px"] = self.cells_px[axis]
            shown += [
                Gray(**code, bit=bit, inverted=inverted)
                for bit in range(self.bits[axis])
                for inverted in ((False, True) if self.inverted else (False,))
            ]
            fringes: dict[str, Any] = {"axis": axis, "period_px": self.periods_px[axis]}
            shown += [Phase(**fringes, step=i, steps=self.steps) for i in range(self.steps)]
        return shown


@dataclass
class Acquisition:
    """Drives the devices and keeps the bundle's document as it grows."""

    writer: BundleWriter
    projector: Projector
    turntable: Turntable
    lamps: LampArc
    sequences: list[dict[str, Any]] = field(default_factory=list)
    photos: list[dict[str, Any]] = field(default_factory=list)

    def sequence(
        self,
        camera: Camera,
        patterns: Iterable[Pattern],
        exposures_s: Iterable[float],
        *,
        name: str,
        purpose: str,
        camera_name: str,
        turntable_deg: float = 0.0,
        **keys: Any,
    ) -> None:
        """Show the patterns at every exposure and record the frames."""
        self.turntable.turn_to(turntable_deg)
        self.lamps.light_from(None)
        frames = []
        chosen = list(patterns)
        for exposure_s in exposures_s:
            for pattern in chosen:
                self.projector.show(pattern)
                file = f"{name}/{len(frames):03d}.png"
                self.writer.add_image(file, camera.expose(exposure_s))
                shown = pattern.model_dump(exclude_defaults=False)
                frames.append({"file": file, "pattern": shown, "exposure_s": exposure_s})
        self.projector.show(None)
        self.sequences.append(
            {
                "name": name,
                "purpose": purpose,
                "camera": camera_name,
                "turntable_deg": turntable_deg,
                **keys,
                "frames": frames,
            }
        )

    def photograph(
        self,
        camera: Camera,
        *,
        camera_name: str,
        stop: str,
        turntable_deg: float,
        exposure_s: float,
    ) -> None:
        """Take one photograph under one lamp, the exposure halved until little of it saturates."""
        self.turntable.turn_to(turntable_deg)
        self.projector.show(None)
        self.lamps.light_from(stop)
        image = camera.expose(exposure_s)
        while np.mean(image >= np.iinfo(image.dtype).max) > 0.002 and exposure_s > 1e-4:
            exposure_s /= 2
            image = camera.expose(exposure_s)
        file = f"photos/{len(self.photos):04d}.png"
        self.writer.add_image(file, image)
        self.photos.append(
            {
                "file": file,
                "camera": camera_name,
                "turntable_deg": turntable_deg,
                "light": stop,
                "exposure_s": exposure_s,
            }
        )
