"""What must hold between the entries of a bundle, and between the document and its images."""

from __future__ import annotations

import re
from collections.abc import Collection
from pathlib import Path, PurePosixPath
from typing import NoReturn

import numpy as np

from pipeline.errors import ImpastoError
from pipeline.formats.capture import (
    Board,
    CameraEntry,
    Capture,
    Charuco,
    Matrix,
    Photo,
    ProjectorEntry,
    Sequence,
    image_uses,
)
from pipeline.formats.exr_header import MAX_PIXELS
from pipeline.formats.image_header import ImageHeader, read_image_header
from pipeline.formats.inside import locate, relative_name
from pipeline.formats.patterns import Gray, Pattern, Phase, Product

DOCUMENT = "capture.json"
_ORTHONORMAL = 1e-3
_NOT_A_NAME = re.compile(r"[\x00-\x1f\x7f]")
# Markers per OpenCV dictionary.
_DICTIONARIES = {
    **{f"DICT_{n}X{n}_{count}": count for n in (4, 5, 6, 7) for count in (50, 100, 250, 1000)},
    "DICT_ARUCO_ORIGINAL": 1024,
    "DICT_ARUCO_MIP_36h12": 250,
    "DICT_APRILTAG_16h5": 30,
    "DICT_APRILTAG_25h9": 35,
    "DICT_APRILTAG_36h10": 2320,
    "DICT_APRILTAG_36h11": 587,
}


def check_capture(capture: Capture) -> None:
    """Check everything that the document says without looking at the images.

    Raises
    ------
    ImpastoError
        For the first contradiction, naming its key.
    """
    _check_names(capture)
    for name, camera in capture.cameras.items():
        _check_device(f"cameras.{name}", camera)
        _check_lens_of(name, capture)
    if capture.projector is not None:
        _check_device("projector", capture.projector)
        _known("projector.camera", capture.projector.camera, "camera", capture.cameras)
    for name, board in capture.boards.items():
        _check_board(f"boards.{name}", board)
    if capture.turntable is not None and not any(capture.turntable.axis_direction):
        _fail("turntable.axis_direction", "has no length", "a direction, such as [0, 0, 1]")
    for i, sequence in enumerate(capture.sequences):
        _check_sequence(f"sequences[{i}]", sequence, capture)
    for i, photo in enumerate(capture.photos):
        _check_photo(f"photos[{i}]", photo, capture)
    for group in ("darks", "flats"):
        for i, entry in enumerate(getattr(capture, group)):
            _known(f"{group}[{i}].camera", entry.camera, "camera", capture.cameras)
    if (target := capture.colour_target) is not None:
        _known("colour_target.camera", target.camera, "camera", capture.cameras)
        _known("colour_target.light", target.light, "light", capture.lights)
    _check_files_agree(capture)


def check_images(folder: Path, capture: Capture) -> dict[str, ImageHeader]:
    """Check that every image is inside the folder and has the right size and depth.

    Only the headers are read.

    Returns
    -------
    dict
        The headers by file name as given in the document.

    Raises
    ------
    ImpastoError
        For the first bad image, naming its key and file.
    """
    headers: dict[str, ImageHeader] = {}
    depth_of: dict[int, tuple[str, str]] = {}
    for use in image_uses(capture):
        where = f"{DOCUMENT}: {use.key}"
        if use.file not in headers:
            try:
                headers[use.file] = read_image_header(locate(folder, use.file))
            except ImpastoError as error:
                raise image_error(where, use.file, error) from error
        size_px = capture.cameras[use.camera].size_px
        header = headers[use.file] = headers[use.file].fitted(size_px)
        if header.size_px != size_px:
            raise ImpastoError(
                f"{use.file!r} is {_size(header.size_px)}",
                where=where,
                expected=f"{_size(size_px)} (cameras.{use.camera}.size_px)",
                fix="correct size_px or the image",
            )
        if use.sequence is not None:
            file, depth = depth_of.setdefault(use.sequence, (use.file, header.depth))
            if depth != header.depth:
                raise ImpastoError(
                    f"{use.file!r} is {header.depth}",
                    where=where,
                    expected=f"{depth} as {file!r}, one depth in all frames of a sequence",
                    fix="record the sequence again with one depth",
                )
    return headers


def image_error(where: str, file: str, error: ImpastoError) -> ImpastoError:
    """Say what is wrong with an image together with the place that names it."""
    return ImpastoError(
        f"{file!r} {error.problem}", where=where, expected=error.expected, fix=error.fix
    )


