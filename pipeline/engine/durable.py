"""Writes that survive a kill: forced to disk, then renamed into place."""

from __future__ import annotations

import os
from pathlib import Path


def sync(path: Path) -> None:
    """Force a file's content, or a folder's list of names, to disk."""
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def sync_tree(folder: Path) -> None:
    """Force a folder with all that is in it to disk."""
    for parent, _, files in os.walk(folder):
        for file in sorted(files):
            sync(Path(parent, file))
        sync(Path(parent))


def rename(old: Path, new: Path) -> None:
    """Rename within one file system and force both folders' lists to disk."""
    old.replace(new)
    sync(new.parent)
    if old.parent != new.parent:
        sync(old.parent)


def write_text(path: Path, text: str) -> None:
    """Replace a small file: the old content or the new, never a part."""
    temporary = path.with_name(f".{path.name}.new")
    temporary.write_text(text, encoding="utf-8")
    sync(temporary)
    rename(temporary, path)
