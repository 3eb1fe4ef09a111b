"""Writing a capture bundle: images first, the document last, so that a bundle is never half."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import ImpastoError
from pipeline.formats.atomic import atomic_path, write_text_atomically
from pipeline.formats.capture import Capture
from pipeline.formats.images import write_png
from pipeline.formats.inside import relative_name
from pipeline.formats.strict_json import parse_model
from pipeline.formats.validate import DOCUMENT, check_capture, check_images, image_error


class BundleWriter:
    """Writes one bundle.

    Parameters
    ----------
    folder
        Made if absent; must not hold a bundle already.

    Raises
    ------
    ImpastoError
        If the folder holds a ``capture.json`` or cannot be made.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = Path(folder)
        self._closed = False
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ImpastoError(
                f"the folder cannot be made ({error.strerror or error})", where=str(folder)
            ) from error
        if (self.folder / DOCUMENT).exists() or (self.folder / DOCUMENT).is_symlink():
            raise ImpastoError(
                f"the folder holds a {DOCUMENT} already",
                where=str(folder),
                expected="a folder without a bundle",
                fix="choose another folder; a recording is never overwritten",
            )

    def add_image(self, file: str, array: NDArray[np.uint8] | NDArray[np.uint16]) -> None:
        """Write one PNG.

        Parameters
        ----------
        file
            Its name inside the bundle, ending in ``.png``.
        array
            (rows, columns) grey or (rows, columns, 3) RGB, uint8 or uint16.

        Raises
        ------
        ImpastoError
            If the name leads out of the folder or the file cannot be written.
        ValueError
            If the array is no such image, the name no PNG's, or the writer closed.
        """
        if self._closed:
            raise ValueError("the bundle is closed")
        try:
            name = relative_name(file)
        except ImpastoError as error:
            raise image_error(str(self.folder), file, error) from None
        if name.suffix != ".png":
            raise ValueError(f"{file!r} does not end in .png")
        path = self.folder
        for part in name.parts[:-1]:
            path = path / part
            if path.is_symlink():
                raise ImpastoError(
                    f"{part!r} is a link", where=str(path), fix="choose another folder"
                )
            path.mkdir(exist_ok=True)
        with atomic_path(path / name.name) as temporary:
            write_png(temporary, array)

    def close(self, capture: Capture | dict[str, Any]) -> None:
        """Validate the document and the images, and write ``capture.json``.

        Keys without a value are left out; unknown keys are kept.

        Parameters
        ----------
        capture
            The document; ``format`` and ``version`` included.

        Raises
        ------
        ImpastoError
            As :func:`~pipeline.formats.bundle.open_bundle` would; nothing is written then.
        """
        if self._closed:
            raise ValueError("the bundle is closed")
        if isinstance(capture, Capture):
            document = capture.model_dump(mode="json", exclude_none=True)
        else:
            document = capture
        text = json.dumps(document, indent=1, ensure_ascii=False) + "\n"
        checked = parse_model(Capture, text, where=DOCUMENT)
        check_capture(checked)
        check_images(self.folder, checked)
        write_text_atomically(self.folder / DOCUMENT, text)
        self._closed = True
