from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from pipeline.errors import ImpastoError
from pipeline.formats.patterns import Black, Gray, Phase, Product, White
from pipeline.structured_light.decode import decode_sequence


def gray(axis="x", bits=8, cell_px=1, inverted=(False,)):
    return [
        Gray(axis=axis, bit=bit, bits=bits, cell_px=cell_px, inverted=inv)
        for bit in range(bits)
        for inv in inverted
    ]


def phase(period, steps, axis="x", offset=0.0, sign=1):
    return [
        Phase(axis=axis, period_px=period, step=i, steps=steps, phase_offset=offset, sign=sign)
        for i in range(steps)
    ]


LEVELS = [White(), Black()]
PHASED = {
    "3 steps, cell half the period": gray(bits=5, cell_px=8) + phase(16, 3),
    "4 steps, cell equal to the period": LEVELS + gray(bits=5, cell_px=8) + phase(8, 4),
    "4 steps, inverse, cell equal": gray(bits=5, cell_px=8, inverted=(False, True)) + phase(8, 4),
    "only inverted bits": LEVELS + gray(bits=5, cell_px=8, inverted=(True,)) + phase(16, 4),
    "5 steps, cell not aligned with the period": gray(bits=5, cell_px=10) + phase(24, 5),
    "12 steps, offset and mirrored": gray(bits=5, cell_px=8) + phase(16, 12, offset=0.4, sign=-1),
    "period that is no whole number": gray(bits=6, cell_px=5) + phase(13.7, 4),
    "longest period covers the projector": phase(256, 4) + phase(32, 4) + phase(8, 4),
    "three periods, heterodyne": phase(17, 4) + phase(19, 4) + phase(23, 4),
    "one period over all": phase(256, 8),
    "Gray and two periods, the finer one shorter than a cell": gray(bits=4, cell_px=16)
    + phase(32, 4)
    + phase(10, 4),
    "white times phase": [Product(of=(White(), p)) for p in phase(256, 4)],
}


@pytest.mark.parametrize("patterns", PHASED.values(), ids=PHASED.keys())
def test_every_pattern_set_with_phase_is_decoded(scene, patterns):
    s = scene()
    found = decode_sequence(*s.bundle(patterns))
    error = found.x - s.x
    known = np.isfinite(error)
    assert known.mean() > 0.98
    assert found.y is None
    assert found.sigma_y is None
    # Noise alone: no pixel is in a wrong period.
    assert np.abs(error[known] / found.sigma_x[known]).max() < 7


def test_y_alone_and_both_axes(scene):
    s = scene()
    along_y = gray("y", 5, 8) + phase(16, 4, "y")
    alone = decode_sequence(*s.bundle(along_y))
    assert alone.x is None
    assert np.nanmax(np.abs(alone.y - s.y)) < 0.3
    both = decode_sequence(*s.bundle(gray("x", 5, 8) + phase(16, 4) + along_y))
    assert np.nanmax(np.abs(both.x - s.x)) < 0.3
    assert np.nanmax(np.abs(both.y - s.y)) < 0.3


@pytest.mark.parametrize(
    "patterns",
    [
        gray(inverted=(False, True)),
        LEVELS + gray(),
        LEVELS + gray(bits=6, cell_px=4),
        LEVELS + gray(bits=6, cell_px=4, inverted=(False, True)),
    ],
    ids=["inverse", "levels", "cells of 4", "levels and inverse"],
)
def test_gray_alone_gives_the_cell_centre(scene, patterns):
    cell = patterns[-1].cell_px
    s = scene()
    found = decode_sequence(*s.bundle(patterns))
    known = np.isfinite(found.x)
    assert known.mean() > 0.98
    assert np.abs(found.x - s.x)[known].max() <= cell / 2 + 1e-3
    assert np.allclose(found.sigma_x[known], cell / np.sqrt(12))
    spread = np.std((found.x - s.x)[known] / found.sigma_x[known])
    assert 0.9 < spread < 1.1


@pytest.mark.parametrize("steps", [3, 4, 6, 12])
@pytest.mark.parametrize("bits", [8, 12])
def test_sigma_is_the_standard_deviation_of_the_error(scene, steps, bits):
    s = scene(rows=120, columns=160, bits=bits, full_well_e=6000.0, projected=0.3)
    found = decode_sequence(*s.bundle(gray(bits=5, cell_px=8) + phase(16, steps)))
    normalised = ((found.x - s.x) / found.sigma_x)[np.isfinite(found.x)]
    assert 0.85 < np.mean(normalised**2) < 1.15
    assert abs(normalised.mean()) < 0.1


