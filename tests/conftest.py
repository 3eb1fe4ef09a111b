"""What all tests share."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SHARED_DATA = ROOT.parent / "shared" / "data"


Snapshot = dict[str, bytes]


@pytest.fixture
def shared_data() -> Callable[[str], Path]:
    """Give the folder of a development capture, or skip the test where it is absent."""

    def find(name: str) -> Path:
        folder = SHARED_DATA / name
        if not folder.is_dir():
            pytest.skip(f"the development capture {name!r} is not at {folder}")
        return folder

    return find


@pytest.fixture(scope="session")
def small_capture() -> Callable[[str], Path]:
    """Give the folder, with ``bundle`` and ``truth``, of a small capture of the project's own."""
    return lambda name: ROOT / "fixtures" / name


@pytest.fixture
def snapshot() -> Callable[[Path], Snapshot]:
    """Read a workspace: all bytes outside ``.engine``, the manifests without their ``run``."""

    def read(folder: Path) -> Snapshot:
        found = {}
        for path in sorted(folder.rglob("*")):
            name = str(path.relative_to(folder))
            if not path.is_file() or name.startswith(".engine"):
                continue
            content = path.read_bytes()
            if path.name == "manifest.json":
                document = json.loads(content)
                assert set(document.pop("run")) == {
                    "started",
                    "elapsed_s",
                    "peak_memory_bytes",
                    "peak_memory_is",
                }
                content = json.dumps(document).encode()
            found[name] = content
        return found

    return read
