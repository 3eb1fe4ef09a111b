from __future__ import annotations

import numpy as np
import pytest

from hardware.simulated.layout import BOARD, Layout, lay_out
from hardware.simulated.painting import paint
from hardware.simulated.rig import Bench, Physics
from hardware.simulated.studio import PAINTING, subjects
from hardware.simulated.subjects import PaintedCanvas
from pipeline.errors import HardwareError
from pipeline.formats.patterns import Black, White


@pytest.fixture(scope="module")
def canvas() -> PaintedCanvas:
    return PaintedCanvas(paint(1, 1.0))


@pytest.fixture(scope="module")
def layout() -> Layout:
    return lay_out((64, 48), (48, 36), (128, 96), boards=2)


def make_bench(layout: Layout, canvas: PaintedCanvas, seed: int = 1) -> Bench:
    return Bench(layout, subjects(layout, canvas), Physics(samples=1), seed)


def test_the_same_seed_and_orders_give_the_same_frames(
    layout: Layout, canvas: PaintedCanvas
) -> None:
    def frames(seed: int) -> list[bytes]:
        rig = make_bench(layout, canvas, seed).rig()
        rig.operator.place(PAINTING)
        taken = []
        for pattern in (White(), Black()):
            rig.projector.show(pattern)
            taken += [rig.cameras["C0"].capture(0.01).image.tobytes() for _ in range(2)]
        return taken

    first = frames(1)
    assert first == frames(1)
    assert first != frames(2)
    # Two frames of one scene differ by their noise.
    assert len(set(first)) == 4


def test_white_is_brighter_than_black_and_black_than_nothing(
    layout: Layout, canvas: PaintedCanvas
) -> None:
    rig = make_bench(layout, canvas).rig()
    rig.operator.place(PAINTING)
    means = []
    for pattern in (White(), Black(), None):
        rig.projector.show(pattern)
        means.append(rig.cameras["C0"].capture(0.02).image.mean())
    assert means[0] > 20 * means[1] > 20 * means[2] > 0


def test_the_lamp_lights_the_photo_camera(layout: Layout, canvas: PaintedCanvas) -> None:
    rig = make_bench(layout, canvas).rig()
    rig.operator.place(PAINTING)
    assert rig.cameras["C1"].capture(0.02).image.mean() < 200
    rig.arc.move_to("L2")
    rig.lamp.switch(True)
    frame = rig.cameras["C1"].capture(0.02)
    assert frame.image.shape == (36, 48, 3)
    assert frame.image.mean() > 2000
    assert frame.exposure_s == 0.02


def test_turning_the_table_turns_the_painting(layout: Layout, canvas: PaintedCanvas) -> None:
    bench = make_bench(layout, canvas)
    rig = bench.rig()
    rig.operator.place(PAINTING)
    rig.projector.show(White())
    before = bench.radiance("C0")
    rig.turntable.move_to(180.0)
    after = bench.radiance("C0")
    assert np.corrcoef(before.ravel(), after.ravel())[0, 1] < 0.9
    rig.turntable.move_to(0.0)
    np.testing.assert_array_equal(bench.radiance("C0"), before)


def test_a_turned_canvas_is_where_the_table_takes_it(layout: Layout) -> None:
    point = np.array([70.0, 20.0, 0.0])
    start, turned = layout.turned(0.0).apply(point), layout.turned(90.0).apply(point)
    np.testing.assert_allclose(turned, [-start[1], start[0], start[2]], atol=1e-12)


def test_cameras_and_projector_see_all_boards(layout: Layout) -> None:
    columns, rows = BOARD.inner_corners
    corner = (
        np.array([[x, y, 0] for x in (0, columns - 1) for y in (0, rows - 1)]) * BOARD.square_mm
    )
    for pose in lay_out((640, 480), (48, 36), (1024, 768), boards=9).boards.values():
        for device in (layout.cameras["C0"], layout.projector):
            pixels = device.project(pose.apply(corner)) / np.array(device.lens.size_px)
            assert ((pixels > 0.02) & (pixels < 0.98)).all()
        assert pose.apply(corner)[:, 2].min() > 2.0


def test_all_stations_see_the_whole_canvas_at_all_angles(layout: Layout) -> None:
    corners = np.array([[x, y, 0.0] for x in (-78, 78) for y in (-58, 58)])
    for name in ("C1", "C2", "C3", "C4"):
        camera = layout.cameras[name]
        for angle in range(0, 360, 45):
            pixels = camera.project(layout.turned(angle).apply(corners))
            assert ((pixels > 0) & (pixels < np.array(camera.lens.size_px) - 1)).all()


def test_the_clock_advances_with_everything_that_takes_time(
    layout: Layout, canvas: PaintedCanvas
) -> None:
    bench = make_bench(layout, canvas)
    rig = bench.rig()
    moves = (
        lambda: rig.operator.place(PAINTING),
        lambda: rig.turntable.move_to(90.0),
        lambda: rig.arc.move_to("L1"),
        lambda: rig.projector.show(White()),
        lambda: rig.cameras["C0"].capture(0.25),
        lambda: rig.lamp.switch(True),
    )
    for move in moves:
        before = bench.clock_s
        move()
        assert bench.clock_s > before
    before = bench.clock_s
    rig.lamp.switch(True)
    rig.turntable.move_to(90.0)
    assert bench.clock_s == before


@pytest.mark.parametrize(
    ("order", "match"),
    [
        (lambda rig: rig.operator.place("cat"), "no 'cat'.*board-0, board-1, painting"),
        (lambda rig: rig.arc.move_to("L9"), "no stop 'L9'.*L0"),
        (lambda rig: rig.cameras["C0"].capture(0.0), "cannot expose"),
        (lambda rig: rig.cameras["C0"].capture(1e9), "cannot expose"),
        (lambda rig: rig.cameras["C0"].capture(0.1), "nothing lies"),
    ],
)
def test_impossible_orders_are_hardware_errors(
    layout: Layout, canvas: PaintedCanvas, order, match: str
) -> None:
    with pytest.raises(HardwareError, match=match):
        order(make_bench(layout, canvas).rig())


def test_the_scan_camera_refuses_the_lamp(layout: Layout, canvas: PaintedCanvas) -> None:
    rig = make_bench(layout, canvas).rig()
    rig.operator.place(PAINTING)
    rig.arc.move_to("L1")
    rig.lamp.switch(True)
    with pytest.raises(HardwareError, match="switch the lamp off"):
        rig.cameras["C0"].capture(0.1)
