"""The ray caster against searches of all patches, one in rational numbers and one in float64."""

from __future__ import annotations

from dataclasses import dataclass
from decimal import Decimal, localcontext
from fractions import Fraction
from itertools import product

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from pipeline.geometry.ray_walk import first_hit
from pipeline.geometry.raycast import PACKET, RayCaster

CLOSE = Fraction(1, 10**13)
TO_CANVAS = np.array([1.0, -1.0, 1.0])
"""From (column, row, height) at a spacing of 1."""


@dataclass(frozen=True)
class Meeting:
    """The first t, infinite if none; not certain where any rounding would undo it.

    That is: a touch of the curved surface from one side, of its rim, or of a patch at one point; or
    a start that all but lies on the surface.
    """

    t: float
    certain: bool = True


def exact_meeting(field, origin, direction, t_max=np.inf) -> Meeting:
    """Search all patches, each closed, in rational arithmetic; grid units."""
    rows, columns = field.shape
    heights = np.asarray(field, dtype=np.float64)
    heights = np.vstack([heights, heights]) if rows == 1 else heights
    heights = np.hstack([heights, heights]) if columns == 1 else heights
    start, way = [Fraction(float(x)) for x in origin], [Fraction(float(x)) for x in direction]
    if not any(way):
        return Meeting(np.inf)
    met: list[tuple[Fraction, bool, Fraction, Fraction | None]] = []
    for row, column in product(range(heights.shape[0] - 1), range(heights.shape[1] - 1)):
        corners = heights[row : row + 2, column : column + 2]
        if not np.isfinite(corners).all():
            continue
        low, high = Fraction(0), None if t_max == np.inf else Fraction(t_max)
        outside = False
        for axis, cell, last in ((0, column, columns - 1), (1, row, rows - 1)):
            ends = [Fraction(cell), Fraction(min(cell + 1, last))]
            if way[axis] == 0:
                outside |= not ends[0] <= start[axis] <= ends[1]
            else:
                a, b = sorted((end - start[axis]) / way[axis] for end in ends)
                low, high = max(low, a), b if high is None else min(high, b)
        if outside or (high is not None and low > high):
            continue
        h00, h10, h01, h11 = (Fraction(float(h)) for h in corners.ravel())
        u, v = start[0] - column, start[1] - row
        along, down, twist = h10 - h00, h01 - h00, h00 - h10 - h01 + h11
        root, touch = first_root(
            -twist * way[0] * way[1],
            way[2] - along * way[0] - down * way[1] - twist * (u * way[1] + v * way[0]),
            start[2] - h00 - along * u - down * v - twist * u * v,
            low,
            high,
        )
        if root is not None:
            met.append((root, touch, low, high))
    if not met:
        return Meeting(np.inf)
    best = min(root for root, *_ in met)
    before = after = inside = False
    for root, touch, low, high in met:
        if root - best < CLOSE and not touch and low != high:
            starts = root - low < CLOSE and low > 0
            ends = high is not None and high - root < CLOSE
            before, after = before or ends, after or starts
            inside = inside or not (starts or ends)
    at_once = best != 0 and best < CLOSE
    return Meeting(float(best), not at_once and (inside or (before and after)))


def first_root(A, B, C, low, high) -> tuple[Fraction | None, bool]:
    """Return the first root of a quadratic in [low, high], and whether it is (nearly) double."""
    if A == B == C == 0:
        return low, False
    if A == 0 == B:
        return None, False
    touch = False
    if A == 0:
        roots = [-C / B]
    else:
        discriminant = B * B - 4 * A * C
        if discriminant < 0:
            return None, False
        with localcontext() as context:
            context.prec = 60
            exact = Decimal(discriminant.numerator) / Decimal(discriminant.denominator)
            square_root = Fraction(exact.sqrt())
        roots = sorted([(-B - square_root) / (2 * A), (-B + square_root) / (2 * A)])
        touch = discriminant <= Fraction(1, 10**20) * B * B
    slack = Fraction(1, 10**40)
    for root in roots:
        if low - slack <= root and (high is None or root <= high + slack):
            return root, touch
    return None, False


