from __future__ import annotations

import pytest

from pipeline.errors import ImpastoError
from pipeline.formats.capture import Frame, Sequence
from pipeline.formats.patterns import Black, Gray, Phase, Product, White
from pipeline.structured_light.plan import make_plan, repeats_after

SIZE = (256, 192)


def sequence(*patterns):
    frames = tuple(Frame(file=f"{i}.png", pattern=p) for i, p in enumerate(patterns))
    return Sequence(name="front", purpose="scan", camera="C0", frames=frames)


def phase(period, steps, **more):
    return [Phase(axis="x", period_px=period, step=i, steps=steps, **more) for i in range(steps)]


def gray(bits, cell_px=1, **more):
    return [Gray(axis="x", bit=b, bits=bits, cell_px=cell_px, **more) for b in range(bits)]


def test_frames_are_sorted_and_all_are_read_once():
    shown = sequence(*phase(16, 3), Black(), *gray(5, 8), White(), *gray(5, 8, inverted=True))
    plan = make_plan(shown, SIZE)
    assert [f.pattern.type for f in plan.frames()[:2]] == ["white", "black"]
    assert sorted(f.file for f in plan.frames()) == sorted(f.file for f in shown.frames)
    assert sorted(plan.axes["x"].plain) == sorted(plan.axes["x"].inverted) == list(range(5))


def test_a_product_with_white_is_the_other_pattern():
    plan = make_plan(
        sequence(*(Product(of=(Product(of=(White(), White())), p)) for p in phase(256, 3))), SIZE
    )
    assert list(plan.axes["x"].phases) == [256]


@pytest.mark.parametrize(
    ("patterns", "message"),
    [
        ([White(), Black()], "no frame shows a Gray code or a phase"),
        (phase(256, 2), "has 2 steps"),
        (phase(256, 4)[:1] * 4, "has 1 steps"),
        (phase(32, 4), "repeats itself after 32 px"),
        (phase(32, 4) + phase(16, 4), "repeats itself after 32 px"),
        (phase(16, 4) + phase(24, 4), "repeats itself after 48 px"),
        ([White(), Black(), *gray(8)[:3], *gray(8)[4:]], "bits \\[3\\] of the Gray code"),
        (gray(8), "nothing tells light from dark"),
        ([White(), *gray(8)], "nothing tells light from dark"),
        ([White(), Black(), *gray(7)], "code 128 of 256 px"),
        ([White(), Black(), *gray(8), *gray(7)], "has a Gray code of 7 bits"),
        ([*gray(3, 32), *phase(16, 4)], "do not tell the periods of 16 px"),
        ([Product(of=(gray(8)[0], phase(8, 4)[0]))], "shows a product of patterns"),
    ],
)
def test_what_is_missing_is_named(patterns, message):
    with pytest.raises(ImpastoError, match=message) as caught:
        make_plan(sequence(*patterns), SIZE)
    assert "sequence 'front'" in str(caught.value)


def test_periods_that_tell_the_whole_projector_apart():
    assert repeats_after([17.0, 19.0, 23.0], 1920) == 1920
    assert repeats_after([30.0, 60.0], 1920) == 60
    assert repeats_after([300.0], 256) == 256
