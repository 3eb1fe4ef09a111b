"""The bundle as the engine sees it: its files and hashes, opened only when a stage has to run."""

from __future__ import annotations

import copy
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.engine.hashes import HashCache
from pipeline.engine.manifest import Files

if TYPE_CHECKING:
    from pipeline.formats.bundle import Bundle

DOCUMENT = "capture.json"


class BundleSource:
    """A capture bundle that may never have to be opened.

    Which files belong to which purposes is remembered per content of ``capture.json``, so that
    an unchanged bundle is recognised from its hashes alone.
    """

    def __init__(self, folder: Path, cache: HashCache) -> None:
        self.folder = folder
        self._cache = cache
        self._bundle: Bundle | None = None

    def open(self) -> Bundle:
        """Read and validate the bundle, once."""
        if self._bundle is None:
            from pipeline.formats.bundle import open_bundle

            self._bundle = open_bundle(self.folder)
        return self._bundle

    def hashes(self, purposes: tuple[str, ...]) -> Files:
        """Return the SHA-256 of the document and of the images of these purposes."""
        try:
            document = self._cache.sha256(self.folder / DOCUMENT)
            key = f"{self.folder}: {', '.join(purposes)}"
            remembered = self._cache.recall(key)
            if remembered is not None and remembered[0] == document:
                names = remembered[1:]
            else:
                names = list(self.open().files(*purposes)) if purposes else []
                self._cache.remember(key, [document, *names])
            return {DOCUMENT: document} | {
                name: self._cache.sha256(self.folder / name) for name in names
            }
        except (FileNotFoundError, NotADirectoryError):
            self.open()  # says what is missing, with file and key
            raise

    def limited_to(self, purposes: tuple[str, ...]) -> Bundle:
        """Return the bundle with only the images of these purposes readable.

        A stage that read others would not be redone when they change.
        """
        bundle = self.open()
        allowed = frozenset(bundle.files(*purposes)) if purposes else frozenset()
        limited = copy.copy(bundle)
        for method in ("read", "read_stored"):
            setattr(limited, method, partial(_read_declared, getattr(bundle, method), allowed))
        return limited


def _read_declared(read: Callable[[str], Any], allowed: frozenset[str], file: str) -> Any:
    if file not in allowed:
        raise RuntimeError(f"{file} is not of a purpose that the stage declares in reads_bundle")
    return read(file)