def exhaustive_hits(heights, origins, directions) -> NDArray[np.float64]:
    """Search all patches in float64; grid units; for rays in general position."""
    h00, h10 = heights[:-1, :-1], heights[:-1, 1:]
    h01, h11 = heights[1:, :-1], heights[1:, 1:]
    row, column = np.mgrid[: h00.shape[0], : h00.shape[1]]
    hits = np.full(len(origins), np.inf)
    for n, (o, d) in enumerate(zip(origins, directions, strict=True)):
        # About the ray's point nearest to the patch, where the coefficients do not cancel.
        shift = ((column - o[0]) * d[0] + (row - o[1]) * d[1]) / (d[0] ** 2 + d[1] ** 2)
        u, v, z = o[0] + shift * d[0] - column, o[1] + shift * d[1] - row, o[2] + shift * d[2]
        along, down, twist = h10 - h00, h01 - h00, h00 - h10 - h01 + h11
        A = -twist * d[0] * d[1]
        B = d[2] - along * d[0] - down * d[1] - twist * (u * d[1] + v * d[0])
        C = z - h00 - along * u - down * v - twist * u * v
        with np.errstate(all="ignore"):
            q = -0.5 * (B + np.copysign(np.sqrt(B * B - 4 * A * C), B))
            for s in (q / A, C / q):
                t = s + shift
                inside = (u + s * d[0] >= 0) & (u + s * d[0] <= 1)
                inside &= (v + s * d[1] >= 0) & (v + s * d[1] <= 1) & (t >= 0)
                hits[n] = min(hits[n], np.min(t, where=inside, initial=np.inf))
    return hits


def assert_agrees(field, origins, directions, t_max=np.inf) -> int:
    """Compare with the exact search; return how many rays were certain to hit."""
    origins, directions = np.asarray(origins, float), np.asarray(directions, float)
    got = RayCaster(field, 1.0).first_hit(origins * TO_CANVAS, directions * TO_CANVAS, t_max)
    certain_hits = 0
    for t, origin, direction in zip(got, origins, directions, strict=True):
        want = exact_meeting(field, origin, direction, t_max)
        same = t == want.t or abs(t - want.t) <= 1e-9 * max(abs(want.t), 1e-3)
        assert same or not want.certain, (field, origin, direction, t_max, t, want)
        certain_hits += want.certain and np.isfinite(want.t)
    return certain_hits


RANDOM = np.random.default_rng(7)
ROUGH = RANDOM.normal(size=(5, 6))
FIELDS = {
    "rough": ROUGH,
    "float32": ROUGH.astype(np.float32),
    "spike": np.pad([[40.0]], 2),
    "spikes": np.where(RANDOM.random((6, 5)) < 0.2, 50.0, 0.0),
    "plateau": np.pad(np.full((2, 3), 2.0), 2),
    "flat": np.full((4, 5), 3.0),
    "cliff": np.where(np.arange(6) < 3, 0.0, 1000.0) * np.ones((4, 1)),
    "stairs": np.add.outer(np.arange(4.0), np.arange(5.0)),
    "saddle": np.multiply.outer(np.arange(-2.0, 3), np.arange(-2.0, 3)),
    "holes": np.where(RANDOM.random((6, 6)) < 0.15, np.nan, RANDOM.integers(0, 3, (6, 6))),
    "hole": np.full((3, 3), np.nan),
    "infinite": np.where(np.arange(20).reshape(4, 5) == 7, np.inf, 1.0),
    "one row": np.array([[0.0, 1.0, 3.0, 1.0]]),
    "one column": np.array([[2.0], [0.0], [1.0]]),
    "one sample": np.array([[1.0]]),
    "two samples": np.array([[1.0, 2.0]]),
}


