"""How noisy a stored value is: shot noise, read noise, rounding (Janesick 2007)."""

from __future__ import annotations

from dataclasses import dataclass

from pipeline.formats.capture import CameraEntry

SATURATED = 0.98
"""Share of full scale from which a value may be clipped and is dropped."""

TYPICAL_WELL_E, TYPICAL_READ_E = 8000.0, 5.0
"""An industrial camera's sensor, where the bundle says nothing."""


@dataclass(frozen=True)
class NoiseModel:
    """Variance of a value v in 0..1: ``shot v + floor``; ``given`` if the bundle states it."""

    shot: float
    floor: float
    given: bool


def noise_model(camera: CameraEntry, stored_bits: int) -> NoiseModel:
    """Take the camera's noise model, or a typical one, which the residuals rescale later."""
    well = camera.full_well_e or TYPICAL_WELL_E
    read = TYPICAL_READ_E if camera.read_noise_e is None else camera.read_noise_e
    levels = 2.0 ** min(camera.bits or stored_bits, stored_bits) - 1
    floor = (read / well) ** 2 + 1 / (12 * levels**2)
    return NoiseModel(1 / well, floor, camera.full_well_e is not None)
