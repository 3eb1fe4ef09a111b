"""The ray caster against Embree: speed, preparation, memory and error, on a brushwork-like relief.

    python benchmarks/raycast.py

Embree (4, from the PyPI package embreex: ``pip install .[validation]``) gets the same relief as two
triangles per cell and the same rays. It is asked in two ways: through embreex, which takes one ray
after another on one thread, and in packets of 16 through the library that embreex brings, which is
the faster. Ends with status 1 if the target is missed: twice embreex on every primary view.
"""

from __future__ import annotations

import ctypes
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib.metadata import files, version
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import numba
import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from embreex.mesh_construction import TriangleMesh
from embreex.rtcore import EmbreeDevice
from embreex.rtcore_scene import EmbreeScene

from pipeline.geometry.raycast import RayCaster

Array = NDArray[np.float64]

SIZE = 1024
SPACING_MM = 0.1
DISTANCE_MM = 300.0
VIEWS = (("front", 90.0, 9.4), ("35 deg", 35.0, 4.9), ("12 deg", 12.0, 1.6))
"""Name, elevation, half the angle of view; the relief fills every view."""
LIGHT_ELEVATION = 10.0
MARGIN_MM = 0.05
PAIRS = 7
CHECKED = 20_000
TARGET = 2.0
WIDTH = 16


class Rays(NamedTuple):
    """Rays of one kind; those of shadows go from points to ends, t_max = 1."""

    name: str
    origins: Array
    directions: Array
    shadow: bool


def brushwork(size: int, spacing_mm: float, seed: int = 7) -> NDArray[np.float32]:
    """Return heights, mm: octaves of noise, 50 mm to 0.4 mm long, drawn out into strokes."""
    rng = np.random.default_rng(seed)
    fy = np.fft.fftfreq(size, spacing_mm)[:, None]
    fx = np.fft.rfftfreq(size, spacing_mm)[None, :]
    heights = np.zeros((size, size))
    for octave in range(8):
        wavelength = 50.0 / 2**octave
        angle = rng.uniform(0.0, np.pi)
        along = np.cos(angle) * fx + np.sin(angle) * fy
        across = np.cos(angle) * fy - np.sin(angle) * fx
        radius = np.hypot(2.0 * along, across) * wavelength
        band = np.exp(-np.square(np.log2(np.maximum(radius, 1e-6))))
        noise = np.fft.irfft2(np.fft.rfft2(rng.standard_normal((size, size))) * band, (size, size))
        heights += wavelength**0.6 * noise / noise.std()
    scaled: NDArray[np.float32] = (0.15 * heights / heights.std()).astype(np.float32)
    return scaled


def view(elevation: float, half_angle: float) -> tuple[Array, Array]:
    """Return origins and unit directions of the pixels of a square perspective view, row by row."""
    e, side = np.radians(elevation), 0.5 * (SIZE - 1) * SPACING_MM
    forward = np.array([0.0, np.cos(e), -np.sin(e)])
    eye = np.array([side, -side, 0.0]) - DISTANCE_MM * forward
    right = np.array([1.0, 0.0, 0.0])
    up = np.cross(right, forward)
    p = np.tan(np.radians(half_angle)) * ((2 * np.arange(SIZE) + 1.0) / SIZE - 1)
    d = forward + p[None, :, None] * right - p[:, None, None] * up
    d /= np.linalg.norm(d, axis=-1, keepdims=True)
    return np.tile(eye, (SIZE * SIZE, 1)), d.reshape(-1, 3)


def all_rays(caster: RayCaster) -> list[Rays]:
    """Return the views, and the ways from the front view's points to a low lamp."""
    sets = [Rays(name, *view(elevation, half), False) for name, elevation, half in VIEWS]
    front = sets[0]
    t = caster.first_hit(front.origins, front.directions)
    points = front.origins + t[:, None] * front.directions
    e, side = np.radians(LIGHT_ELEVATION), 0.5 * (SIZE - 1) * SPACING_MM
    lamp = np.array([side, -side - DISTANCE_MM * np.cos(e), DISTANCE_MM * np.sin(e)])
    ways = lamp - points
    start = MARGIN_MM / np.linalg.norm(ways, axis=1, keepdims=True)
    return [*sets, Rays("shadow", points + start * ways, (1.0 - start) * ways, True)]


