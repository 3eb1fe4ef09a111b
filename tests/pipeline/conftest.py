"""The toy recipe, where the engine's and the commands' tests find it."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

ENGINE_TESTS = Path(__file__).parent / "engine"
ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def toy(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Make ``toy_stages`` importable, also for child processes, and return it."""
    import importlib

    monkeypatch.syspath_prepend(str(ENGINE_TESTS))
    return importlib.import_module("toy_stages")


@pytest.fixture
def toy_bundle(toy: ModuleType, tmp_path: Path) -> Path:
    """Write a small bundle."""
    return toy.write_bundle(tmp_path / "bundle")


@pytest.fixture
def toy_process() -> Callable[..., subprocess.Popen[str]]:
    """Start the command line with the toy recipe in a process of its own."""

    def start(*arguments: object, own_group: bool = False) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, str(ENGINE_TESTS / "toy_stages.py"), *map(str, arguments)],
            env=os.environ | {"PYTHONPATH": f"{ROOT}{os.pathsep}{ENGINE_TESTS}"},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=own_group,
        )

    return start
