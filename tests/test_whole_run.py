"""From a small capture to an asset, in a process of its own; errors against the truth."""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pipeline.formats.asset import load_asset
from pipeline.formats.calibration import CALIBRATION
from pipeline.formats.height_field import HEIGHT
from pipeline.formats.reflectance_maps import MAPS
from pipeline.report.truth import errors_against_truth

ROOT = Path(__file__).resolve().parents[1]


def impasto(*arguments: object, **environment: str) -> subprocess.Popen[str]:
    """Start the command line."""
    return subprocess.Popen(
        [sys.executable, "-P", "-m", "pipeline", *map(str, arguments)],
        env=os.environ | {"PYTHONPATH": str(ROOT)} | environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def finished(process: subprocess.Popen[str], status: int = 0) -> tuple[str, str]:
    """Wait for the command; return what it printed."""
    out, err = process.communicate(timeout=200)
    assert process.returncode == status, err
    return out, err


@pytest.fixture(scope="module")
def canvas(
    small_capture: Callable[[str], Path], tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, Path, str]:
    """Process the canvas: its workspace, its truth, and what was printed."""
    out, capture = tmp_path_factory.mktemp("canvas"), small_capture("canvas")
    printed, _ = finished(impasto("run", capture / "bundle", "--out", out))
    return out, capture / "truth", printed


def test_heights_agree_with_the_truth(canvas):
    workspace, truth, _ = canvas
    errors = errors_against_truth(HEIGHT.load(workspace), truth, maps=MAPS.load(workspace))
    assert errors.coverage > 0.97
    assert errors.median_mm < 0.06
    assert errors.p99_mm < 0.4
    assert abs(errors.bias_mm) < 0.005
    assert errors.diffuse is not None
    assert errors.diffuse.absolute
    assert errors.diffuse.scale == pytest.approx(1, abs=0.05)


def test_the_asset_has_relief_and_reflectance(canvas):
    asset = load_asset(canvas[0] / "asset")
    assert len(asset.boxes)
    inside = np.isfinite(asset.heights_mm)
    assert inside.mean() > 0.97
    assert np.isfinite(asset.diffuse[inside]).all()
    assert asset.specular is not None


def test_what_was_not_needed_is_said(canvas):
    assert "calibration from boards: the bundle gives the calibration" in canvas[2]


def test_nothing_is_done_twice(canvas):
    before = {p: p.stat().st_mtime_ns for p in canvas[0].rglob("*") if p.is_file()}
    bundle = canvas[1].parent / "bundle"
    out, _ = finished(impasto("run", bundle, "--out", canvas[0]))
    assert "nothing to do: all 7 stages are up to date" in out
    after = {p: p.stat().st_mtime_ns for p in canvas[0].rglob("*") if p.is_file()}
    assert {p for p in after if ".engine" not in p.parts and after[p] != before.get(p)} == set()


def test_one_thread_gives_the_same_bytes(small_capture, tmp_path, snapshot):
    bundle = small_capture("boards") / "bundle"
    one = {"NUMBA_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    finished(impasto("run", bundle, "--out", tmp_path / "one", **one))
    finished(impasto("run", bundle, "--out", tmp_path / "all"))
    assert snapshot(tmp_path / "one") == snapshot(tmp_path / "all")


def test_one_thread_samples_and_fits_the_same(canvas, tmp_path, snapshot):
    bundle = canvas[1].parent / "bundle"
    finished(impasto("run", bundle, "--out", tmp_path, NUMBA_NUM_THREADS="1"))
    one_thread, all_threads = snapshot(tmp_path), snapshot(canvas[0])
    for name in one_thread.keys() | all_threads.keys():
        # workspace.json says where the bundle lies from there.
        assert name == "workspace.json" or one_thread[name] == all_threads[name], name


def test_camera_and_projector_are_found_from_boards(small_capture, tmp_path):
    capture = small_capture("boards")
    finished(impasto("run", capture / "bundle", "--out", tmp_path))
    errors = errors_against_truth(HEIGHT.load(tmp_path), capture / "truth")
    assert errors.coverage > 0.97
    assert errors.median_mm < 0.08
    assert errors.p99_mm < 0.4
    found = CALIBRATION.load(tmp_path)
    truth = json.loads((capture / "truth" / "truth.json").read_text())
    assert found.projector is not None
    for lens, device in (
        (found.lenses["C0"], truth["cameras"]["C0"]),
        (found.projector.lens, truth["projector"]),
    ):
        focal = np.diag(np.array(device["K"]))[:2]
        np.testing.assert_allclose(np.diag(lens.K)[:2], focal, rtol=0.02)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_run_killed_at_any_moment_resumes_to_the_same_bytes(canvas, tmp_path, snapshot):
    expected = snapshot(canvas[0])
    killed_runs(canvas[1].parent / "bundle", tmp_path, expected, snapshot, kills=20)


@pytest.mark.slow
@pytest.mark.shared_data
@pytest.mark.timeout(1200)
def test_a_killed_run_of_a_real_recording_resumes(shared_data, tmp_path, snapshot):
    undisturbed, bundle = tmp_path / "undisturbed", shared_data("eye")
    finished(impasto("run", bundle, "--out", undisturbed))
    killed_runs(bundle, tmp_path, snapshot(undisturbed), snapshot, kills=20)


def killed_runs(bundle, folder, expected, snapshot, kills):
    """Kill a run again and again in one workspace, and start afresh whenever one gets through."""

    def same() -> bool:
        # workspace.json says where the bundle lies from there.
        found = snapshot(out)
        return found.keys() == expected.keys() and all(
            found[name] == expected[name] for name in expected if name != "workspace.json"
        )

    moments, out, done, longest = random.Random(7), folder / "killed", 0, 8.0
    while done < kills:
        started = time.monotonic()
        process = impasto("run", bundle, "--out", out)
        try:
            process.wait(timeout=moments.uniform(0.1, longest))
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate(timeout=20)
            done += 1
            continue
        process.communicate(timeout=20)
        assert process.returncode == 0
        longest = max(0.5, time.monotonic() - started)
        assert same()
        shutil.rmtree(out)
    finished(impasto("run", bundle, "--out", out))
    assert same()
    assert not [p for p in out.rglob("*") if ".tmp" in p.name]


@pytest.mark.parametrize(
    ("change", "key"),
    [
        (lambda d: d.pop("cameras"), "cameras"),
        (lambda d: d.update(version=2), "version"),
        (lambda d: d["sequences"][0]["frames"][0].update(file="../x.png"), "frames[0].file"),
        (lambda d: d["sequences"][0]["frames"][0].update(file="gone.png"), "frames[0].file"),
        (lambda d: d["cameras"]["C0"].update(size_px=[9, 9]), "size_px"),
    ],
)
def test_bad_input_ends_with_one_line(small_capture, tmp_path, change, key):
    bundle = tmp_path / "bundle"
    shutil.copytree(small_capture("canvas") / "bundle", bundle)
    document = json.loads((bundle / "capture.json").read_text())
    change(document)
    (bundle / "capture.json").write_text(json.dumps(document))
    _, err = finished(impasto("run", bundle, "--out", tmp_path / "out"), status=1)
    assert len(err.strip().splitlines()) == 1
    assert "capture.json" in err
    assert key in err
