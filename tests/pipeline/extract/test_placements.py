"""Canvases larger than the field, whose placements are known exactly.

The field is 135 x 104 mm, a pixel 0.52 mm, the noise 20 um, the canvas 260 x 180 mm.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from pipeline.extract.stage import Config, Inputs, run

LAYOUTS = (
    (50, 30),
    (-45, 25, 7, (1, -2), 3),
    (45, -35, -5, (0.5, 1), -2),
    (-52, -30, 3, (1, 1), 1),
)


class Recorder:
    def __init__(self):
        self.metrics, self.warnings, self.skips = {}, [], []

    def progress(self, done, total, what=""): ...

    def metric(self, name, value):
        self.metrics[name] = value

    def warning(self, text):
        self.warnings.append(text)

    def skipped(self, what, why):
        self.skips.append((what, why))


def extract(table, scans, **config):
    log = Recorder()
    first, *others = scans
    inputs = Inputs(first.range_image, table.calibration, first.texture, tuple(others))
    return run(inputs, Config(**config), log).height_field, log


def scans_of(table, painting, motions, **how):
    return [
        table.scan(painting, motion, f"part {i}", seed=i, **how) for i, motion in enumerate(motions)
    ]


def errors(field, painting, motion):
    """Return measured minus true heights (rows, columns), by the first placement's true motion."""
    points = (motion.inverse() @ field.scan_from_canvas).apply(field.canvas_points())
    return points[..., 2] - painting.at(points)


def motion_errors(field, motions, centre):
    """Return shifts (mm) of the middle of each placement's picture, and turns (rad)."""
    found = []
    first = field.placements[0].scan_from_canvas
    for placement, motion in zip(field.placements[1:], motions[1:], strict=True):
        true = motions[0] @ motion.inverse()
        estimated = first @ placement.scan_from_canvas.inverse()
        off = estimated.apply(centre) - true.apply(centre)
        turn = estimated.rotation @ true.rotation.T
        found.append((*off, np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))))
    return np.array(found)


@pytest.fixture(scope="module")
def together(table, make_painting, move):
    """Give the painting, the motions of so many placements, and what became of them."""
    painting = make_painting()
    motions = [move(*layout) for layout in LAYOUTS]
    scans = scans_of(table, painting, motions)
    found = {n: extract(table, scans[:n]) for n in (2, 3, 4)}
    return lambda n: (painting, motions[:n], *found[n])


@pytest.mark.parametrize("count", [2, 3, 4])
def test_placements_are_put_together(together, count):
    painting, motions, field, log = together(count)
    assert log.warnings == []
    assert log.metrics["placements"] == count
    assert [p.name for p in field.placements] == ["first", *(f"part {i}" for i in range(1, count))]
    off = motion_errors(field, motions, np.zeros(3))
    assert np.abs(off[:, :2]).max() < 0.04
    assert np.abs(off[:, 2]).max() < 0.006
    assert off[:, 3].max() < 5e-4
    error = errors(field, painting, motions[0])
    known = np.isfinite(error)
    assert np.median(np.abs(error[known])) < 0.009
    assert 0.85 < np.sqrt(np.mean((error[known] / field.sigma_mm[known]) ** 2)) < 1.1
    assert log.metrics["registration_rms_um"] < 20
    assert 0.1 < log.metrics["share_overlap"] < 0.6


def test_no_seam_shows(table, together):
    """Across each placement's border the mean error steps by far less than the noise."""
    painting, motions, field, _ = together(4)
    error = errors(field, painting, motions[0])
    points = field.canvas_points()
    for placement in field.placements:
        pixels = table.camera.project(placement.scan_from_canvas.apply(points))
        inside = ((pixels >= 0) & (pixels <= [259, 199])).all(axis=-1)
        near = ndimage.binary_dilation(inside, iterations=4) & ~inside & np.isfinite(error)
        within = inside & ~ndimage.binary_erosion(inside, iterations=4) & np.isfinite(error)
        assert min(near.sum(), within.sum()) > 500
        assert abs(error[near].mean() - error[within].mean()) < 0.002