def adversarial_rays(field):
    """Rays along grid lines and through nodes, level, upright, from inside and outside."""
    rows, columns = field.shape
    finite = field[np.isfinite(field)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    last = np.array([columns - 1.0, rows - 1.0])
    places = [
        last / 2,
        np.floor(last / 2),
        np.zeros(2),
        last,
        np.floor(last / 2) + np.array([0.5, 0]),
    ]
    places += [[0.25, 0.625], [-1.0, np.floor(last[1] / 2)], last + 1, [last[0] / 2, -2.0]]
    levels = [high, (low + high) / 2, low, high + 1.5, low - 0.5]
    ways = [(0, 0, -1), (0, 0, 1), (1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (1, 1, 0)]
    ways += [(1, 0, -0.25), (0, -1, 0.5), (-1, 1, -0.5), (2, 1, -1), (0.3, -0.7, -0.2), (0, 0, 0)]
    rays = [((*place, z), way) for place in places for z in levels for way in ways]
    for place, z in product(places, (high + 2, low - 1)):
        nodes = [(0.0, 0.0), tuple(np.floor(last / 2)), (last[0], 0.0)]
        rays += [((*place, z), (*(node - np.array(place)), -(z - low))) for node in nodes]
    return rays


@pytest.mark.parametrize("name", FIELDS)
def test_adversarial_rays_agree_with_exact_search(name):
    field = FIELDS[name]
    rays = adversarial_rays(field)
    chosen = [rays[i] for i in np.random.default_rng(3).permutation(len(rays))[:140]]
    origins, directions = zip(*chosen, strict=True)
    hits = assert_agrees(field, origins, directions)
    if name not in {"hole", "one sample", "two samples"}:
        assert hits >= 5


def quarters(low: float, high: float) -> st.SearchStrategy[float]:
    return st.integers(int(4 * low), int(4 * high)).map(lambda n: n / 4)


@st.composite
def cases(draw):
    rows, columns = draw(st.integers(1, 6)), draw(st.integers(1, 6))
    heights = st.one_of(
        quarters(0, 3), st.floats(-3, 3, width=32), st.sampled_from([0.0, np.nan, 30.0])
    )
    field = np.array(draw(st.lists(heights, min_size=rows * columns, max_size=rows * columns)))
    place = st.tuples(
        st.one_of(quarters(-1, columns), st.floats(-1, columns)),
        st.one_of(quarters(-1, rows), st.floats(-1, rows)),
        st.one_of(quarters(-1, 4), st.floats(-4, 4)),
    )
    component = st.one_of(
        quarters(-2, 2), st.sampled_from([0.0, 1.0, -1.0]), st.floats(-1, 1, width=32)
    )
    rays = draw(st.lists(st.tuples(place, st.tuples(*[component] * 3)), min_size=1, max_size=6))
    return field.reshape(rows, columns), rays, draw(st.sampled_from([np.inf, 1.0, 0.25]))


@settings(max_examples=150, deadline=None)
@given(cases())
def test_any_ray_agrees_with_exact_search(case):
    field, rays, t_max = case
    origins, directions = zip(*rays, strict=True)
    assert_agrees(field, origins, directions, t_max)


@pytest.fixture(scope="module")
def relief() -> NDArray[np.float64]:
    """A rough field of 147 x 101 with steps, so that the mipmap has several uneven levels."""
    random = np.random.default_rng(11)
    steps = np.cumsum(random.normal(size=(147, 101)), axis=0) * 0.3
    return np.where(random.random((147, 101)) < 0.02, steps + 5, steps)


def rays_through(heights, count, seed, slope):
    """Rays in general position, a half of them from outside; grid units."""
    random = np.random.default_rng(seed)
    size = np.array(heights.shape[::-1]) - 1
    target = np.column_stack(
        [random.random((count, 2)) * size, random.choice(heights.ravel(), count)]
    )
    way = np.column_stack([random.normal(size=(count, 2)), -slope * random.random(count) - 1e-3])
    distance = np.where(np.arange(count) % 2 == 0, 300.0, 10 * random.random(count))
    return target - distance[:, None] * way, way


@pytest.mark.parametrize("slope", [5.0, 0.5, 0.02])
def test_a_large_field_agrees_with_a_search_of_all_patches(relief, slope):
    origins, directions = rays_through(relief, 250, 5, slope)
    want = exhaustive_hits(relief, origins, directions)
    got = RayCaster(relief, 1.0).first_hit(origins * TO_CANVAS, directions * TO_CANVAS)
    assert np.count_nonzero(np.isfinite(want)) > 100
    np.testing.assert_array_equal(np.isfinite(got), np.isfinite(want))
    hit = np.isfinite(want)
    np.testing.assert_allclose(got[hit], want[hit], rtol=1e-9)


def test_neighbouring_rays_do_not_matter(relief):
    caster = RayCaster(relief.astype(np.float32), 0.3)
    origins, directions = rays_through(relief, 5 * PACKET + 3, 6, 0.5)
    origins, directions = (TO_CANVAS * [0.3, 0.3, 1] * x for x in (origins, directions))
    together = caster.first_hit(origins, directions)
    alone = [caster.first_hit(o, d)[0] for o, d in zip(origins, directions, strict=True)]
    np.testing.assert_array_equal(together, alone)
    assert 20 < np.count_nonzero(np.isfinite(together)) < len(together)


def test_the_number_of_threads_does_not_matter(relief):
    caster = RayCaster(relief, 1.0)
    origins, directions = (TO_CANVAS * x for x in rays_through(relief, 20_000, 7, 1.0))
    threads = numba.get_num_threads()
    results = []
    try:
        for count in (1, min(2, threads)):
            numba.set_num_threads(count)
            results.append(caster.first_hit(origins, directions))
    finally:
        numba.set_num_threads(threads)
    np.testing.assert_array_equal(*results)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_no_ray_slips_through_edges_and_nodes(relief, dtype):
    heights = relief.astype(dtype)
    random = np.random.default_rng(8)
    count = 40_000
    node = np.column_stack([random.integers(1, 100, count), random.integers(1, 146, count)])
    edge = node + np.where(random.random((count, 1)) < 0.5, [[0.5, 0]], [[0, 0.25]])
    target = np.where(random.random((count, 1)) < 0.5, node, edge).astype(float)
    origin = np.column_stack([random.random((count, 2)) * [100, 146], np.full(count, 60.0)])
    direction = np.column_stack([target, random.choice(heights.ravel(), count)]) - origin
    caster = RayCaster(heights, 1.0)
    t = caster.first_hit(origin * TO_CANVAS, direction * TO_CANVAS, 1e9)
    # Every ray goes on down to far below the field; it must be stopped or leave by the side.
    bottom = (60.0 - heights.min()) / -direction[:, 2]
    end = origin[:, :2] + bottom[:, None] * direction[:, :2]
    stays = ((end > 0) & (end < [100, 146])).all(axis=1)
    assert np.count_nonzero(stays) > 10_000
    assert np.isfinite(t[stays]).all()


def test_upright_rays_measure_the_samples_whatever_the_spacing():
    heights = np.random.default_rng(9).normal(size=(23, 17))
    for spacing in (0.3, 0.1, 1e-3, 123.456):
        rows, columns = np.mgrid[:23, :17].reshape(2, -1)
        points = np.column_stack([columns * spacing, -rows * spacing, np.full(rows.size, 9.0)])
        t = RayCaster(heights, spacing).first_hit(points, np.array([0.0, 0.0, -1.0]))
        np.testing.assert_allclose(9.0 - t, heights.ravel(), rtol=0, atol=1e-14)


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_scaling_the_scene_scales_nothing_else(relief, scale):
    origins, directions = (TO_CANVAS * x for x in rays_through(relief, 500, 10, 0.5))
    want = RayCaster(relief, 1.0).first_hit(origins, directions)
    got = RayCaster(relief * scale, scale).first_hit(origins * scale, directions * scale)
    hit = np.isfinite(want)
    np.testing.assert_array_equal(np.isfinite(got), hit)
    np.testing.assert_allclose(got[hit], want[hit], rtol=1e-9)


def test_moving_the_surface_and_the_rays_changes_nothing(relief):
    origins, directions = (TO_CANVAS * x for x in rays_through(relief, 500, 12, 0.5))
    want = RayCaster(relief, 1.0).first_hit(origins, directions)
    raised = RayCaster(relief + 64, 1.0).first_hit(origins + np.array([0, 0, 64]), directions)
    wider = np.pad(relief, ((16, 0), (8, 0)), constant_values=np.nan)
    moved = RayCaster(wider, 1.0).first_hit(origins + np.array([8, -16, 0]), directions)
    for got in (raised, moved):
        np.testing.assert_array_equal(np.isfinite(got), np.isfinite(want))
        hit = np.isfinite(want)
        np.testing.assert_allclose(got[hit], want[hit], rtol=1e-9)


@pytest.mark.parametrize("factor", [1e-200, 1e-3, 7.0, 1e200])
def test_t_counts_in_lengths_of_the_direction(relief, factor):
    origins, directions = (TO_CANVAS * x for x in rays_through(relief, 100, 13, 0.5))
    caster = RayCaster(relief, 1.0)
    want, got = (
        caster.first_hit(origins, directions),
        caster.first_hit(origins, directions * factor),
    )
    np.testing.assert_allclose(got * factor, want, rtol=1e-9)


def test_t_max_is_included_and_nothing_beyond_it():
    caster = RayCaster(np.zeros((5, 5)), 1.0)
    origin, down = np.array([2.0, -2.0, 8.0]), np.array([0.0, 0.0, -1.0])
    assert caster.first_hit(origin, down, 8.0) == 8.0
    assert caster.first_hit(origin, down, np.nextafter(8.0, 0)) == np.inf
    assert caster.first_hit(origin, -down) == np.inf
    assert caster.first_hit(origin * [1, 1, 0], down) == 0.0
    assert caster.first_hit(origin, down, -1.0) == np.inf
    assert caster.first_hit(origin, down, np.nan) == np.inf


def test_both_sides_are_met(relief):
    caster = RayCaster(relief, 1.0)
    place = np.array([50.3, -70.6])
    up, down = (
        caster.first_hit(np.array([*place, z]), np.array([0.0, 0.0, way]))[0]
        for z, way in ((-1e3, 1.0), (1e3, -1.0))
    )
    assert up + down == pytest.approx(2e3, rel=1e-12)


@pytest.mark.parametrize(
    ("origin", "direction"),
    [
        ([2, -2, 5], [0, 0, 0]),
        ([2, -2, 5], [0, np.nan, -1]),
        ([2, -2, 5], [0, 0, -np.inf]),
        ([np.nan, -2, 5], [0, 0, -1]),
        ([2, np.inf, 5], [0, 0, -1]),
        ([2, -2, np.inf], [1, 1, -1]),
    ],
)
def test_what_is_no_ray_meets_nothing(origin, direction):
    caster = RayCaster(np.zeros((5, 5)), 1.0)
    usual = ([2.0, -2.0, 5.0], [0.1, 0.1, -1.0])
    t = caster.first_hit(np.array([origin, usual[0]]), np.array([direction, usual[1]]))
    assert t[0] == np.inf
    assert t[1] == 5.0


@pytest.mark.parametrize("distance", [1e6, 1e9, 1e12])
def test_rays_from_far_away_arrive(distance):
    caster = RayCaster(np.zeros((9, 9)), 1.0)
    way = np.array([[0.6, 0.0, -0.8], [0.48, -0.36, -0.8], [0.0, 0.0, -1.0]])
    target = np.array([4.0, -4.0, 0.0])
    t = caster.first_hit(target - distance * way, way)
    np.testing.assert_allclose(t, distance, rtol=1e-12)


@pytest.mark.parametrize("shape", [(0, 0), (0, 5), (3, 0)])
def test_a_field_without_samples_is_never_met(shape):
    caster = RayCaster(np.zeros(shape), 1.0)
    assert caster.first_hit(np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, -1.0])) == np.inf


