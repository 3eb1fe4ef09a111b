"""Exact ray casting against a height field, many rays at a time.

Rays next to one another in the batch are taken as packets: each step is done for a whole packet
before the next step, in loops without branches over flat rows, which the compiler turns into vector
instructions; and neighbours share the first looks at the bounds of the surface below them. A ray's
result depends neither on its neighbours nor on the number of threads.

Canvas coordinates: x = column * spacing, y = -row * spacing, z = height, mm.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from pipeline.geometry.maximum_mipmap import build_maximum_mipmap
from pipeline.geometry.ray_packet import GROUP, PACKET, approach, finish, glance, load

Array = NDArray[np.float64]

_BLOCK = 128 * PACKET


class RayCaster:
    """The surface between the samples of a height field, made ready for rays.

    Between four samples the surface is bilinear; it is met from either side. A patch with a
    corner that is not finite is a hole. The surface ends at the outermost samples, so that a field
    of one row (or column) is a ribbon of no width: a ray that lies in its plane meets its edges
    like any surface, one that passes through the plane meets it only at a point of it.

    Parameters
    ----------
    heights_mm
        (rows, columns), any size, also none.
    spacing_mm
        Distance between samples, > 0.
    """

    def __init__(self, heights_mm: NDArray[np.floating], spacing_mm: float) -> None:
        if not 0 < spacing_mm < np.inf:
            raise ValueError(f"a spacing of {spacing_mm} mm; expected a positive number")
        self.spacing_mm = float(spacing_mm)
        self.field = build_maximum_mipmap(heights_mm)
        """For :func:`pipeline.geometry.ray_walk.first_hit` inside other kernels."""

    def first_hit(
        self,
        origins: NDArray[np.floating],
        directions: NDArray[np.floating],
        t_max: float = np.inf,
    ) -> Array:
        """Return where rays meet the surface first.

        Parameters
        ----------
        origins, directions
            (N, 3) or (3,) canvas coordinates, mm. Directions need no unit length; one that is
            zero or not finite meets nothing.
        t_max
            Hits count for 0 <= t <= t_max.

        Returns
        -------
        (N,) t of origin + t * direction; infinity where nothing is met.
        """
        return self._cast(origins, directions, float(t_max), -1.0)

    def occluded(
        self, points: NDArray[np.floating], targets: NDArray[np.floating], margin_mm: float
    ) -> NDArray[np.bool_]:
        """Return whether the surface stands between points and targets.

        Parameters
        ----------
        points, targets
            (N, 3) or (3,) canvas coordinates, mm.
        margin_mm
            Length of the way's beginning that is not tested, >= 0: a point of the surface must
            not shade itself.

        Returns
        -------
        (N,) bool; False where a point or target is not finite, or they are nearer than the margin.
        """
        if not margin_mm >= 0:
            raise ValueError(f"a margin of {margin_mm} mm; expected 0 or more")
        return np.isfinite(self._cast(points, targets, 1.0, float(margin_mm)))

    def _cast(
        self,
        origins: NDArray[np.floating],
        ends: NDArray[np.floating],
        t_max: float,
        margin_mm: float,
    ) -> Array:
        first, second = _rows(origins), _rows(ends)
        result = np.empty(np.broadcast_shapes((len(first),), (len(second),)))
        _cast(self.field, 1.0 / self.spacing_mm, first, second, t_max, margin_mm, result)
        return result


def _rows(vectors: NDArray[np.floating]) -> Array:
    """Return (N, 3) or (1, 3) float64; one vector broadcast to many is kept as one."""
    array = np.asarray(vectors)
    if array.ndim == 1:
        array = array[None]
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"vectors of shape {np.shape(vectors)}; expected (N, 3) or (3,)")
    if len(array) > 1 and array.strides[0] == 0:
        array = array[:1]
    return np.ascontiguousarray(array, dtype=np.float64)


@njit(cache=True, error_model="numpy", parallel=True)
def _cast(field, per_mm, origins, ends, t_max, margin_mm, result):  # type: ignore[no-untyped-def]
    """Cast rays (``margin_mm`` < 0: ``ends`` are directions) or test ways to targets."""
    count = len(result)
    for block in prange((count + _BLOCK - 1) // _BLOCK):
        packet = np.zeros(19 * PACKET)
        cells = np.zeros(3 * PACKET, np.int64)
        for start in range(block * _BLOCK, min(count, (block + 1) * _BLOCK), PACKET):
            size = min(count - start, PACKET)
            load(field, per_mm, origins, ends, t_max, margin_mm, start, size, packet, result)
            if glance(field, packet, size):
                for first in range(0, size, GROUP):
                    approach(field, packet, first, min(first + GROUP, size))
                finish(field, packet, cells, size, start, result)
