"""Reading a capture bundle: one object that knows the document and streams the images."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import ImpastoError
from pipeline.formats.capture import Capture, Sequence, image_uses
from pipeline.formats.image_header import ImageHeader, read_image_header
from pipeline.formats.images import Image, read_image, srgb_to_linear
from pipeline.formats.inside import locate
from pipeline.formats.patterns import pattern_label
from pipeline.formats.strict_json import parse_model, read_text
from pipeline.formats.validate import DOCUMENT, check_capture, check_images, image_error

_PURPOSES = frozenset({"calibrate", "scan", "pose", "light", "photos"})


class Bundle:
    """A validated capture bundle; images are read when asked for, never held.

    Parameters
    ----------
    folder
        The bundle's folder.
    capture
        Its validated document.
    headers
        The images' headers, as :func:`~pipeline.formats.validate.check_images` found them; read
        when needed if left out.
    """

    def __init__(
        self, folder: Path, capture: Capture, headers: dict[str, ImageHeader] | None = None
    ) -> None:
        self.folder = folder
        self.capture = capture
        self._headers = dict(headers or {})

    def sequences(self, purpose: str) -> tuple[Sequence, ...]:
        """Return the sequences of one purpose, in the document's order."""
        return tuple(s for s in self.capture.sequences if s.purpose == purpose)

    def files(self, *purposes: str) -> tuple[str, ...]:
        """List the image files that these purposes use, sorted, without repeats.

        Parameters
        ----------
        *purposes
            Purposes of sequences, or ``photos`` for the photographs with their darks, flats and
            colour target.
        """
        if unknown := set(purposes) - _PURPOSES:
            raise ValueError(f"unknown purposes {sorted(unknown)}")
        return tuple(sorted({u.file for u in image_uses(self.capture) if u.purpose in purposes}))

    def where(self, file: str) -> str:
        """Return the first place that names ``file``: ``capture.json: photos[3].file``."""
        keys = (use.key for use in image_uses(self.capture) if use.file == file)
        return f"{DOCUMENT}: {next(keys, file)}"

    def frame_label(self, sequence: Sequence, index: int) -> str:
        """Name a frame for people: ``front/003.png (gray x bit 2 of 7, frame 3 of front)``."""
        frame = sequence.frames[index]
        return f"{frame.file} ({pattern_label(frame.pattern)}, frame {index} of {sequence.name})"

    def header(self, file: str) -> ImageHeader:
        """Return format, size and depth of an image.

        Raises
        ------
        ImpastoError
            If the file is missing, leads out of the bundle, or its header is bad.
        """
        if file not in self._headers:
            try:
                self._headers[file] = read_image_header(locate(self.folder, file))
            except ImpastoError as error:
                raise image_error(self.where(file), file, error) from error
        return self._headers[file]

    def read(self, file: str) -> NDArray[np.float32]:
        """Read an image as linear light, 1.0 = full scale of its depth.

        EXR and RAW are linear whatever the document's ``encoding`` says.

        Returns
        -------
        NDArray
            (rows, columns) or (rows, columns, 3 RGB) float32.

        Raises
        ------
        ImpastoError
            As :meth:`read_stored`.
        """
        stored = self.read_stored(file)
        header = self.header(file)
        if self.capture.encoding == "srgb" and not header.linear:
            if stored.dtype.kind == "f":
                return srgb_to_linear(stored.astype(np.float64)).astype(np.float32)
            return _srgb_table(round(header.full_scale))[stored]
        if header.full_scale == 1.0:
            return stored.astype(np.float32, copy=False)
        return np.divide(stored, np.float32(header.full_scale), dtype=np.float32)

    def read_stored(self, file: str) -> Image:
        """Read an image as stored (RGB order, native depth); see :meth:`full_scale`.

        Raises
        ------
        ImpastoError
            If the file is missing, leads out of the bundle, has changed its size or depth since
            the bundle was opened, is truncated or corrupt, or holds NaN.
        """
        header = self.header(file)
        try:
            path = locate(self.folder, file)
            if read_image_header(path).fitted(header.size_px) != header:
                raise ImpastoError("has changed since the bundle was opened", fix="start again")
            return read_image(path, size_px=header.size_px)
        except ImpastoError as error:
            raise image_error(self.where(file), file, error) from error

    def full_scale(self, file: str) -> float:
        """Return the stored value that means 1.0: 255, 65535 or 1.0."""
        return self.header(file).full_scale


def open_bundle(folder: Path) -> Bundle:
    """Read and validate the bundle in ``folder``: document, references, files, image headers.

    Raises
    ------
    ImpastoError
        Naming the file and the key, for every breach of the bundle page.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise ImpastoError(
            "the folder does not exist" if not folder.exists() else "is not a folder",
            where=str(folder),
            expected=f"a capture bundle, a folder with {DOCUMENT}",
        )
    try:
        path = locate(folder, DOCUMENT)
    except ImpastoError as error:
        raise ImpastoError(
            error.problem,
            where=str(folder / DOCUMENT),
            expected=f"a capture bundle, a folder with {DOCUMENT}",
        ) from None
    capture = parse_model(Capture, read_text(path, where=DOCUMENT), where=DOCUMENT)
    check_capture(capture)
    return Bundle(folder, capture, check_images(folder, capture))


@lru_cache(maxsize=2)
def _srgb_table(full_scale: int) -> NDArray[np.float32]:
    """Linear values of all stored values of an integer depth."""
    table = srgb_to_linear(np.arange(full_scale + 1) / full_scale).astype(np.float32)
    table.flags.writeable = False
    return table
