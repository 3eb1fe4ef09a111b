"""The small captures are what their script makes, and valid."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.formats.bundle import open_bundle

ROOT = Path(__file__).resolve().parents[1]
NAMES = ("canvas", "boards")


@pytest.mark.parametrize("name", NAMES)
def test_the_bundle_is_valid(small_capture, name):
    bundle = open_bundle(small_capture(name) / "bundle")
    for file in bundle.files("scan", "calibrate", "photos"):
        assert bundle.read(file).max() <= 1


def test_they_are_small():
    size = sum(path.stat().st_size for path in (ROOT / "fixtures").rglob("*") if path.is_file())
    assert size < 12e6


@pytest.mark.parametrize("name", NAMES)
def test_the_script_makes_them_again(small_capture, tmp_path, name):
    command = [sys.executable, str(ROOT / "fixtures" / "make.py"), name, "--out", str(tmp_path)]
    subprocess.run(command, check=True, capture_output=True, timeout=200)
    kept, made = small_capture(name), tmp_path / name
    files = {str(p.relative_to(kept)) for p in kept.rglob("*") if p.is_file()}
    assert files == {str(p.relative_to(made)) for p in made.rglob("*") if p.is_file()}
    for file in sorted(files):
        if file.endswith(".json"):
            same_numbers(
                json.loads((kept / file).read_text()), json.loads((made / file).read_text())
            )
        elif file.endswith(".png"):
            old, new = (cv2.imread(str(f / file), cv2.IMREAD_UNCHANGED) for f in (kept, made))
            assert old.dtype == new.dtype
            # Another processor rounds differently here and there, and a photon then tips over.
            step = np.abs(old.astype(np.int64) - new)
            assert np.count_nonzero(step) <= 0.002 * step.size, file
            assert step.max() <= 0.02 * np.iinfo(old.dtype).max, file
        else:
            with np.load(kept / file) as old, np.load(made / file) as new:
                for key in old.files:
                    np.testing.assert_allclose(
                        old[key].astype(float), new[key].astype(float), rtol=2e-3, atol=2e-3
                    )


def same_numbers(old, new):
    """Compare two documents, numbers to the last digits."""
    if isinstance(old, dict):
        assert old.keys() == new.keys()
        for key in old:
            same_numbers(old[key], new[key])
    elif isinstance(old, list):
        assert len(old) == len(new)
        for a, b in zip(old, new, strict=True):
            same_numbers(a, b)
    elif isinstance(old, float):
        assert new == pytest.approx(old, rel=1e-5, abs=1e-7)
    else:
        assert old == new


def test_an_unknown_name_is_wrong_usage():
    command = [sys.executable, str(ROOT / "fixtures" / "make.py"), "nothing"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 2
    assert "no such capture: nothing" in done.stderr
