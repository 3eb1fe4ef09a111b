"""Photographs seen from the canvas, and the lobes fitted to them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class ReflectanceSamples:
    """What each photograph says of each texel (``reflectance/samples.npy``, ``photos.json``).

    Parameters
    ----------
    brdf
        (photos, rows, columns, 3) float32, RGB, 1/sr: radiance over irradiance, cosine divided
        out; NaN where the texel was not seen, not lit, saturated or outside.
    view_mm, light_mm
        (photos, 3) float64: the camera's centre and the lamp, canvas coordinates.
    names
        The photographs' file names.
    absolute
        True if responsivity and lamp intensities were given, so that ``brdf`` is in 1/sr;
        otherwise it is known up to one factor.
    """

    brdf: NDArray[np.float32]
    view_mm: NDArray[np.float64]
    light_mm: NDArray[np.float64]
    names: tuple[str, ...]
    absolute: bool


@dataclass(frozen=True)
class ReflectanceMaps:
    """One isotropic Lafortune lobe per texel, its peak normalised to 1 (``fit/*.exr``).

    f = rho_d + rho_s max(0, C_xy (v_x l_x + v_y l_y) + C_z v_z l_z)^k, with v and l in the texel's
    own frame and (C_xy, C_z) scaled so that the largest value of the bracket is 1.

    Parameters
    ----------
    diffuse, specular
        rho_d, rho_s: (rows, columns, 3) float32, 1/sr, >= 0; NaN outside the canvas.
    lobe
        (rows, columns, 3) float32: C_xy, C_z, k; 0, 0, 1 where the texel is matte.
    residual
        (rows, columns) float32: RMS of the fit, 1/sr.
    count
        (rows, columns) int32: samples used.
    lobe_observed
        (rows, columns) bool: False where no sample lay near enough to a highlight.
    """

    diffuse: NDArray[np.float32]
    specular: NDArray[np.float32]
    lobe: NDArray[np.float32]
    residual: NDArray[np.float32]
    count: NDArray[np.int32]
    lobe_observed: NDArray[np.bool_]
    absolute: bool