def test_sigma_is_right_where_the_bundle_says_nothing_of_the_noise(scene):
    albedo = np.broadcast_to(np.geomspace(0.05, 0.8, 160), (120, 160))
    s = scene(
        rows=120,
        columns=160,
        projected=albedo,
        ambient=0.1 * albedo,
        full_well_e=3000.0,
        read_noise_e=12.0,
        declared={"bits": 12},
    )
    found = decode_sequence(*s.bundle(gray(bits=5, cell_px=8) + phase(16, 8)))
    normalised = (found.x - s.x) / found.sigma_x
    for part in np.array_split(normalised, 4, axis=1):
        assert 0.8 < np.nanmean(part**2) < 1.2


def test_exposures_are_merged_and_saturated_steps_left_out(scene):
    rng = np.random.default_rng(1)
    albedo = np.exp(rng.uniform(np.log(0.004), np.log(3.0), (60, 80)))
    s = scene(projected=albedo, ambient=0.02 * albedo)
    patterns = LEVELS + gray(bits=5, cell_px=8) + phase(16, 4)
    found = decode_sequence(*s.bundle(patterns, exposures=(0.25, 1.0, 4.0)))
    error = found.x - s.x
    known = np.isfinite(error)
    assert known.mean() > 0.97
    assert np.abs(error[known] / found.sigma_x[known]).max() < 7
    assert 0.8 < np.mean((error[known] / found.sigma_x[known]) ** 2) < 1.2
    assert found.statistics["share_steps_saturated_x"] > 0.05
    # The light is the projector's alone, per second, whatever the exposures that showed it.
    assert found.radiance_source == "white"
    assert np.nanmedian(np.abs(found.radiance / albedo - 1)) < 0.01
    one = decode_sequence(*s.bundle(patterns, exposures=(0.25,)))
    dark = known & np.isfinite(one.x) & (albedo < 0.05)
    assert np.median(found.sigma_x[dark]) < 0.6 * np.median(one.sigma_x[dark])


def test_radiance_comes_from_the_fringes_without_white(scene):
    s = scene(projected=0.6)
    found = decode_sequence(*s.bundle(phase(256, 6), exposures=(0.5,)))
    assert found.radiance_source == "fringes"
    assert np.allclose(np.nanmedian(found.radiance), 0.6, rtol=0.01)


def test_frames_of_uneven_brightness_leave_no_ripple(scene):
    gains = np.ones(17)
    gains[[5, 10, 15]] = 1.03, 0.97, 0.97
    s = scene(rows=120, columns=240, noise=False, bits=16)
    patterns = gray(bits=5, cell_px=8) + phase(16, 12)
    found = decode_sequence(*s.bundle(patterns, gains=gains))
    assert np.nanstd(found.x - s.x) < 0.002
    assert found.statistics["frame_brightness_spread_x"] == pytest.approx(0.03, abs=0.005)


def test_brightness_that_drifts_slowly_is_found_from_the_circle(scene):
    gains = np.concatenate([np.ones(5), 1 + 0.02 * np.cos(2 * np.pi * np.arange(12) / 12 + 0.7)])
    s = scene(rows=120, columns=240, noise=False, bits=16)
    patterns = gray(bits=5, cell_px=8) + phase(16, 12)
    found = decode_sequence(*s.bundle(patterns, gains=gains))
    # Uncorrected: 0.02 / 2 * offset / amplitude = 0.011 rad, 0.02 px RMS.
    assert np.nanstd(found.x - s.x) < 0.003


@pytest.mark.parametrize("levels", [LEVELS, []], ids=["levels", "fringes alone"])
@pytest.mark.parametrize(("steps", "harmonic"), [(3, 2), (4, 3)])
def test_the_projectors_harmonic_is_removed(scene, steps, harmonic, levels):
    def response(light):
        angle = np.arccos(np.clip(2 * light - 1, -1, 1))
        return light + 0.03 * np.where((light > 0) & (light < 1), np.cos(harmonic * angle), 0)

    s = scene(rows=120, columns=240, noise=False, bits=16, response=response)
    found = decode_sequence(*s.bundle(levels + gray(bits=5, cell_px=8) + phase(16, steps)))
    # Uncorrected: 0.06 rad, 0.11 px RMS.
    assert np.nanstd(found.x - s.x) < 0.01
    assert found.statistics["harmonic_x"] == pytest.approx(0.06, abs=0.006)


def test_most_of_a_projectors_gamma_is_removed_with_three_steps(scene):
    s = scene(rows=120, columns=240, noise=False, bits=16, response=lambda light: light**1.8)
    found = decode_sequence(*s.bundle(LEVELS + gray(bits=5, cell_px=8) + phase(16, 3)))
    # Uncorrected: (gamma - 1) / (gamma + 2) = 0.21 rad, 0.38 px RMS.
    assert np.nanstd(found.x - s.x) < 0.04


