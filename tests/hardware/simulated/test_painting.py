from __future__ import annotations

import numpy as np
import pytest

from hardware.simulated import motif
from hardware.simulated.brush import Layers, Strokes, lay
from hardware.simulated.motif import CANVAS_MM
from hardware.simulated.painting import FRAME_TOP_MM, HIGHEST_MM, WALL_MM, Painting, paint

SPACING = 0.5


@pytest.fixture(scope="module")
def painting() -> Painting:
    return paint(1, SPACING)


def test_the_same_seed_paints_the_same_picture(painting: Painting) -> None:
    again = paint(1, SPACING)
    for name in ("heights_mm", "diffuse", "specular", "lobe", "normals", "canvas"):
        assert getattr(again, name).tobytes() == getattr(painting, name).tobytes()


def test_another_seed_lays_other_strokes(painting: Painting) -> None:
    other = paint(2, SPACING)
    assert np.mean(other.heights_mm != painting.heights_mm) > 0.3
    assert (other.canvas == painting.canvas).all()


def test_relief_has_impasto_and_thin_places(painting: Painting) -> None:
    heights = painting.heights_mm[painting.canvas]
    assert heights.min() > -0.05
    assert 1.0 < heights.max() <= HIGHEST_MM + 0.05
    assert np.mean(heights < 0.15) > 0.05
    assert np.mean(heights > 0.8) > 0.05


def test_the_frame_stands_around_the_canvas(painting: Painting) -> None:
    x, y = np.meshgrid(painting.x_mm, painting.y_mm)
    rim = np.maximum(np.abs(x) - CANVAS_MM[0] / 2, np.abs(y) - CANVAS_MM[1] / 2)
    on_frame = (rim > 1) & (rim < 9)
    assert painting.heights_mm[on_frame].min() > 2.0
    assert painting.heights_mm[on_frame].max() == pytest.approx(FRAME_TOP_MM, rel=0.05)
    assert not painting.canvas[rim > -1.5].any()
    assert painting.canvas[rim < -1.6].all()
    border = np.ones_like(on_frame)
    border[1:-1, 1:-1] = False
    assert (painting.heights_mm[border] == -WALL_MM).all()


def test_the_grid_is_centred_and_its_first_row_is_the_top(painting: Painting) -> None:
    assert painting.x_mm[0] == -painting.x_mm[-1]
    assert painting.y_mm[0] == -painting.y_mm[-1] > 0
    # The sky is bluer than the field below it.
    blue = painting.diffuse[..., 2] - painting.diffuse[..., 0]
    rows = len(painting.y_mm)
    columns = np.s_[120:300]
    assert blue[rows // 6 : rows // 4, columns].mean() > 0 > blue[-rows // 4 :, columns].mean()


def test_reflectance_is_physical(painting: Painting) -> None:
    assert painting.diffuse.min() > 0
    assert painting.diffuse.max() * np.pi < 0.9
    k = painting.lobe[..., 2]
    # Albedo of the lobe at normal view: 2 pi rho_s / (k + 1), at most.
    total = painting.diffuse * np.pi + painting.specular * (2 * np.pi / (k + 1))[..., None]
    assert total.max() < 1.0
    assert np.ptp(k[painting.canvas]) > 10


def test_normals_are_those_of_the_heights(painting: Painting) -> None:
    assert np.linalg.norm(painting.normals, axis=2) == pytest.approx(1.0, abs=1e-5)
    h = painting.heights_mm.astype(float)
    inner = np.s_[100:-100, 100:-100]
    by_x = ((np.roll(h, -1, 1) - np.roll(h, 1, 1)) / (2 * SPACING))[inner]
    by_y = ((np.roll(h, 1, 0) - np.roll(h, -1, 0)) / (2 * SPACING))[inner]
    n = painting.normals[inner]
    np.testing.assert_allclose(-n[..., 0] / n[..., 2], by_x, atol=1e-4)
    np.testing.assert_allclose(-n[..., 1] / n[..., 2], by_y, atol=1e-4)


def test_weave_shows_on_the_glazed_lake() -> None:
    fine = paint(1, 0.3)
    x, y = np.meshgrid(fine.x_mm, fine.y_mm)
    lake = (np.abs(x + 15) < 14) & (np.abs(y + 12) < 2)
    rough = fine.heights_mm[lake] - np.median(fine.heights_mm[lake])
    assert 0.004 < rough.std() < 0.08


@pytest.mark.parametrize("name", ["SKY", "SUN_DISC", "FAR", "LAKE", "HILL", "FIELD", "CYPRESS"])
def test_every_region_is_to_be_seen(name: str) -> None:
    x, y = np.meshgrid(np.linspace(-80, 80, 161), np.linspace(-60, 60, 121))
    seen = motif.look_at(x, y)
    assert np.mean(seen.region == getattr(motif, name)) > 0.01
    assert np.isfinite(seen.colour).all()
    assert np.isfinite(seen.flow).all()


def test_pigments_are_linear() -> None:
    assert motif.pigment("ffffff") == pytest.approx([1, 1, 1])
    assert motif.pigment("808080") == pytest.approx(0.2158605, rel=1e-5)


def test_a_stroke_covers_its_path_and_nothing_else() -> None:
    layers = Layers(
        np.zeros((40, 60), np.float32),
        np.zeros((40, 60, 3), np.float32),
        np.zeros((40, 60), np.float32),
    )
    path = np.stack([np.linspace(10, 50, 9), np.full(9, 20.0)], axis=1)[None]
    stroke = Strokes(
        path,
        np.array([6.0]),
        np.array([1.0]),
        np.array([[0.5, 0.2, 0.1]]),
        np.array([0.7]),
        np.zeros((1, 6)),
    )
    lay(layers, stroke)
    assert layers.relief[20, 30] > 0.3
    assert layers.colour[20, 30] == pytest.approx([0.5, 0.2, 0.1], rel=0.2)
    assert not layers.relief[:13].any()
    assert not layers.relief[28:].any()
    # The brush pushes paint to the sides.
    assert layers.relief[20 + 4, 25] > layers.relief[20, 25]
