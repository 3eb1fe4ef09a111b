"""The document ``capture.json``, typed: one model per object of the bundle page.

Unknown keys are kept. Contradictions between entries are found in :mod:`.validate`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from pipeline.formats.patterns import Pattern

Vector = tuple[float, float, float]
Matrix = tuple[Vector, Vector, Vector]
Pixels = Annotated[int, Field(ge=1, le=1 << 16)]
Corners = Annotated[int, Field(ge=3, le=1000)]
Squares = Annotated[int, Field(ge=2, le=1000)]
Size = tuple[Pixels, Pixels]
Name = Annotated[str, Field(min_length=1, max_length=200)]


class _Entry(BaseModel):
    model_config = ConfigDict(frozen=True, extra="allow", allow_inf_nan=False)


class CameraEntry(_Entry):
    """A camera: size, and what is known of its intrinsics, pose (rig to camera) and sensor."""

    size_px: Size
    K: Matrix | None = None
    distortion: tuple[float, float, float, float, float] | None = None
    R: Matrix | None = None
    t_mm: Vector | None = None
    lens_of: str | None = None
    responsivity_per_s: float | None = Field(default=None, gt=0)
    full_well_e: float | None = Field(default=None, gt=0)
    read_noise_e: float | None = Field(default=None, ge=0)
    bits: int | None = Field(default=None, ge=1, le=32)


class ProjectorEntry(_Entry):
    """The projector; R and t_mm take the frame of ``camera`` to the projector's."""

    size_px: Size
    K: Matrix | None = None
    distortion: tuple[float, float, float, float, float] | None = None
    camera: str
    R: Matrix | None = None
    t_mm: Vector | None = None


class Chessboard(_Entry):
    """A plain chessboard; ``inner_corners`` is columns, rows."""

    type: Literal["chessboard"]
    inner_corners: tuple[Corners, Corners]
    square_mm: float = Field(gt=0)
    scale_known: bool = True


class Charuco(_Entry):
    """A ChArUco board; ``squares`` is columns, rows."""

    type: Literal["charuco"]
    squares: tuple[Squares, Squares]
    square_mm: float = Field(gt=0)
    marker_mm: float = Field(gt=0)
    dictionary: str
    scale_known: bool = True


Board = Annotated[Chessboard | Charuco, Field(discriminator="type")]


class Frame(_Entry):
    """One image under one pattern."""

    file: str
    pattern: Pattern
    exposure_s: float | None = Field(default=None, gt=0)


class Sequence(_Entry):
    """Frames taken one after another with nothing moving."""

    name: Name
    purpose: Literal["calibrate", "scan", "pose", "light"]
    camera: str
    board: str | None = None
    light: str | None = None
    turntable_deg: float | None = None
    on_turntable: bool = False
    frames: tuple[Frame, ...] = Field(min_length=1)


class Photo(_Entry):
    """A photograph under one lamp; ``pose`` names the sequence that finds the camera's pose."""

    file: str
    camera: str
    light: str | None = None
    pose: str | None = None
    turntable_deg: float | None = None
    exposure_s: float | None = Field(default=None, gt=0)


class LightEntry(_Entry):
    """A lamp in the rig frame."""

    position_mm: Vector | None = None
    intensity: float | None = Field(default=None, gt=0)


class TurntableEntry(_Entry):
    """The table's axis in the rig frame."""

    axis_point_mm: Vector
    axis_direction: Vector


class Correction(_Entry):
    """A dark or flat frame."""

    file: str
    camera: str
    exposure_s: float | None = Field(default=None, gt=0)


class ColourTarget(_Entry):
    """A photograph of a colour target."""

    file: str
    camera: str
    light: str | None = None
    target: str


class Capture(_Entry):
    """The whole of ``capture.json``."""

    format: Literal["impasto-capture"]
    version: Literal[1]
    name: Name
    encoding: Literal["linear", "srgb"]
    cameras: dict[Name, CameraEntry]
    projector: ProjectorEntry | None = None
    boards: dict[Name, Board] = {}
    sequences: tuple[Sequence, ...] = ()
    photos: tuple[Photo, ...] = ()
    lights: dict[Name, LightEntry] = {}
    turntable: TurntableEntry | None = None
    darks: tuple[Correction, ...] = ()
    flats: tuple[Correction, ...] = ()
    colour_target: ColourTarget | None = None


@dataclass(frozen=True)
class ImageUse:
    """One place of the document that names an image file.

    Parameters
    ----------
    key
        Where: ``sequences[0].frames[3].file``.
    file
        The name as given.
    camera
        The camera that took it.
    purpose
        Purpose of its sequence, or ``photos`` for photographs, darks, flats and colour target.
    sequence
        Index of its sequence, or None.
    """

    key: str
    file: str
    camera: str
    purpose: Literal["calibrate", "scan", "pose", "light", "photos"]
    sequence: int | None = None


def image_uses(capture: Capture) -> Iterator[ImageUse]:
    """Go through all places that name an image file, in the document's order."""
    for i, sequence in enumerate(capture.sequences):
        for j, frame in enumerate(sequence.frames):
            key = f"sequences[{i}].frames[{j}].file"
            yield ImageUse(key, frame.file, sequence.camera, sequence.purpose, i)
    for group in ("photos", "darks", "flats"):
        for i, entry in enumerate(getattr(capture, group)):
            yield ImageUse(f"{group}[{i}].file", entry.file, entry.camera, "photos")
    if (target := capture.colour_target) is not None:
        yield ImageUse("colour_target.file", target.file, target.camera, "photos")
