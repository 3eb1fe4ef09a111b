"""File names that stay inside their folder: relative, no ``..``, no link, a regular file.

The errors' ``problem`` reads on after the file's name; who calls says the name and where it stood.
"""

from __future__ import annotations

import re
import stat
from pathlib import Path, PurePosixPath

from pipeline.errors import ImpastoError

_MAX_LENGTH = 1024
_DRIVE = re.compile(r"^[A-Za-z]:")
_CONTROL = re.compile(r"[\x00-\x1f\x7f]")


def relative_name(file: str) -> PurePosixPath:
    """Check a file name of a bundle, without touching the disk, and return its parts.

    Raises
    ------
    ImpastoError
        If the name is empty, absolute, or could lead out of the folder on any system.
    """
    problem = None
    parts = PurePosixPath(file).parts
    if not file.strip():
        problem = "is an empty file name"
    elif len(file) > _MAX_LENGTH or _CONTROL.search(file):
        problem = "is a file name too long or with control characters"
    elif file.startswith("/") or _DRIVE.match(file):
        problem = "is an absolute path"
    elif "\\" in file:
        problem = "holds a backslash"
    elif ".." in parts or not parts:
        problem = "leads out of the bundle"
    if problem:
        raise ImpastoError(
            problem,
            expected="a relative path with forward slashes, inside the bundle's folder",
            fix="move the file into the bundle and name it from there",
        )
    return PurePosixPath(file)


def locate(folder: Path, file: str) -> Path:
    """Return the path of a regular file inside ``folder`` that is reached without any link.

    Raises
    ------
    ImpastoError
        If the name is bad, the file is missing, a part of its path is a link, or it is no
        regular file (so that opening it cannot block).
    """
    path = folder
    status = None
    try:
        for part in relative_name(file).parts:
            path = path / part
            status = path.lstat()
            if stat.S_ISLNK(status.st_mode):
                raise ImpastoError(
                    f"is reached through the link {part!r}",
                    expected="the file itself",
                    fix="copy the file into the bundle",
                )
    except (FileNotFoundError, NotADirectoryError):
        raise ImpastoError(
            "is missing", fix="copy it into the bundle, or remove the entry"
        ) from None
    except OSError as error:
        raise ImpastoError(f"cannot be reached ({error.strerror or error})") from error
    if status is None or not stat.S_ISREG(status.st_mode):
        raise ImpastoError("is not a regular file", expected="an image file")
    return path
