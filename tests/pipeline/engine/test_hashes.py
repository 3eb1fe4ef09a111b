"""The cache of hashes: right above all, and quick."""

from __future__ import annotations

import hashlib
import os
import time
from pathlib import Path

import pytest

from pipeline.engine import hashes
from pipeline.engine.hashes import HashCache


@pytest.fixture
def settled(monkeypatch: pytest.MonkeyPatch) -> None:
    """Trust files at once, however new."""
    monkeypatch.setattr(hashes, "_TOO_FRESH_NS", -1)


def count_reads(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    reads: list[str] = []
    digest = hashlib.file_digest

    def counted(file, name):  # type: ignore[no-untyped-def]
        reads.append(file.name)
        return digest(file, name)

    monkeypatch.setattr(hashlib, "file_digest", counted)
    return reads


@pytest.mark.usefixtures("settled")
def test_reads_a_file_once_even_across_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"paint")
    reads = count_reads(monkeypatch)
    cache = HashCache(tmp_path / "cache")
    assert cache.sha256(path) == hashlib.sha256(b"paint").hexdigest()
    cache.save()
    again = HashCache(tmp_path / "cache")
    assert again.sha256(path) == hashlib.sha256(b"paint").hexdigest()
    assert len(reads) == 1


@pytest.mark.usefixtures("settled")
def test_sees_a_change_that_keeps_size_and_time(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"paint")
    cache = HashCache(tmp_path / "cache")
    cache.sha256(path)
    times = path.stat()
    time.sleep(0.02)  # longer than a tick of the file system's clock
    path.write_bytes(b"Paint")
    os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
    assert cache.sha256(path) == hashlib.sha256(b"Paint").hexdigest()


@pytest.mark.usefixtures("settled")
def test_sees_a_replacement(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"paint")
    cache = HashCache(tmp_path / "cache")
    cache.sha256(path)
    (tmp_path / "b").write_bytes(b"Paint")
    (tmp_path / "b").replace(path)
    assert cache.sha256(path) == hashlib.sha256(b"Paint").hexdigest()


def test_does_not_trust_a_file_changed_a_moment_ago(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a"
    cache = HashCache(tmp_path / "cache")
    reads = count_reads(monkeypatch)
    path.write_bytes(b"paint")
    cache.sha256(path)
    cache.sha256(path)
    assert len(reads) == 2
    time.sleep(0.05)
    cache.sha256(path)
    cache.sha256(path)
    assert len(reads) == 3


@pytest.mark.usefixtures("settled")
def test_follows_a_renamed_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "new").mkdir()
    path = tmp_path / "new" / "a"
    path.write_bytes(b"paint")
    cache = HashCache(tmp_path / "cache")
    cache.sha256(path)
    (tmp_path / "new").rename(tmp_path / "place")
    cache.moved(tmp_path / "new", tmp_path / "place")
    reads = count_reads(monkeypatch)
    assert cache.sha256(tmp_path / "place/a") == hashlib.sha256(b"paint").hexdigest()
    assert not reads


@pytest.mark.parametrize("text", ["", "[]", '{"files": {"a": [1]}, "lists": {}}', "\x00", "3"])
def test_damaged_cache_is_an_empty_one(tmp_path: Path, text: str) -> None:
    (tmp_path / "cache").write_text(text)
    (tmp_path / "a").write_bytes(b"paint")
    cache = HashCache(tmp_path / "cache")
    assert cache.sha256(tmp_path / "a") == hashlib.sha256(b"paint").hexdigest()
    cache.remember("key", ["x"])
    cache.save()
    assert HashCache(tmp_path / "cache").recall("key") == ["x"]
