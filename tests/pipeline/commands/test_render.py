from __future__ import annotations

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from pipeline.commands.render import BACKENDS, METHODS, render
from pipeline.errors import ImpastoError
from pipeline.formats.asset import Asset, save_asset
from pipeline.formats.boxes import Boxes
from pipeline.formats.exr import read_exr
from renderers import draw


def grey_asset() -> Asset:
    shape = (21, 31)
    none = np.zeros((0, 2), np.int32)
    return Asset(
        name="grey",
        spacing_mm=1.0,
        heights_mm=np.zeros(shape, np.float32),
        normals=np.zeros((*shape, 2), np.float32),
        mask=np.ones(shape, bool),
        diffuse=np.full((*shape, 3), 0.2, np.float32),
        specular=np.zeros((*shape, 3), np.float32),
        lobe=np.broadcast_to(np.float32([0, 0, 1]), (*shape, 3)).copy(),
        boxes=Boxes(0.0, 0.0, 8, none, none, np.zeros(0, np.float32), none),
        notes={},
    )


@pytest.fixture
def workspace(tmp_path):
    """A workspace whose asset is a grey card."""
    folder = tmp_path / "work" / "asset"
    folder.mkdir(parents=True)
    save_asset(folder, grey_asset())
    return tmp_path / "work"


def run(*arguments):
    return CliRunner().invoke(render, [str(argument) for argument in arguments])


def test_choices_are_the_renderers():
    assert METHODS == draw.ALL_METHODS
    assert BACKENDS == draw.BACKENDS


@pytest.mark.parametrize("inside", ["", "asset"])
def test_png_and_one_line(workspace, tmp_path, inside):
    out = tmp_path / "new" / "a.png"
    result = run(workspace / inside, "--out", out, "--size", "64x48", "--backend", "cpu")
    assert result.exit_code == 0, result.output
    assert result.output.count("\n") == 1
    assert "64 x 48, reference, CPU" in result.output
    assert "in place of 'hybrid'" in result.output
    assert cv2.imread(str(out)).shape == (48, 64, 3)


@pytest.mark.gpu
def test_exr_from_the_gpu(workspace, tmp_path):
    out = tmp_path / "a.exr"
    result = run(
        workspace, "--out", out, "--size", "64x48", "--backend", "gpu", "--light-elevation", 90
    )
    assert result.exit_code == 0, result.output
    centre = read_exr(out, ["R", "A"])
    assert centre["A"][24, 32] == 1
    assert centre["R"][24, 32] == pytest.approx(0.2 * np.pi, rel=2e-3)


def test_distance_in_mm(workspace, tmp_path, monkeypatch):
    seen = []

    def remember(asset, view, lights, **_):
        seen.append(np.linalg.norm(view.camera.centre_mm - [15, -10, 0]))
        return draw.RenderResult(np.zeros((2, 2, 4), np.float32), "cpu", "reference", "CPU", 0.0)

    monkeypatch.setattr(draw, "render", remember)
    for distance in ("333mm", "1", "2"):
        assert run(workspace, "--out", tmp_path / "a.png", "--distance", distance).exit_code == 0
    assert seen[0] == pytest.approx(333)
    assert seen[2] == pytest.approx(2 * seen[1])


@pytest.mark.parametrize(
    "wrong",
    [
        ["--size", "64"],
        ["--size", "0x64"],
        ["--size", "99999x1"],
        ["--size", "-4x4"],
        ["--method", "voxels"],
        ["--backend", "tpu"],
        ["--elevation", "0"],
        ["--elevation", "91"],
        ["--elevation", "nan"],
        ["--azimuth", "inf"],
        ["--distance", "0"],
        ["--distance", "nan"],
        ["--distance", "near"],
        ["--distance", "-3mm"],
        ["--fov", "180"],
        ["--light-elevation", "-5"],
        ["--light-distance", "0"],
        ["--light-intensity", "-1"],
        ["--exposure", "0"],
        ["--samples", "3"],
        ["--samples", "0"],
        ["--bits", "12"],
        ["--method", "reference", "--backend", "gpu"],
        ["--out", "picture.jpg"],
    ],
)
def test_wrong_values_are_usage_errors(workspace, tmp_path, wrong):
    result = run(workspace, "--out", tmp_path / "a.png", *wrong)
    assert result.exit_code == 2, result.output
    assert "Error: " in result.output
    assert not (tmp_path / "a.png").exists()


@pytest.mark.parametrize(("made", "problem"), [(False, "no such folder"), (True, "no asset")])
def test_a_missing_asset_is_one_line(tmp_path, made, problem):
    folder = tmp_path / "nothing"
    if made:
        folder.mkdir()
    result = run(folder, "--out", tmp_path / "a.png")
    assert isinstance(result.exception, ImpastoError)
    assert result.exception.exit_status == 1
    assert problem in str(result.exception)
    assert str(folder) in str(result.exception)
