from __future__ import annotations

import sys
import threading

import numpy as np
import pytest

from pipeline.errors import HardwareError, UsageError
from renderers import draw
from renderers.adapter import Adapter, GpuUnavailable, within
from renderers.painting import PaintOptions
from renderers.view import arc_light, orbit_view


def no_adapter() -> Adapter:
    raise GpuUnavailable("no graphics adapter was found", fix="install mesa-vulkan-drivers")


@pytest.fixture
def scene(make_asset):
    heights = np.zeros((25, 33))
    heights[10:15, 10:20] = 1.0
    asset = make_asset(heights, d0=0.5)
    return asset, orbit_view(asset, elevation_deg=40, size_px=(64, 48)), [arc_light(asset)]


def test_auto_without_adapter_draws_the_reference_and_says_so(scene):
    result = draw.render(*scene, open_gpu=no_adapter)
    assert (result.backend, result.method, result.adapter) == ("cpu", "reference", "CPU")
    assert any("no graphics adapter was found" in note for note in result.notes)
    assert any("'hybrid'" in note for note in result.notes)
    assert result.image.shape == (48, 64, 4)
    assert result.image[24, 32, 3] == 1


def test_gpu_without_adapter_is_an_error_with_advice(scene):
    with pytest.raises(HardwareError, match="mesa-vulkan-drivers") as caught:
        draw.render(*scene, backend="gpu", open_gpu=no_adapter)
    assert caught.value.exit_status == 3


def test_cpu_never_asks_for_an_adapter(scene):
    def must_not() -> Adapter:
        raise AssertionError

    for method, backend in (("mesh", "cpu"), ("reference", "auto"), ("reference", "cpu")):
        result = draw.render(*scene, method=method, backend=backend, open_gpu=must_not)
        assert result.method == "reference"
        assert bool(result.notes) == (method == "mesh")


@pytest.mark.gpu
def test_gpu_names_its_adapter(scene):
    result = draw.render(*scene, backend="gpu", options=PaintOptions(samples=4))
    assert result.backend == "gpu"
    assert result.method == "hybrid"
    assert result.adapter
    assert result.notes == ()
    assert result.elapsed_s > 0


@pytest.mark.gpu
def test_gpu_and_cpu_show_the_same(scene):
    gpu = draw.render(*scene, method="relief", backend="gpu").image
    cpu = draw.render(*scene, backend="cpu").image
    assert np.median(np.abs(gpu - cpu)) < 1e-3


@pytest.mark.parametrize(
    "arguments",
    [{"method": "voxels"}, {"backend": "tpu"}, {"method": "reference", "backend": "gpu"}],
)
def test_impossible_choices_are_refused(scene, arguments):
    with pytest.raises(UsageError):
        draw.render(*scene, **arguments)


def test_a_driver_that_hangs_is_given_up():
    released = threading.Event()

    def hang() -> Adapter:
        released.wait(30)
        raise AssertionError

    try:
        with pytest.raises(GpuUnavailable, match=r"did not answer in 0\.05 s"):
            within(0.05, hang)
    finally:
        released.set()


def test_a_driver_that_fails_becomes_one_line():
    def fail() -> Adapter:
        raise RuntimeError("vulkan\n  loader\nmissing")

    with pytest.raises(GpuUnavailable, match="vulkan loader missing"):
        within(5, fail)


def test_importing_the_chooser_leaves_wgpu_alone():
    import subprocess

    code = "import sys, renderers.draw, renderers.view; sys.exit('wgpu' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], timeout=60).returncode == 0
