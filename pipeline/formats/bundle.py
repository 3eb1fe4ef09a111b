"""Reading a capture bundle: one object that knows the document and streams the images."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.formats.capture import Capture, Sequence


class Bundle:
    """A validated capture bundle; images are read when asked for, never held.

    Parameters
    ----------
    folder
        The bundle's folder.
    capture
        Its validated document.
    """

    def __init__(self, folder: Path, capture: Capture) -> None:
        self.folder = folder
        self.capture = capture

    def sequences(self, purpose: str) -> tuple[Sequence, ...]:
        """Return the sequences of one purpose, in the document's order."""
        return tuple(s for s in self.capture.sequences if s.purpose == purpose)

    def files(self, *purposes: str) -> tuple[str, ...]:
        """List the image files that these purposes (or ``photos``) use, sorted, without repeats."""
        raise NotImplementedError

    def read(self, file: str) -> NDArray[np.float32]:
        """Read an image as linear light, 1.0 = full scale: (rows, columns[, 3 RGB]) float32."""
        raise NotImplementedError

    def read_stored(
        self, file: str
    ) -> NDArray[np.uint8] | NDArray[np.uint16] | NDArray[np.float32]:
        """Read an image as stored (RGB order, native depth); see :meth:`full_scale`."""
        raise NotImplementedError

    def full_scale(self, file: str) -> float:
        """Return the stored value that means 1.0: 255, 65535 or 1.0."""
        raise NotImplementedError


def open_bundle(folder: Path) -> Bundle:
    """Read and validate the bundle in ``folder``: document, references, files, image headers.

    Raises
    ------
    ImpastoError
        Naming the file and the key, for every breach of the bundle page.
    """
    raise NotImplementedError
