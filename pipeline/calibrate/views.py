"""The board views of a bundle: corners in the camera, and in the projector where it is wanted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from pipeline.calibrate.boards import find_corners
from pipeline.calibrate.bundle_adjustment import BoardView
from pipeline.calibrate.projector_corners import projector_corners
from pipeline.errors import ImpastoError
from pipeline.formats.bundle import Bundle
from pipeline.formats.capture import Sequence
from pipeline.formats.images import to_grey
from pipeline.formats.patterns import Phase, White
from pipeline.structured_light.decode import decode_sequence


@dataclass
class Views:
    """Views by camera, and what was left out: sequence name to reason."""

    by_camera: dict[str, list[BoardView]] = field(default_factory=dict)
    left_out: dict[str, str] = field(default_factory=dict)


def find_views(
    bundle: Bundle,
    sequences: list[Sequence],
    projector_camera: str | None,
    progress: Callable[[int, int], None],
) -> Views:
    """Find the board of every sequence; decode those of ``projector_camera`` that have patterns."""
    views = Views()
    for index, sequence in enumerate(sequences):
        progress(index, len(sequences))
        board = bundle.capture.boards[sequence.board or ""]
        corners = find_corners(_board_image(bundle, sequence), board)
        if corners is None:
            views.left_out[sequence.name] = "its board was not found"
            continue
        decoded = None
        patterned = any(frame.pattern.type in ("gray", "phase") for frame in sequence.frames)
        if sequence.camera == projector_camera and patterned:
            try:
                decoded, _ = projector_corners(decode_sequence(bundle, sequence), corners.pixels)
            except ImpastoError as error:
                views.left_out[sequence.name] = f"its patterns cannot be decoded ({error})"
                continue
        views.by_camera.setdefault(sequence.camera, []).append(
            BoardView(sequence.name, corners.points, corners.pixels, decoded)
        )
    return views


def _board_image(bundle: Bundle, sequence: Sequence) -> np.ndarray:
    """Return the image to look for the board in: white if there is one, else the fringes' mean."""
    white = [frame for frame in sequence.frames if isinstance(frame.pattern, White)]
    if white:
        # The longest exposure that is not mostly saturated.
        images = [to_grey(bundle.read(frame.file)) for frame in white]
        fine = [image for image in images if np.mean(image > 0.98) < 0.02]
        return max(fine, key=np.mean) if fine else min(images, key=np.mean)
    fringes = [frame for frame in sequence.frames if isinstance(frame.pattern, Phase)]
    chosen = fringes or list(sequence.frames)
    return np.asarray(np.mean([to_grey(bundle.read(frame.file)) for frame in chosen], axis=0))