def test_a_chain_reaches_what_the_first_does_not_touch(table, make_painting, move):
    painting = make_painting(size=(340.0, 100.0))
    motions = [move(100, 0), move(5, 2, 4), move(-95, -3, -6, (1, 1))]
    field, log = extract(table, scans_of(table, painting, motions))
    assert log.metrics["placements"] == 3
    assert field.canvas_size_mm[0] > 300
    off = motion_errors(field, motions, np.zeros(3))
    assert np.abs(off[:, :2]).max() < 0.08
    assert np.abs(off[:, 2]).max() < 0.02


@pytest.mark.parametrize(
    ("relief", "contrast"), [(0.0, 0.4), (0.25, 0.0)], ids=["no relief", "no contrast"]
)
def test_relief_or_albedo_alone_will_do(table, make_painting, move, relief, contrast):
    painting = make_painting(relief=relief, contrast=contrast)
    motions = [move(40, 0), move(-40, 10, -9, (0, 1), 2)]
    field, log = extract(table, scans_of(table, painting, motions))
    assert log.metrics["placements"] == 2
    assert np.abs(motion_errors(field, motions, np.zeros(3))[:, :3]).max() < 0.06


def test_a_small_overlap_and_a_bulge(table, make_painting, move):
    """A seventh of the picture; the canvas is seen askew in both, and its form comes out whole."""
    painting = make_painting(bulge=4.0)
    motions = [move(57, 0), move(-57, 5, -8)]
    field, log = extract(table, scans_of(table, painting, motions))
    assert log.metrics["placements"] == 2
    assert field.form is not None
    assert np.nanmedian(np.abs(errors(field, painting, motions[0]))) < 0.012
    assert np.nanpercentile(np.abs(field.heights_mm), 95) < 0.6


def test_what_does_not_overlap_is_left_out_by_name(table, make_painting, move):
    painting = make_painting()
    other = make_painting(seed=5)
    scans = scans_of(table, painting, [move(70, 0), move(-70, 5, 3)])
    scans.append(table.scan(other, move(60, 0), "another painting", seed=9))
    empty = table.scan(painting, move(2000, 0), "nothing")
    field, log = extract(table, [*scans, empty])
    assert field.placements == ()
    assert [text.split(" is left out: ")[0] for text in sorted(log.warnings)] == [
        "the scan another painting",
        "the scan nothing",
        "the scan part 1",
    ]
    alone, _ = extract(table, scans[:1])
    assert field.heights_mm.tobytes() == alone.heights_mm.tobytes()
    assert field.sigma_mm.tobytes() == alone.sigma_mm.tobytes()


def test_what_overlaps_is_kept_beside_what_does_not(table, make_painting, move):
    painting = make_painting()
    motions = [move(50, 30), move(-45, 25, 7)]
    scans = scans_of(table, painting, motions)
    stray = table.scan(make_painting(seed=5), move(0, 0), "stray", seed=7)
    field, log = extract(table, [scans[0], stray, scans[1]])
    assert [p.name for p in field.placements] == ["first", "part 1"]
    assert log.warnings == ["the scan stray is left out: no overlap with the others was found"]


def test_a_deviation_stated_too_small_is_found_out(table, make_painting, move):
    painting = make_painting()
    motions = [move(40, 20), move(-20, 10, 4)]
    scans = scans_of(table, painting, motions, noise=0.03, stated=0.003)
    field, _ = extract(table, scans)
    error = errors(field, painting, motions[0])
    known = np.isfinite(error)
    assert 0.6 < np.sqrt(np.mean((error[known] / field.sigma_mm[known]) ** 2)) < 1.3


def test_the_same_bytes_again(table, together):
    painting, motions, field, _ = together(2)
    again, _ = extract(table, scans_of(table, painting, motions))
    assert again.heights_mm.tobytes() == field.heights_mm.tobytes()
    assert again.sigma_mm.tobytes() == field.sigma_mm.tobytes()
