"""An artifact: one result in the workspace, with how it is loaded and saved.

The fixed names of the workspace are the artifacts' ``files``; other programs rely on them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

T = TypeVar("T")


@dataclass(frozen=True)
class Artifact(Generic[T]):
    """One result: its files, and how to load and save them.

    Parameters
    ----------
    files
        Paths relative to the workspace, all in one stage's folder.
    load
        Takes the workspace folder and returns the value, checking sizes before allocating.
    save
        Takes a workspace folder and the value, and writes exactly ``files``; the same value
        always gives the same bytes.
    """

    files: tuple[str, ...]
    load: Callable[[Path], T]
    save: Callable[[Path, T], None]
