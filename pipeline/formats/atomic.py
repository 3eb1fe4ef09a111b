"""Files that appear whole or not at all: temporary file in the same folder, fsync, rename."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pipeline.errors import ImpastoError


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Yield a temporary path beside ``path``, and put it in place when the block ends well.

    The temporary name keeps the suffix, since many writers choose their format by it, and starts
    with a dot. Readers see the old file or the whole new one, never a part.

    Parameters
    ----------
    path
        The file to make or replace; its folder must exist.

    Yields
    ------
    Path
        Where the block must write its file.

    Raises
    ------
    ImpastoError
        If the file cannot be written (no folder, no permission, disk full). Any other exception
        of the block passes through; in every case the temporary file is removed.
    """
    temporary = path.with_name(f".{path.stem}.{secrets.token_hex(6)}.tmp{path.suffix}")
    try:
        yield temporary
        _sync(temporary)
        temporary.replace(path)
        _sync(path.parent)
    except OSError as error:
        raise ImpastoError(
            f"the file cannot be written ({error.strerror or error})",
            where=str(path),
            fix="check that the folder exists, may be written to and has space left",
        ) from error
    finally:
        temporary.unlink(missing_ok=True)


def write_text_atomically(path: Path, text: str) -> None:
    """Write UTF-8 text with newlines as they are, atomically.

    Raises
    ------
    ImpastoError
        If the file cannot be written.
    """
    with atomic_path(path) as temporary:
        temporary.write_bytes(text.encode())


def _sync(path: Path) -> None:
    """Bring a file's content, or a folder's list of names, to the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