def test_no_rays_give_no_hits():
    caster = RayCaster(np.zeros((3, 3)), 1.0)
    assert caster.first_hit(np.zeros((0, 3)), np.zeros((0, 3))).shape == (0,)
    assert caster.occluded(np.zeros((0, 3)), np.zeros(3), 0.1).shape == (0,)


def test_wrong_shapes_and_sizes_are_refused():
    caster = RayCaster(np.zeros((3, 3)), 1.0)
    with pytest.raises(ValueError, match=r"\(N, 3\)"):
        caster.first_hit(np.zeros((4, 2)), np.zeros((4, 2)))
    with pytest.raises(ValueError, match="broadcast"):
        caster.first_hit(np.zeros((4, 3)), np.zeros((5, 3)))
    with pytest.raises(ValueError, match="margin"):
        caster.occluded(np.zeros(3), np.ones(3), -1.0)
    for spacing in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(ValueError, match="spacing"):
            RayCaster(np.zeros((3, 3)), spacing)
    with pytest.raises(ValueError, match="rows, columns"):
        RayCaster(np.zeros(3), 1.0)


def test_a_wall_shades_as_far_as_the_light_lets_it():
    heights = np.zeros((9, 201))
    heights[:, 100] = 4.0  # a ridge, sloping to 0 within one sample on both sides
    caster = RayCaster(heights, 0.5)
    x = np.arange(0, 100, 0.1) + 0.05
    points = np.column_stack([x, np.full_like(x, -2.0), np.zeros_like(x)])
    light = np.array([-950.0, -2.0, 504.0])  # over the crest at x = 50: 2 along for 1 down
    shaded = caster.occluded(points, light, 1e-6)
    ground = np.abs(x - 50) > 0.5
    np.testing.assert_array_equal(shaded[ground], ((x > 50) & (x < 58))[ground])


