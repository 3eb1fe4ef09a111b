"""The set of pictures that the demonstration and the report show of an asset."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

SIZE_PX = (960, 640)
RECORD = "pictures.json"

FILL = 0.04
"""A weak second lamp in front, as a photographer's reflector, so that shadows are not empty."""


@dataclass(frozen=True)
class Shot:
    """One picture: where the camera and the lamp stand, in degrees and framed distances."""

    name: str
    caption: str
    azimuth_deg: float
    elevation_deg: float
    distance: float
    light_azimuth_deg: float
    light_elevation_deg: float


SHOTS = (
    Shot("front", "From the front, lamp at the upper left", -90, 90, 1.0, 135, 50),
    Shot("raking-left", "Raking light from the left", -90, 90, 1.0, 180, 9),
    Shot("raking-top", "Raking light from above", -90, 90, 1.0, 90, 9),
    Shot("oblique", "From below at 45 degrees, lamp opposite", -90, 45, 1.0, 90, 45),
    Shot("grazing", "Along the surface, at 15 degrees", -80, 15, 0.7, 140, 25),
    Shot("near", "Near: a third of the distance, light at 25 degrees", -75, 60, 0.33, 150, 25),
    Shot("far", "Far: five times the distance", -90, 60, 5.0, 135, 50),
)


@dataclass(frozen=True)
class Picture:
    """A picture that was drawn, with its caption and how it was drawn."""

    path: Path
    caption: str


def draw_pictures(asset_folder: Path, out: Path, *, say: Callable[[str], None]) -> list[Picture]:
    """Draw the set into ``out``, or leave it as it is if this asset's is there already.

    By the exact reference, so that the pictures of one asset are the same on every machine. ``say``
    receives one line for people: what was drawn, or that nothing had to be.
    """
    from pipeline.formats.asset import load_asset
    from pipeline.formats.atomic import write_text_atomically
    from renderers import draw, tone
    from renderers.view import arc_light, orbit_view

    pictures = [Picture(out / f"{shot.name}.png", shot.caption) for shot in SHOTS]
    wanted = {
        "asset": _digest(asset_folder),
        "size_px": list(SIZE_PX),
        "fill": FILL,
        "shots": [asdict(shot) for shot in SHOTS],
    }
    record = out / RECORD
    if _same(record, wanted) and all(picture.path.is_file() for picture in pictures):
        say(f"pictures   up to date ({len(pictures)} in {out})")
        return pictures
    asset = load_asset(asset_folder)
    record.unlink(missing_ok=True)
    seconds = 0.0
    for shot, picture in zip(SHOTS, pictures, strict=True):
        view = orbit_view(
            asset,
            azimuth_deg=shot.azimuth_deg,
            elevation_deg=shot.elevation_deg,
            distance=shot.distance,
            size_px=SIZE_PX,
        )
        light = arc_light(
            asset, azimuth_deg=shot.light_azimuth_deg, elevation_deg=shot.light_elevation_deg
        )
        fill = arc_light(asset, azimuth_deg=-90, elevation_deg=80, intensity=FILL * light.intensity)
        result = draw.render(asset, view, [light, fill], method=draw.REFERENCE)
        tone.write_image(picture.path, result.image)
        seconds += result.elapsed_s
    write_text_atomically(record, json.dumps(wanted, indent=1) + "\n")
    say(f"pictures   {len(pictures)} drawn in {seconds:.1f} s (exact reference, CPU)")
    return pictures


def _same(record: Path, wanted: dict[str, object]) -> bool:
    try:
        return bool(json.loads(record.read_text(encoding="utf-8")) == wanted)
    except (OSError, ValueError):
        return False


def _digest(folder: Path) -> str:
    digest = hashlib.sha256()
    for file in sorted(path for path in folder.iterdir() if path.suffix in {".exr", ".npz"}):
        digest.update(file.name.encode())
        digest.update(hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()
