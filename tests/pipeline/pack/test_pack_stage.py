from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from pipeline.classify.cells import boxes_of
from pipeline.errors import ImpastoError
from pipeline.formats.asset import ASSET
from pipeline.formats.boxes import Relief
from pipeline.formats.calibration import Calibration
from pipeline.formats.height_field import HeightField, Placement
from pipeline.formats.placement_scans import PlacementScan
from pipeline.formats.range_image import RangeImage, Texture
from pipeline.formats.reflectance_maps import ReflectanceMaps
from pipeline.geometry.camera import Camera, Lens
from pipeline.geometry.rigid import RigidTransform
from pipeline.pack.stage import Config, Inputs, run

ROWS, COLUMNS = 40, 60


class Recorder:
    def __init__(self) -> None:
        self.metrics, self.skips = {}, []

    def progress(self, done, total, what="") -> None: ...

    def warning(self, text) -> None: ...

    def metric(self, name, value) -> None:
        self.metrics[name] = value

    def skipped(self, what, why) -> None:
        self.skips.append((what, why))


def inputs(maps: ReflectanceMaps | None = None, projector: bool = True) -> Inputs:
    heights = np.random.default_rng(0).normal(0, 0.1, (ROWS, COLUMNS)).astype(np.float32)
    heights[:, :5] = np.nan
    field = HeightField(
        heights, np.full_like(heights, 0.1), np.zeros(heights.shape, bool), 1.0,
        RigidTransform(np.diag([1.0, -1, -1]), np.array([-30.0, -20, 300])),
    )  # fmt: skip
    lens = Lens((200, 160), np.array([[500.0, 0, 99.5], [0, 500, 79.5], [0, 0, 1]]))
    beside = RigidTransform(np.eye(3), np.array([-100.0, 0, 0]))
    calibration = Calibration(
        frame="camera",
        scan_camera="C0",
        lenses={"C0": lens},
        poses={"C0": RigidTransform()},
        projector=Camera(lens, beside) if projector else None,
    )
    radiance = np.random.default_rng(1).uniform(1, 9, (160, 200)).astype(np.float32)
    return Inputs(
        bundle=SimpleNamespace(capture=SimpleNamespace(name="toy")),
        calibration=calibration,
        height_field=field,
        relief=Relief(boxes_of(heights, heights > 0.2, 0.2, 8), {}),
        texture=Texture(radiance, "white"),
        placements=(),
        maps=maps,
    )


def fitted(absolute: bool) -> ReflectanceMaps:
    shape = (ROWS, COLUMNS, 3)
    rng = np.random.default_rng(2)
    diffuse = rng.uniform(0.1, 0.2, shape).astype(np.float32)
    specular = np.full(shape, 0.05, np.float32)
    lobe = np.broadcast_to(np.array([-1, 1, 30], np.float32), shape).copy()
    count = np.full(shape[:2], 9, np.int32)
    for image in (diffuse, specular, lobe):
        image[:, :5] = np.nan
        image[10:14, 20:30] = np.nan
    count[10:14, 20:30] = 0
    observed = np.ones(shape[:2], bool)
    return ReflectanceMaps(diffuse, specular, lobe, diffuse[..., 0], count, observed, absolute)


def test_without_photographs_the_paint_is_matte_and_says_so(tmp_path) -> None:
    log = Recorder()
    asset = run(inputs(), Config(), log).asset
    assert asset.notes["reflectance"] == "white image"
    assert asset.notes["absolute"] is False
    assert "percentile 99" in asset.notes["reflectance_assumption"]
    assert log.skips
    assert not asset.specular.any()
    canvas = asset.mask
    assert canvas.sum() == ROWS * (COLUMNS - 5)
    for image in (asset.heights_mm, asset.normals, asset.diffuse, asset.lobe):
        assert np.isfinite(image).all()
        assert not image[~canvas].any()
    bright = np.percentile(np.pi * asset.diffuse[canvas].max(axis=-1), 99)
    assert bright == pytest.approx(0.85, rel=1e-4)
    assert np.pi * asset.diffuse.max() <= 1 + 1e-6
    (tmp_path / "asset").mkdir()
    ASSET.save(tmp_path, asset)
    assert ASSET.load(tmp_path).notes == asset.notes


def test_absolute_maps_are_used_as_they_are() -> None:
    maps = fitted(absolute=True)
    asset = run(inputs(maps), Config(), Recorder()).asset
    seen = (maps.count > 0) & asset.mask
    assert np.array_equal(asset.diffuse[seen], maps.diffuse[seen])
    assert np.array_equal(asset.specular[seen], maps.specular[seen])
    assert np.array_equal(asset.lobe[seen], maps.lobe[seen])
    assert asset.notes["reflectance"] == "fitted"
    assert asset.notes["absolute"] is True
    assert "reflectance_scale" not in asset.notes


def test_texels_without_a_fit_borrow_the_white_picture_at_the_maps_scale() -> None:
    log = Recorder()
    maps = fitted(absolute=True)
    asset = run(inputs(maps), Config(), log).asset
    gap = np.s_[10:14, 20:30]
    assert log.metrics["texels_borrowed"] == 40
    assert asset.lobe[gap].reshape(-1, 3).tolist() == [[0, 0, 1]] * 40
    assert not asset.specular[gap].any()
    rest = asset.diffuse[asset.mask & (maps.count > 0)]
    assert np.median(asset.diffuse[gap]) == pytest.approx(np.median(rest), rel=0.4)


def test_relative_maps_are_brought_to_a_stated_albedo() -> None:
    absolute = run(inputs(fitted(absolute=True)), Config(), Recorder()).asset
    relative = run(inputs(fitted(absolute=False)), Config(), Recorder()).asset
    factor = relative.notes["reflectance_scale"]
    assert relative.diffuse == pytest.approx(absolute.diffuse * factor, rel=1e-5)
    assert relative.specular == pytest.approx(absolute.specular * factor, rel=1e-5)


def test_what_does_not_fit_together_is_refused() -> None:
    with pytest.raises(ImpastoError, match="projector"):
        run(inputs(projector=False), Config(), Recorder())
    maps = fitted(absolute=True)
    other = ReflectanceMaps(
        maps.diffuse[:5], maps.specular[:5], maps.lobe[:5], maps.residual[:5], maps.count[:5],
        maps.lobe_observed[:5], True,
    )  # fmt: skip
    with pytest.raises(ImpastoError, match="60 x 5"):
        run(inputs(other), Config(), Recorder())


def test_placements_need_their_pictures() -> None:
    plain = inputs()
    moved = RigidTransform(np.eye(3), np.array([40.0, 0, 0])) @ plain.height_field.scan_from_canvas
    places = (
        Placement("first", plain.height_field.scan_from_canvas),
        Placement("second", moved),
    )
    several = replace(plain, height_field=replace(plain.height_field, placements=places))
    with pytest.raises(ImpastoError, match="'second'"):
        run(several, Config(), Recorder())
    nothing = RangeImage(np.zeros((160, 200, 3), np.float32), np.zeros((160, 200), np.float32))
    second = PlacementScan("second", nothing, plain.texture)
    asset = run(replace(several, placements=(second,)), Config(), Recorder()).asset
    assert np.isfinite(asset.diffuse).all()
    single = run(plain, Config(), Recorder()).asset
    assert not np.array_equal(asset.diffuse, single.diffuse)
