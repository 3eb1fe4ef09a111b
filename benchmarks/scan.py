"""Decoding and triangulation: steps, exposures and codes against error; reading; OpenCV's Gray."""

from __future__ import annotations

import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np

from benchmarks.results import Result, Row, timed
from benchmarks.scene import Scene
from hardware.acquisition import Coding, coded
from pipeline.formats.bundle import Bundle
from pipeline.scan.points import measure as triangulate_points
from pipeline.structured_light.decode import decode_sequence

DARK = 0.15
"""Albedo below which paint counts as dark."""


def measure(*, quick: bool = False) -> Result:
    """Vary the patterns; then compare with reading alone, and with OpenCV on the same frames."""
    size = (320, 256) if quick else (640, 512)
    scene = Scene(size, (1024, 768))
    rows = []
    cases = [
        *(
            (f"{n} steps, x and y", "xy", n, (0.9,))
            for n in ((4, 8) if quick else (3, 4, 5, 8, 12))
        ),
        ("4 steps, x alone", "x", 4, (0.9,)),
        ("4 steps, x and y, 2 exposures", "xy", 4, (0.9, 3.6)),
        ("4 steps, x and y, 3 exposures", "xy", 4, (0.25, 0.9, 3.6)),
        ("Gray code alone, x and y", "xy", 0, (0.9,)),
    ]
    with tempfile.TemporaryDirectory() as folder:
        for i, (name, axes, steps, exposures) in enumerate(cases):
            bundle = scene.record(Path(folder) / str(i), patterns(axes, steps), exposures)
            rows.append(case(name, scene, bundle))
        notes = [against_reading(Path(folder) / "large", quick=quick)]
        notes += [against_opencv(Scene((1280, 1024)), Path(folder) / "gray")]
    return Result("scan", f"scan, {size[0]} x {size[1]} px", "RMS error, um", rows, notes)


def patterns(axes: str, steps: int):  # type: ignore[no-untyped-def]
    """Return white, black, and per axis seven Gray bits and phase steps of 16 px."""
    periods = (16.0,) if steps else ()
    return coded(*(Coding(axis, 7, 8, periods_px=periods, steps=max(steps, 3)) for axis in axes))


def case(name: str, scene: Scene, bundle: Bundle) -> Row:
    """Decode and triangulate; compare with the true depth."""
    sequence = bundle.sequences("scan")[0]

    def run():  # type: ignore[no-untyped-def]
        return triangulate_points(decode_sequence(bundle, sequence), scene.camera, scene.projector)

    seconds, found = timed(run)
    error = found.points_mm[..., 2] - scene.depth_mm
    known = np.isfinite(error)
    dark = known & (scene.albedo < DARK)
    return Row(
        name,
        seconds,
        rms(error[known]) * 1000,
        default=name.startswith("4 steps, x and y, 3"),
        figures={
            "frames": float(len(sequence.frames)),
            "median um": float(np.median(np.abs(error[known]))) * 1000,
            "dark paint um": rms(error[dark]) * 1000,
            "error / S": rms(error[known] / found.sigma_mm[known]),
            "measured %": 100 * float(known.mean()),
        },
    )


def rms(values: np.ndarray) -> float:
    """Return the root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values, dtype=np.float64))))


def against_reading(folder: Path, *, quick: bool) -> str:
    """Time a large two-axis scan at three exposures against reading its files."""
    size = (640, 512) if quick else (1280, 1024)
    scene = Scene(size, (1280, 800))
    shown = coded(*(Coding(axis, 9, 4, periods_px=(16.0,), steps=12) for axis in "xy"))
    bundle = scene.record(folder, shown, (0.25, 0.9, 3.6))
    files = [frame.file for frame in bundle.sequences("scan")[0].frames]
    alone, _ = timed(lambda: [bundle.read_stored(file).shape for file in files])

    def by_two() -> None:
        with ThreadPoolExecutor(2) as pool:
            list(pool.map(lambda file: bundle.read_stored(file).shape, files))

    both, _ = timed(by_two)
    row = case("", scene, bundle)
    return (
        f"{len(files)} frames of {size[0]} x {size[1]}: {row.seconds:.2f} s to measure, "
        f"{alone:.2f} s to read alone on one thread ({row.seconds / alone:.2f} x), "
        f"{both:.2f} s on two ({row.seconds / both:.2f} x)"
    )


def against_opencv(scene: Scene, folder: Path) -> str:
    """Time Gray code alone against OpenCV's GrayCodePattern, reading left out of both.

    OpenCV decodes for two cameras at once: it gets our frames as both, and half of its time counts.
    """
    width, height = 2**7 * 8, 2**7 * 8
    code = cv2.structured_light.GrayCodePattern.create(width // 8, height // 8)
    frames = coded(*(Coding(axis, 7, 8, inverted=True) for axis in "xy"))
    bundle = scene.record(folder, frames, (0.9,))
    images = [bundle.read_stored(f.file) for f in bundle.sequences("scan")[0].frames]
    images = [(image >> 8).astype(np.uint8) for image in images]
    white, black, coded_frames = images[0], images[1], images[2:]
    pair = [coded_frames, coded_frames]
    theirs, _ = timed(lambda: code.decode(pair, None, [black] * 2, [white] * 2), turns=3)
    sequence = bundle.sequences("scan")[0]
    ours, _ = timed(lambda: decode_sequence(bundle, sequence))
    reading, _ = timed(lambda: [bundle.read_stored(f.file).shape for f in sequence.frames])
    return (
        f"Gray code alone, {len(frames)} frames of {scene.size_px[0]} x {scene.size_px[1]}, with "
        f"reading: {ours:.3f} s, OpenCV {cv2.__version__} {reading + theirs / 2:.3f} s, of which "
        f"{reading:.3f} s are reading"
    )