# --- Embree -------------------------------------------------------------------------------------


def mesh(heights: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Return vertices and triangles; diagonals run from (column + 1, row) to (column, row + 1)."""
    row, column = np.mgrid[0:SIZE, 0:SIZE]
    vertices = np.stack([column * SPACING_MM, -row * SPACING_MM, heights], -1).reshape(-1, 3)
    i = (row[:-1, :-1] * SIZE + column[:-1, :-1]).ravel()
    triangles = np.stack([i, i + SIZE, i + 1, i + 1, i + SIZE, i + SIZE + 1], -1).reshape(-1, 3)
    return vertices.astype(np.float32), triangles.astype(np.int32)


class Wrapped:
    """Embree through embreex."""

    def __init__(self, vertices: NDArray[np.float32], triangles: NDArray[np.int32]) -> None:
        self.device = EmbreeDevice()
        self.scene = EmbreeScene(self.device)
        self.mesh = TriangleMesh(self.scene, vertices, triangles)
        self.scene.run(vertices[:1], vertices[:1])  # the first question builds the hierarchy

    def cast(self, o: NDArray[np.float32], d: NDArray[np.float32], shadow: bool) -> NDArray[Any]:
        """Return t (1e37 for none), or whether something is met before t = 1."""
        if shadow:
            met: NDArray[Any] = self.scene.run(o, d, 1.0, query="OCCLUDED") == 0
            return met
        t: NDArray[Any] = self.scene.run(o, d, query="DISTANCE")
        return t


class Packets:
    """Embree in packets of 16 coherent rays, through the C interface of embreex's library."""

    def __init__(self, vertices: NDArray[np.float32], triangles: NDArray[np.int32]) -> None:
        paths = [p for p in files("embreex") or [] if "libembree4" in p.name or "libtbb" in p.name]
        for path in sorted(paths, key=lambda p: p.name, reverse=True):  # TBB first
            library = ctypes.CDLL(str(path.locate()), ctypes.RTLD_GLOBAL)
        pointer, size = ctypes.c_void_p, ctypes.c_size_t

        def function(name: str, result: Any, *arguments: Any) -> Any:
            found = getattr(library, name)
            found.restype, found.argtypes = result, arguments
            return found

        self.vertices = np.append(vertices, np.zeros(4, np.float32))  # Embree reads 16 bytes each
        self.triangles = triangles
        device = function("rtcNewDevice", pointer, ctypes.c_char_p)(b"")
        self.scene = function("rtcNewScene", pointer, pointer)(device)
        geometry = function("rtcNewGeometry", pointer, pointer, ctypes.c_int)(device, 0)
        share = function(
            "rtcSetSharedGeometryBuffer",
            None,
            *(pointer, ctypes.c_int, ctypes.c_uint, ctypes.c_int, pointer, size, size, size),
        )
        share(geometry, 1, 0, 0x9003, self.vertices.ctypes.data, 0, 12, len(vertices))
        share(geometry, 0, 0, 0x5003, self.triangles.ctypes.data, 0, 12, len(triangles))
        function("rtcCommitGeometry", None, pointer)(geometry)
        function("rtcAttachGeometry", ctypes.c_uint, pointer, pointer)(self.scene, geometry)
        function("rtcCommitScene", None, pointer)(self.scene)
        if function("rtcGetDeviceError", ctypes.c_int, pointer)(device):
            raise RuntimeError("Embree refused the mesh")
        self.arguments = np.zeros(16, np.uint32)
        self.arguments[:2] = 1 << 16, 0xFFFFFFFF  # coherent rays; all features
        ask = (None, pointer, pointer, pointer, pointer)
        self._first = _packet_kernel(function("rtcIntersect16", *ask))
        self._any = _packet_kernel(function("rtcOccluded16", *ask))

    def cast(self, o: NDArray[np.float32], d: NDArray[np.float32], shadow: bool) -> NDArray[Any]:
        """Return t (infinity for none), or whether something is met before t = 1."""
        t = np.empty(len(o), np.float32)
        kernel, far = (self._any, 1.0) if shadow else (self._first, np.inf)
        kernel(self.scene, self.arguments.ctypes.data, o, d, np.float32(far), t)
        return t < 0 if shadow else t


def _packet_kernel(ask: Any) -> Callable[..., None]:
    """Compile the loop that fills RTCRayHit16 (12 rows of the ray, 9 of the hit) and asks."""

    @njit(parallel=True)
    def kernel(scene, arguments, origins, directions, far, t):  # type: ignore[no-untyped-def]
        for block in prange((len(t) + 4095) // 4096):
            space = np.zeros(24 * WIDTH + 32, np.float32)
            begin = (-(space.ctypes.data // 4)) % 16
            rays = space[begin : begin + 24 * WIDTH]
            bits = rays.view(np.uint32)
            valid = np.zeros(2 * WIDTH, np.int32)
            valid = valid[(-(valid.ctypes.data // 4)) % 16 :]
            for start in range(4096 * block, min(len(t), 4096 * (block + 1)), WIDTH):
                size = min(WIDTH, len(t) - start)
                for k in range(size):
                    valid[k] = -1
                    for axis in range(3):
                        rays[axis * WIDTH + k] = origins[start + k, axis]
                        rays[(4 + axis) * WIDTH + k] = directions[start + k, axis]
                    rays[8 * WIDTH + k] = far
                    bits[9 * WIDTH + k] = 0xFFFFFFFF
                    bits[18 * WIDTH + k] = 0xFFFFFFFF
                for k in range(size, WIDTH):
                    valid[k] = 0
                ask(valid.ctypes.data, scene, rays.ctypes.data, arguments)
                for k in range(size):
                    t[start + k] = rays[8 * WIDTH + k]

    return kernel  # type: ignore[no-any-return]


# --- truth --------------------------------------------------------------------------------------


@njit
def _height(heights, x, y, i, j, flat):  # type: ignore[no-untyped-def]
    a, b = np.float64(heights[j, i]), np.float64(heights[j, i + 1])
    c, d = np.float64(heights[j + 1, i]), np.float64(heights[j + 1, i + 1])
    f, g = x - i, y - j
    if not flat:
        return (1 - g) * ((1 - f) * a + f * b) + g * ((1 - f) * c + f * d)
    if f + g <= 1:
        return a + f * (b - a) + g * (c - a)
    return d + (1 - f) * (c - d) + (1 - g) * (b - d)


@njit(parallel=True)
def truth(heights, spacing_mm, origins, directions, t_max, flat):  # type: ignore[no-untyped-def]
    """Return the first t by bisection in every stretch between grid lines (and diagonals).

    In a stretch the gap between ray and surface is a parabola, monotonic on either side of its
    vertex. ``flat``: two triangles per cell in place of the bilinear patch.
    """
    rows, columns = heights.shape
    high, low = np.float64(heights.max()), np.float64(heights.min())
    result = np.full(len(origins), np.inf)
    for n in prange(len(origins)):
        x, y, z = origins[n, 0] / spacing_mm, -origins[n, 1] / spacing_mm, origins[n, 2]
        u, v, w = directions[n, 0] / spacing_mm, -directions[n, 1] / spacing_mm, directions[n, 2]
        t0, t1 = 0.0, t_max
        for position, speed, least, most in (
            (x, u, 0.0, columns - 1.0),
            (y, v, 0.0, rows - 1.0),
            (z, w, low, high),
        ):
            if speed == 0.0:
                t1 = t1 if least <= position <= most else -1.0
            else:
                a, b = (least - position) / speed, (most - position) / speed
                t0, t1 = max(t0, min(a, b)), min(t1, max(a, b))
        while t0 < t1:
            end = t1
            diagonal = (x + y, u + v) if flat else (0.0, 0.0)
            for position, speed in ((x, u), (y, v), diagonal):
                if speed != 0.0:
                    here = position + (t0 + 1e-12 * abs(t0)) * speed
                    line = np.floor(here) + 1 if speed > 0 else np.ceil(here) - 1
                    end = min(end, (line - position) / speed)
            end = max(end, np.nextafter(t0, np.inf))
            middle = 0.5 * (t0 + end)
            i = min(max(int(np.floor(x + middle * u)), 0), columns - 2)
            j = min(max(int(np.floor(y + middle * v)), 0), rows - 2)
            cuts = np.array([t0, middle, end])
            gaps = np.empty(3)
            for k in range(3):
                s = cuts[k]
                gaps[k] = z + s * w - _height(heights, x + s * u, y + s * v, i, j, flat)
            bend = gaps[0] - 2 * gaps[1] + gaps[2]
            if bend != 0.0 and not flat:
                vertex = middle - 0.25 * (end - t0) * (gaps[2] - gaps[0]) / bend
                if t0 < vertex < end:
                    cuts[1] = vertex
            for k in range(2):
                a, b = cuts[k], cuts[k + 1]
                gap = z + a * w - _height(heights, x + a * u, y + a * v, i, j, flat)
                other = z + b * w - _height(heights, x + b * u, y + b * v, i, j, flat)
                if gap * other <= 0.0:
                    for _ in range(60):
                        s = 0.5 * (a + b)
                        value = z + s * w - _height(heights, x + s * u, y + s * v, i, j, flat)
                        if (value > 0) == (gap > 0):
                            a = s
                        else:
                            b = s
                    result[n] = 0.5 * (a + b)
                    break
            if result[n] < np.inf:
                break
            t0 = end
    return result


# --- measuring ----------------------------------------------------------------------------------


@dataclass
class Built:
    """Something made, and what that took."""

    thing: Any
    seconds: float
    resident_mb: float


def built(make: Callable[[], Any]) -> Built:
    """Make it and time it."""
    before, start = _resident_mb(), time.perf_counter()
    thing = make()
    return Built(thing, time.perf_counter() - start, _resident_mb() - before)


def _resident_mb() -> float:
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6


def in_turns(*calls: Callable[[], Any]) -> list[list[float]]:
    """Return seconds of calls made in turns, after one of each that does not count."""
    times: list[list[float]] = [[] for _ in calls]
    for turn in range(PAIRS + 1):
        for call, seconds in zip(calls, times, strict=True):
            start = time.perf_counter()
            call()
            if turn:
                seconds.append(time.perf_counter() - start)
    return times


def ratio(others: list[float], ours: list[float]) -> float:
    """Return the median of the ratios of pairs."""
    return median(a / b for a, b in zip(others, ours, strict=True))


def report_speed(
    sets: list[Rays], caster: RayCaster, wrapped: Wrapped, packets: Packets
) -> list[str]:
    """Print Mrays/s; return what misses the target."""
    missed: list[str] = []
    cores = numba.config.NUMBA_NUM_THREADS
    print(f"\nMrays/s, median of {PAIRS} turns; x: ours over theirs, median of pairs")
    print(f"{'rays':8} {'threads':>7} {'ours':>7} {'embreex':>8} {'x':>6} {'packets':>8} {'x':>6}")
    for rays in sets:
        o32, d32 = rays.origins.astype(np.float32), rays.directions.astype(np.float32)
        for threads in sorted({1, cores}):
            numba.set_num_threads(threads)
            calls: list[Callable[[], Any]] = [_ours(caster, rays)]
            calls.append(partial(packets.cast, o32, d32, rays.shadow))
            if threads == 1:
                calls.append(partial(wrapped.cast, o32, d32, rays.shadow))
            ours, in_packets, *single = in_turns(*calls)
            speed = [len(o32) / 1e6 / median(t) for t in (ours, in_packets, *single)]
            x = f"{speed[2]:8.2f} {ratio(single[0], ours):6.2f}" if single else f"{'-':>8} {'-':>6}"
            packed = f"{speed[1]:8.2f} {ratio(in_packets, ours):6.2f}"
            print(f"{rays.name:8} {threads:7} {speed[0]:7.2f} {x} {packed}", flush=True)
            if single and not rays.shadow and ratio(single[0], ours) < TARGET:
                missed.append(f"{rays.name}: {ratio(single[0], ours):.2f} x, at least {TARGET} x")
    numba.set_num_threads(cores)
    return missed


def _ours(caster: RayCaster, rays: Rays) -> Callable[[], NDArray[Any]]:
    if rays.shadow:
        ends = rays.origins + rays.directions
        return lambda: caster.occluded(rays.origins, ends, 0.0)
    return lambda: caster.first_hit(rays.origins, rays.directions)


def report_errors(
    sets: list[Rays], heights: NDArray[np.float32], caster: RayCaster, wrapped: Wrapped
) -> None:
    """Print how far both are from the surfaces that they stand for."""
    print(f"\n|t - truth|, um, of {CHECKED} rays: 99th percentile, largest (hit or miss differs)")
    print(f"{'rays':8} {'ours, bilinear':>26} {'embreex, triangles':>26} {'embreex, bilinear':>26}")
    for rays in sets:
        chosen = np.random.default_rng(0).choice(len(rays.origins), CHECKED, replace=False)
        o, d = rays.origins[chosen], rays.directions[chosen]
        t_max = 1.0 if rays.shadow else 1e9
        smooth, flat = (truth(heights, SPACING_MM, o, d, t_max, how) for how in (False, True))
        ours = _ours(caster, Rays(rays.name, o, d, rays.shadow))()
        theirs = wrapped.cast(o.astype(np.float32), d.astype(np.float32), rays.shadow)
        cells = [_error(*pair) for pair in ((ours, smooth), (theirs, flat), (theirs, smooth))]
        print(f"{rays.name:8} " + " ".join(f"{cell:>26}" for cell in cells))


def _error(found: NDArray[Any], expected: Array) -> str:
    met = np.isfinite(expected)
    if found.dtype == bool:
        return f"({np.count_nonzero(found != met)})"
    hit = found < 1e30
    error = 1e3 * np.abs(found[met & hit].astype(np.float64) - expected[met & hit])
    differ = np.count_nonzero(hit != met)
    return f"{np.percentile(error, 99):.3g}, {error.max():.3g} ({differ})"


def main() -> int:
    """Print the tables; return 1 if the target is missed."""
    heights = brushwork(SIZE, SPACING_MM)
    RayCaster(heights[:8, :8], 1.0).first_hit(np.zeros((1, 3)), np.ones((1, 3)))  # compile
    attempts = [built(lambda: RayCaster(heights, SPACING_MM)) for _ in range(PAIRS)]
    ours = sorted(attempts, key=lambda attempt: attempt.seconds)[PAIRS // 2]
    vertices, triangles = mesh(heights)
    theirs = built(lambda: Wrapped(vertices, triangles))
    packets = Packets(vertices, triangles)
    own = sum(array.nbytes for array in ours.thing.field) / 1e6
    cores = numba.config.NUMBA_NUM_THREADS
    print(f"relief {SIZE} x {SIZE}, rms {heights.std():.3f} mm, span {np.ptp(heights):.2f} mm")
    print(f"embreex {version('embreex')}, numba {version('numba')}, {cores} threads")
    print(f"ours: prepared in {1e3 * ours.seconds:.0f} ms, {own:.1f} MB")
    print(
        f"Embree: built in {1e3 * theirs.seconds:.0f} ms, {theirs.resident_mb:.0f} MB more resident"
    )
    sets = all_rays(ours.thing)
    missed = report_speed(sets, ours.thing, theirs.thing, packets)
    report_errors(sets, heights, ours.thing, theirs.thing)
    for text in missed:
        print(f"target missed: {text}")
    return bool(missed)


if __name__ == "__main__":
    sys.exit(main())