def test_occlusion_is_a_hit_on_the_way(relief):
    caster = RayCaster(relief, 1.0)
    random = np.random.default_rng(14)
    points, targets = random.uniform(-5, 110, (2, 3000, 3)) * [1, -1, 0.2]
    margin = 0.25
    way = targets - points
    share = margin / np.linalg.norm(way, axis=1)
    t = caster.first_hit(points + share[:, None] * way, way * (1 - share[:, None]), 1.0)
    blocked = caster.occluded(points, targets, margin)
    assert 300 < np.count_nonzero(blocked) < 2700
    np.testing.assert_array_equal(blocked, np.isfinite(t))


def test_points_of_the_surface_do_not_shade_themselves(relief):
    caster = RayCaster(relief, 1.0)
    origins, directions = (TO_CANVAS * x for x in rays_through(relief, 2000, 15, 2.0))
    t = caster.first_hit(origins, directions)
    hit = np.isfinite(t)
    points = origins[hit] + t[hit, None] * directions[hit]
    assert not caster.occluded(points, origins[hit], 1e-6).any()


def test_ways_shorter_than_the_margin_or_without_end_are_open():
    caster = RayCaster(np.zeros((5, 5)), 1.0)
    point = np.array([2.0, -2.0, 0.5])
    assert caster.occluded(point, point * [1, 1, -1], 0.1)
    assert not caster.occluded(point, point * [1, 1, -1], 1.5)
    assert not caster.occluded(point, point, 0.1)
    assert not caster.occluded(point, np.array([2.0, -2.0, np.nan]), 0.1)
    assert not caster.occluded(point, np.array([2.0, -2.0, -np.inf]), 0.1)


def test_kernels_may_cast_single_rays(relief):
    caster = RayCaster(relief, 1.0)
    origins, directions = rays_through(relief, 50, 16, 0.5)

    @numba.njit
    def cast(field, origins, directions):
        t = np.empty(len(origins))
        for n in range(len(origins)):
            o, d = origins[n], directions[n]
            t[n] = first_hit(field, o[0], o[1], o[2], d[0], d[1], d[2], np.inf)
        return t

    want = caster.first_hit(origins * TO_CANVAS, directions * TO_CANVAS)
    np.testing.assert_allclose(cast(caster.field, origins, directions), want, rtol=1e-12)
