"""Small ``.npz`` files of plain arrays: the same bytes every time, and safe to read.

Only stored (uncompressed) members are read, so that nothing can be larger than the file, and the
arrays' headers are checked before anything is made of them; no pickle.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from pipeline.errors import ImpastoError

_DATE = (1980, 1, 1, 0, 0, 0)
_LONGEST_HEADER = 4096
_MOST_MEMBERS = 64

Layout = Mapping[str, tuple[str, tuple[int | None, ...]]]


def write_npz(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write arrays by name; ``numpy.load`` reads them too."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        for name, array in arrays.items():
            buffer = io.BytesIO()
            # A 0-d array must stay one: ascontiguousarray would give it an axis.
            npy.write_array(buffer, np.array(array, order="C"), (1, 0), allow_pickle=False)
            archive.writestr(zipfile.ZipInfo(f"{name}.npy", _DATE), buffer.getvalue())


def read_npz(path: Path, layout: Layout, *, longest: int) -> dict[str, NDArray[Any]]:
    """Read the arrays of a layout.

    Parameters
    ----------
    path
        The file.
    layout
        Type and shape by name; None stands for any length.
    longest
        Most entries along such an axis.

    Raises
    ------
    ImpastoError
        If the file is missing or damaged, an array is missing, or its type or shape is another.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            members = {info.filename: info for info in archive.infolist()}
            if len(members) > _MOST_MEMBERS:
                raise _damaged(path, f"holds {len(members)} arrays")
            return {
                name: _read_member(archive, members.get(f"{name}.npy"), name, wanted, longest, path)
                for name, wanted in layout.items()
            }
    except OSError as error:
        raise ImpastoError(
            f"cannot be read ({error.strerror or error})", where=str(path)
        ) from error
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, ValueError) as error:
        raise _damaged(path, f"is not a sound .npz file ({error})") from error


def _read_member(
    archive: zipfile.ZipFile,
    info: zipfile.ZipInfo | None,
    name: str,
    wanted: tuple[str, tuple[int | None, ...]],
    longest: int,
    path: Path,
) -> NDArray[Any]:
    dtype, shape = np.dtype(wanted[0]), wanted[1]
    if info is None:
        raise _damaged(path, f"the array {name!r} is missing")
    if info.compress_type != zipfile.ZIP_STORED or info.file_size != info.compress_size:
        raise _damaged(path, f"the array {name!r} is compressed")
    most = _LONGEST_HEADER + dtype.itemsize * int(np.prod([n or longest for n in shape]))
    if info.file_size > most:
        raise _damaged(path, f"the array {name!r} has {info.file_size} bytes")
    data = archive.read(info)
    stream = io.BytesIO(data)
    if npy.read_magic(stream) != (1, 0):
        raise _damaged(path, f"the array {name!r} is of another version")
    found_shape, by_column, found = npy.read_array_header_1_0(stream)
    fits = len(found_shape) == len(shape) and all(
        n in (None, m) for n, m in zip(shape, found_shape, strict=True)
    )
    payload = memoryview(data)[stream.tell() :]
    if (
        found != dtype
        or not fits
        or by_column
        or len(payload) != dtype.itemsize * int(np.prod(found_shape, dtype=np.float64))
    ):
        raise _damaged(path, f"the array {name!r} is {found} of shape {found_shape}")
    return np.frombuffer(payload, dtype).reshape(found_shape).copy()


def _damaged(path: Path, problem: str) -> ImpastoError:
    return ImpastoError(problem, where=str(path), fix="copy the file again, or make it anew")