def test_frames_in_the_wrong_order_show(scene):
    s = scene(rows=120, columns=160)
    patterns = gray(bits=5, cell_px=8) + phase(16, 8)
    bundle, sequence = s.bundle(patterns)
    bundle.images["007.png"], bundle.images["008.png"] = (
        bundle.images["008.png"],
        bundle.images["007.png"],
    )
    found = decode_sequence(bundle, sequence)
    assert found.statistics["frame_shift_rad_x"] == pytest.approx(np.pi / 4, abs=0.1)


def test_a_mirrored_code_shows(scene):
    s = scene(x=255 - scene().x)
    bits, steps = gray(bits=5, cell_px=8), phase(16, 4)
    bundle, sequence = s.bundle(bits + steps)
    wrong = [f.model_copy(update={"pattern": f.pattern.model_copy(update={"sign": -1})})
             if isinstance(f.pattern, Phase) else f for f in sequence.frames]  # fmt: skip
    shifted = [f.model_copy(update={"pattern": f.pattern.model_copy(update={"phase_offset": 1.5})})
               if isinstance(f.pattern, Phase) else f for f in wrong]  # fmt: skip
    found = decode_sequence(bundle, sequence.model_copy(update={"frames": tuple(shifted)}))
    assert found.statistics["share_agree_x"] < 0.9


def test_shadow_and_indirect_light_are_left_out(scene):
    projected = np.full((60, 80), 0.5)
    projected[:, :20] = 0.0
    s = scene(projected=projected, ambient=0.2)
    patterns = LEVELS + gray(bits=5, cell_px=8) + phase(16, 4)
    bundle, sequence = s.bundle(patterns)
    # The last columns see the fringes at a tenth of their contrast, as by way of other surfaces.
    for frame in sequence.frames:
        if isinstance(frame.pattern, Phase):
            image = bundle.images[frame.file].astype(np.float64)
            middle = 0.45 * 65520
            image[:, 60:] = middle + 0.1 * (image[:, 60:] - middle)
            bundle.images[frame.file] = image.astype(np.uint16)
    found = decode_sequence(bundle, sequence)
    assert np.isfinite(found.x[:, :20]).mean() < 0.01
    assert np.isfinite(found.x[:, 60:]).mean() < 0.01
    assert np.isfinite(found.x[:, 20:60]).mean() > 0.98
    kept = decode_sequence(bundle, sequence, minimum_modulation=0.0)
    assert np.isfinite(kept.x[:, 60:]).mean() > 0.9


def test_colour_and_srgb_frames(scene):
    patterns = gray(bits=5, cell_px=8) + phase(16, 4)
    colour = decode_sequence(*scene(rgb=True).bundle(patterns))
    grey = decode_sequence(*scene().bundle(patterns))
    assert np.nanmax(np.abs(colour.x - grey.x)) < 1e-4
    decoded = decode_sequence(*scene().bundle(patterns, encoding="srgb"))
    assert np.nanmax(np.abs(decoded.x - grey.x)) < 1e-3


def test_progress_counts_every_frame_once(scene):
    told = []
    patterns = LEVELS + gray(bits=5, cell_px=8) + phase(16, 4)
    decode_sequence(
        *scene().bundle(patterns), progress=lambda done, total: told.append((done, total))
    )
    assert told == [(i + 1, 11) for i in range(11)]


@pytest.mark.parametrize(
    ("scene_options", "exposures"),
    [({"projected": 0.0, "ambient": 0.001}, (1.0,)), ({"projected": 3.0, "ambient": 2.0}, (1.0,))],
    ids=["black", "saturated"],
)
@pytest.mark.parametrize(
    "patterns",
    [LEVELS + gray(bits=5, cell_px=8) + phase(16, 4), LEVELS + gray(), phase(256, 4)],
    ids=["both", "gray", "phase"],
)
def test_without_any_light_and_with_too_much(scene, scene_options, exposures, patterns):
    with pytest.raises(ImpastoError, match="no pixel shows the patterns"):
        decode_sequence(*scene(**scene_options).bundle(patterns, exposures=exposures))


def test_a_failing_read_ends_at_once(scene):
    bundle, sequence = scene().bundle(gray(bits=5, cell_px=8) + phase(16, 4))

    def broken(file):
        raise ImpastoError("is truncated", where=file)

    bundle.read_stored = broken
    with pytest.raises(ImpastoError, match="is truncated"):
        decode_sequence(bundle, sequence)


def test_without_projector(scene):
    bundle, sequence = scene().bundle(phase(256, 4))
    bundle.capture = SimpleNamespace(projector=None)
    with pytest.raises(ImpastoError, match="projector"):
        decode_sequence(bundle, sequence)