def _check_names(capture: Capture) -> None:
    if "/" in capture.name or "\\" in capture.name or capture.name in (".", ".."):
        _fail("name", f"{capture.name!r} could be a path", "a plain name")
    names = [("name", capture.name)]
    for group in ("cameras", "boards", "lights"):
        names += [(group, name) for name in getattr(capture, group)]
    first: dict[str, int] = {}
    for i, sequence in enumerate(capture.sequences):
        key = f"sequences[{i}].name"
        names.append((key, sequence.name))
        if first.setdefault(sequence.name, i) != i:
            other = first[sequence.name]
            _fail(key, f"{sequence.name!r} is also the name of sequences[{other}]", "another name")
    for key, name in names:
        if not name.strip() or _NOT_A_NAME.search(name):
            _fail(key, f"the name {name!r} is empty or holds control characters", "a plain name")


def _check_device(key: str, device: CameraEntry | ProjectorEntry) -> None:
    """Check the intrinsics and the pose of a camera or projector."""
    if device.size_px[0] * device.size_px[1] > MAX_PIXELS:
        _fail(
            f"{key}.size_px",
            f"{_size(device.size_px)} is too large",
            f"at most {MAX_PIXELS} pixels in all",
        )
    if device.K is None and device.distortion is not None:
        _fail(f"{key}.distortion", "is given without K", "both or neither", "give K or remove it")
    if device.K is not None:
        _check_intrinsics(f"{key}.K", device.K)
    if (device.R is None) != (device.t_mm is None):
        given, absent = ("R", "t_mm") if device.t_mm is None else ("t_mm", "R")
        _fail(f"{key}.{absent}", f"is absent though {given} is given", "both or neither")
    if device.R is not None:
        _check_rotation(f"{key}.R", device.R)


def _check_intrinsics(key: str, K: Matrix) -> None:
    if K[1][0] or K[2] != (0.0, 0.0, 1.0):
        _fail(key, "is not a camera matrix", "[[fx, skew, cx], [0, fy, cy], [0, 0, 1]] in px")
    if K[0][0] <= 0 or K[1][1] <= 0:
        _fail(key, f"has the focal lengths {K[0][0]:g} and {K[1][1]:g}", "positive ones, in px")


def _check_rotation(key: str, R: Matrix) -> None:
    rotation = np.array(R)
    with np.errstate(all="ignore"):
        error = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
        proper = bool(np.linalg.det(rotation) > 0)
    if not error <= _ORTHONORMAL:
        _fail(key, f"is not a rotation (R R^T differs from 1 by {error:.3g})", "an orthonormal R")
    if not proper:
        _fail(key, "is a reflection (determinant -1)", "a rotation, determinant +1")


def _check_lens_of(name: str, capture: Capture) -> None:
    camera = capture.cameras[name]
    if camera.lens_of is None:
        return
    key = f"cameras.{name}.lens_of"
    _known(key, camera.lens_of, "camera", capture.cameras)
    owner = capture.cameras[camera.lens_of]
    if camera.lens_of == name or owner.lens_of is not None:
        _fail(
            key,
            f"{camera.lens_of!r} does not have a lens of its own",
            "a camera without lens_of",
            "name the camera that the lens is calibrated with",
        )
    if camera.K is not None:
        _fail(f"cameras.{name}.K", f"is given though the lens is that of {camera.lens_of!r}")
    if camera.size_px != owner.size_px:
        _fail(
            f"cameras.{name}.size_px",
            f"{_size(camera.size_px)} contradicts lens_of",
            f"{_size(owner.size_px)} as {camera.lens_of!r}, whose lens and body it is",
        )


def _check_board(key: str, board: Board) -> None:
    if not isinstance(board, Charuco):
        return
    if board.marker_mm >= board.square_mm:
        _fail(
            f"{key}.marker_mm", f"{board.marker_mm:g}", f"less than {board.square_mm:g}, square_mm"
        )
    if board.dictionary not in _DICTIONARIES:
        _fail(f"{key}.dictionary", f"{board.dictionary!r} is unknown", "such as DICT_5X5_100")
    markers, available = board.squares[0] * board.squares[1] // 2, _DICTIONARIES[board.dictionary]
    if markers > available:
        _fail(f"{key}.squares", f"need {markers} markers", f"at most {available}, the dictionary's")


