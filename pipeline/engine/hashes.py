"""SHA-256 of files, remembered by their identity so that unchanged ones are not read again."""

from __future__ import annotations

import hashlib
import json
import time
from pathlib import Path
from typing import Any

Identity = tuple[int, int, int, int]

_TOO_FRESH_NS = 20_000_000
"""A file's times tick with the kernel's clock (up to 10 ms). One that was hashed within this time
of its last change may change again without its times showing it, so it is not remembered."""


def identity(path: Path) -> Identity:
    """Return (size, mtime_ns, ctime_ns, inode); a change of content changes it."""
    status = path.stat()
    return status.st_size, status.st_mtime_ns, status.st_ctime_ns, status.st_ino


class HashCache:
    """The hashes known so far, and lists derived from hashed content.

    Parameters
    ----------
    path
        The cache's file. It is only a cache: if absent or damaged it starts empty.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._files: dict[str, tuple[Identity, str]] = {}
        self._lists: dict[str, list[str]] = {}
        self._changed = False
        try:
            stored = json.loads(path.read_text(encoding="utf-8"))
            self._files = {
                file: ((size, modified, changed, inode), digest)
                for file, (size, modified, changed, inode, digest) in stored["files"].items()
            }
            self._lists = {key: [str(item) for item in v] for key, v in stored["lists"].items()}
        except (OSError, ValueError, TypeError, KeyError, AttributeError):
            self._files, self._lists = {}, {}

    def sha256(self, path: Path) -> str:
        """Hash the file, or return the remembered hash if its identity is the remembered one."""
        key, before = str(path), identity(path)
        known = self._files.get(key)
        if known is not None and known[0] == before:
            return known[1]
        started = time.time_ns()
        with path.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
        if started - max(before[1], before[2]) > _TOO_FRESH_NS and identity(path) == before:
            self._files[key] = (before, digest)
            self._changed = True
        return digest

    def moved(self, old: Path, new: Path) -> None:
        """Keep what is known of the files in folder ``old`` after its renaming to ``new``."""
        for key in [key for key in self._files if Path(key).is_relative_to(old)]:
            self._files[str(new / Path(key).relative_to(old))] = self._files.pop(key)
            self._changed = True

    def recall(self, key: str) -> list[str] | None:
        """Return a list remembered under a key that names the content it came from."""
        return self._lists.get(key)

    def remember(self, key: str, items: list[str]) -> None:
        """Remember a list."""
        self._lists[key] = items
        self._changed = True

    def save(self) -> None:
        """Write the cache if anything was learnt."""
        if not self._changed:
            return
        files = {key: [*known, digest] for key, (known, digest) in self._files.items()}
        document: dict[str, Any] = {"files": files, "lists": self._lists}
        temporary = self._path.with_name(self._path.name + ".new")
        temporary.write_text(json.dumps(document), encoding="utf-8")
        temporary.replace(self._path)
        self._changed = False
