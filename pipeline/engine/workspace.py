"""The workspace: one folder per bundle, in it one folder per stage.

A stage's folder is replaced as a whole. The new one is completed and forced to disk under
``.engine/new``; then the old one is renamed to ``.engine/old`` and the new one into its place. A
kill leaves the old folder or the new one, in its place or (between the two renames) in
``.engine/old``, from where :meth:`Workspace.recover` puts it back.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pipeline.engine import durable
from pipeline.engine.lock import exclusive
from pipeline.engine.manifest import Manifest, read_manifest
from pipeline.errors import ImpastoError

FILE = "workspace.json"
FORMAT, VERSION = "impasto-workspace", 1


class Workspace:
    """An existing workspace; use :func:`open_workspace` or :func:`create_workspace`.

    Parameters
    ----------
    folder
        Its absolute path.
    bundle
        The folder of the capture bundle that it was made from.
    """

    def __init__(self, folder: Path, bundle: Path) -> None:
        self.folder, self.bundle = folder, bundle
        self._engine = folder / ".engine"
        self.staging = self._engine / "new"
        self._replaced = self._engine / "old"
        self.hashes = self._engine / "hashes.json"

    def manifest(self, stage_folder: str) -> Manifest | None:
        """Read a stage's manifest; None if it is absent or damaged."""
        return read_manifest(self.folder / stage_folder)

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Keep every other process from writing here, and mend what a killed one left."""
        self._engine.mkdir(exist_ok=True)
        with exclusive(self._engine / "lock"):
            self.recover()
            yield

    def recover(self) -> None:
        """Put back a folder caught between the two renames; drop what was never completed."""
        for folder in (self.staging, self._replaced):
            folder.mkdir(exist_ok=True)
        for old in sorted(self._replaced.iterdir()):
            if not (self.folder / old.name).exists():
                durable.rename(old, self.folder / old.name)
        for folder in (self.staging, self._replaced):
            _empty(folder)

    def commit(self, stage_folder: str) -> None:
        """Swap the completed folder in ``staging`` in."""
        new, place = self.staging / stage_folder, self.folder / stage_folder
        durable.sync_tree(new)
        if place.exists():
            durable.rename(place, self._replaced / stage_folder)
        durable.rename(new, place)
        _empty(self._replaced)

    def clean_staging(self) -> None:
        """Drop what a failed stage left."""
        _empty(self.staging)


def open_workspace(folder: Path) -> Workspace:
    """Open the workspace in ``folder`` without changing anything.

    Raises
    ------
    ImpastoError
        It is none, or its ``workspace.json`` is damaged.
    """
    folder = folder.resolve()
    path = folder / FILE
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        if (document["format"], document["version"]) != (FORMAT, VERSION):
            raise ValueError(f"format {document['format']!r}, version {document['version']!r}")
        absolute, relative = document["bundle"]["path"], document["bundle"]["relative"]
        # The relative path first: it stays right when both are moved or copied together.
        candidates = (Path(os.path.normpath(folder / str(relative))), Path(str(absolute)))
    except (FileNotFoundError, NotADirectoryError):
        raise ImpastoError(
            "this is not a workspace",
            where=str(folder),
            expected=f"a folder with {FILE}",
            fix="make one with: impasto run BUNDLE --out DIR",
        ) from None
    except (ValueError, TypeError, KeyError) as error:
        raise ImpastoError(
            f"it cannot be read ({error})",
            where=str(path),
            expected=f"format {FORMAT!r}, version {VERSION}",
            fix="delete it and run: impasto run BUNDLE --out DIR",
        ) from error
    bundle = next((path for path in candidates if is_bundle(path)), candidates[1])
    return Workspace(folder, bundle)


def create_workspace(folder: Path, bundle: Path, stage_folders: tuple[str, ...]) -> Workspace:
    """Open the workspace of ``bundle`` in ``folder``, making it if need be.

    ``stage_folders`` are the names that stages will replace.

    Raises
    ------
    ImpastoError
        ``bundle`` is no bundle; ``folder`` lies inside it, belongs to another bundle, or is not a
        workspace and holds something under a stage's name.
    """
    folder, bundle = folder.resolve(), bundle.resolve()
    require_bundle(bundle)
    if folder.is_relative_to(bundle):
        raise ImpastoError(
            "the output lies inside the capture bundle",
            where=str(folder),
            fix="choose an --out outside it: a bundle is never changed",
        )
    if (folder / FILE).exists():
        workspace = open_workspace(folder)
        if workspace.bundle == bundle:
            return workspace
        if is_bundle(workspace.bundle) and not _same_capture(workspace.bundle, bundle):
            raise ImpastoError(
                f"this is the workspace of another bundle, {workspace.bundle}",
                where=str(folder),
                fix="choose another --out, or delete it",
            )
    else:
        taken = [name for name in stage_folders if os.path.lexists(folder / name)]
        if taken:
            raise ImpastoError(
                f"{taken[0]} exists already and was not made by a stage",
                where=str(folder),
                fix="choose another --out",
            )
    folder.mkdir(parents=True, exist_ok=True)
    workspace = Workspace(folder, bundle)
    with workspace.locked():
        document = {
            "format": FORMAT,
            "version": VERSION,
            "bundle": {"path": str(bundle), "relative": os.path.relpath(bundle, folder)},
        }
        text = json.dumps(document, indent=1, ensure_ascii=False)
        durable.write_text(folder / FILE, text + "\n")
    return workspace


def is_bundle(folder: Path) -> bool:
    """Tell whether the folder has a ``capture.json``."""
    return (folder / "capture.json").is_file()


def require_bundle(folder: Path) -> None:
    """Raise an ImpastoError if the folder is not a capture bundle."""
    if is_bundle(folder):
        return
    raise ImpastoError(
        "this is not a capture bundle" if folder.is_dir() else "there is no such folder",
        where=str(folder),
        expected="a folder with capture.json",
    )


def _same_capture(one: Path, other: Path) -> bool:
    first, second = (folder / "capture.json" for folder in (one, other))
    return first.read_bytes() == second.read_bytes()


def _empty(folder: Path) -> None:
    for entry in folder.iterdir():
        if entry.is_dir() and not entry.is_symlink():
            shutil.rmtree(entry)
        else:
            entry.unlink()