def _check_sequence(key: str, sequence: Sequence, capture: Capture) -> None:
    _known(f"{key}.camera", sequence.camera, "camera", capture.cameras)
    _known(f"{key}.board", sequence.board, "board", capture.boards)
    _known(f"{key}.light", sequence.light, "light", capture.lights)
    if sequence.purpose == "calibrate" and sequence.board is None:
        _fail(f"{key}.board", "a calibrate sequence names no board", "a name from boards")
    if sequence.purpose == "light" and sequence.light is None:
        _fail(f"{key}.light", "a light sequence names no light", "a name from lights")
    if sequence.purpose != "calibrate" and capture.projector is None:
        _fail(f"{key}.purpose", f"a {sequence.purpose} sequence needs a projector", None,
              "describe the projector, at least its size_px and camera")  # fmt: skip
    if sequence.on_turntable and sequence.turntable_deg is None:
        _fail(f"{key}.turntable_deg", "is absent though on_turntable is true", "the table's angle")
    steps: dict[tuple[str, float], tuple[int, int]] = {}
    for i, frame in enumerate(sequence.frames):
        _check_pattern(f"{key}.frames[{i}].pattern", frame.pattern, i, steps)


def _check_pattern(
    key: str, pattern: Pattern, frame: int, steps: dict[tuple[str, float], tuple[int, int]]
) -> None:
    """Check one pattern; ``steps`` holds each (axis, period)'s steps and the frame that set it."""
    if isinstance(pattern, Product):
        for i, factor in enumerate(pattern.of):
            _check_pattern(f"{key}.of[{i}]", factor, frame, steps)
    if isinstance(pattern, Gray) and pattern.bit >= pattern.bits:
        _fail(f"{key}.bit", f"{pattern.bit} is too large", f"less than {pattern.bits}, bits")
    if isinstance(pattern, Phase):
        if pattern.step >= pattern.steps:
            expected = f"less than {pattern.steps}, steps"
            _fail(f"{key}.step", f"{pattern.step} is too large", expected)
        known, other = steps.setdefault((pattern.axis, pattern.period_px), (pattern.steps, frame))
        if known != pattern.steps:
            problem = f"{pattern.steps} contradicts frames[{other}]"
            _fail(f"{key}.steps", problem, f"{known}, one number for an axis and period")


def _check_photo(key: str, photo: Photo, capture: Capture) -> None:
    _known(f"{key}.camera", photo.camera, "camera", capture.cameras)
    _known(f"{key}.light", photo.light, "light", capture.lights)
    if photo.pose is None:
        return
    named = {s.name: s for s in capture.sequences}
    _known(f"{key}.pose", photo.pose, "sequence", named)
    pose = named[photo.pose]
    if pose.purpose != "pose":
        _fail(f"{key}.pose", f"{photo.pose!r} is a {pose.purpose} sequence", "a pose sequence")
    if pose.camera != photo.camera:
        _fail(f"{key}.pose", f"{photo.pose!r} is of camera {pose.camera!r}", f"of {photo.camera!r}")


def _check_files_agree(capture: Capture) -> None:
    """Check the names, and that no frame of a sequence is said to be two things."""
    for use in image_uses(capture):
        try:
            relative_name(use.file)
        except ImpastoError as error:
            raise image_error(f"{DOCUMENT}: {use.key}", use.file, error) from None
    for i, sequence in enumerate(capture.sequences):
        seen: dict[PurePosixPath, int] = {}
        for j, frame in enumerate(sequence.frames):
            other = seen.setdefault(PurePosixPath(frame.file), j)
            twin = sequence.frames[other]
            if (twin.pattern, twin.exposure_s) != (frame.pattern, frame.exposure_s):
                _fail(
                    f"sequences[{i}].frames[{j}].file",
                    f"{frame.file!r} is frames[{other}] too, with another pattern or exposure",
                    "one file per frame",
                )


def _known(key: str, name: str | None, noun: str, names: Collection[str]) -> None:
    if name is not None and name not in names:
        listed = ", ".join(sorted(names)[:10])
        _fail(key, f"{name!r} is an unknown {noun}", f"one of: {listed or '(none is given)'}")


def _fail(key: str, problem: str, expected: str | None = None, fix: str | None = None) -> NoReturn:
    raise ImpastoError(problem, where=f"{DOCUMENT}: {key}", expected=expected, fix=fix)


def _size(size_px: tuple[int, int]) -> str:
    return f"{size_px[0]} x {size_px[1]} px"
