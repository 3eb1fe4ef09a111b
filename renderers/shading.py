"""The light that leaves a texel: the CPU's one shading function, twin of ``shading.wgsl``."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def unit_normals(normal_xy: NDArray[np.floating]) -> Array:
    """Rebuild unit normals (..., 3) from n_x, n_y (..., 2); n_z is positive."""
    xy = np.asarray(normal_xy, dtype=np.float64)
    z = np.sqrt(np.maximum(1 - (xy**2).sum(axis=-1, keepdims=True), 1e-6))
    normals = np.concatenate([xy, z], axis=-1)
    return np.asarray(normals / np.linalg.norm(normals, axis=-1, keepdims=True))


def reflectance(
    diffuse: Array, specular: Array, lobe: Array, normals: Array, to_eye: Array, to_light: Array
) -> Array:
    """Return f_r, 1/sr, of one isotropic Lafortune lobe (McAllister et al. 2002).

    rho_d + rho_s max(0, C_xy (v_x l_x + v_y l_y) + C_z v_z l_z)^k in the texel's own frame. No
    tangents are needed, for v_x l_x + v_y l_y = v . l - v_z l_z.

    Parameters
    ----------
    diffuse, specular, lobe
        (..., 3); the lobe is C_xy, C_z, k.
    normals, to_eye, to_light
        (..., 3) unit vectors.
    """
    v_z, l_z = (to_eye * normals).sum(axis=-1), (to_light * normals).sum(axis=-1)
    across = (to_eye * to_light).sum(axis=-1) - v_z * l_z
    base = np.maximum(lobe[..., 0] * across + lobe[..., 1] * v_z * l_z, 0)
    peak = np.where(base > 0, base ** lobe[..., 2], 0)
    return np.asarray(diffuse + specular * peak[..., None])
