"""Photographs seen from the canvas, and the lobes fitted to them."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, StrictBool

from pipeline.errors import ImpastoError
from pipeline.formats.artifact import Artifact
from pipeline.formats.exr import read_exr, read_float_channels, write_exr
from pipeline.formats.strict_json import parse_model, read_text
from pipeline.geometry.camera import Camera, Lens
from pipeline.geometry.rigid import RigidTransform


@dataclass(frozen=True)
class FoundCamera:
    """A camera that was placed by a sequence of the projector's light on the canvas.

    Parameters
    ----------
    sequence, name, light
        The sequence and its camera; the lamp in whose place it stood, or None.
    camera
        Canvas coordinates, the table as it was in the scan.
    rms_px, points, share
        RMS over the points that agree, how many those are, and their share of all.
    sigma_mm, sigma_deg
        Largest standard deviation of its centre and of its orientation.
    """

    sequence: str
    name: str
    light: str | None
    camera: Camera
    rms_px: float
    points: int
    share: float
    sigma_mm: float
    sigma_deg: float


@dataclass(frozen=True)
class ReflectanceSamples:
    """What each photograph says of each texel (``reflectance/samples.npy``, ``photos.json``).

    Parameters
    ----------
    brdf
        (photos, rows, columns, 3) float32, RGB, 1/sr: radiance over irradiance, cosine divided
        out; NaN where the texel was not seen, not lit, saturated or outside.
    view_mm, light_mm
        (photos, 3) float64: the camera's centre and the lamp, canvas coordinates.
    names
        The photographs' file names.
    absolute
        True if responsivity and lamp intensities were given, so that ``brdf`` is in 1/sr;
        otherwise it is known up to one factor.
    cameras
        The stations and lamp stops that had to be found.
    """

    brdf: NDArray[np.float32]
    view_mm: NDArray[np.float64]
    light_mm: NDArray[np.float64]
    names: tuple[str, ...]
    absolute: bool
    cameras: tuple[FoundCamera, ...] = ()


@dataclass(frozen=True)
class ReflectanceMaps:
    """One isotropic Lafortune lobe per texel, its peak normalised to 1 (``fit/*.exr``).

    f = rho_d + rho_s max(0, C_xy (v_x l_x + v_y l_y) + C_z v_z l_z)^k, with v and l in the texel's
    own frame and (C_xy, C_z) scaled so that the largest value of the bracket is 1.

    Parameters
    ----------
    diffuse, specular
        rho_d, rho_s: (rows, columns, 3) float32, 1/sr, >= 0; NaN outside the canvas.
    lobe
        (rows, columns, 3) float32: C_xy, C_z, k; 0, 0, 1 where the texel is matte.
    residual
        (rows, columns) float32: RMS of the fit, 1/sr.
    count
        (rows, columns) int32: samples used.
    lobe_observed
        (rows, columns) bool: False where no sample lay near enough to a highlight.
    """

    diffuse: NDArray[np.float32]
    specular: NDArray[np.float32]
    lobe: NDArray[np.float32]
    residual: NDArray[np.float32]
    count: NDArray[np.int32]
    lobe_observed: NDArray[np.bool_]
    absolute: bool


class _Fit(BaseModel):
    """The document ``fit/fit.json``."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    absolute: StrictBool


_SAMPLE_FILES = ("reflectance/samples.npy", "reflectance/photos.json")
_MAP_FILES = (
    "fit/diffuse.exr",
    "fit/specular.exr",
    "fit/lobe.exr",
    "fit/quality.exr",
    "fit/fit.json",
)


def _save_samples(workspace: Path, samples: ReflectanceSamples) -> None:
    array, description = (workspace / file for file in _SAMPLE_FILES)
    np.save(array, np.ascontiguousarray(samples.brdf, dtype=np.float32), allow_pickle=False)
    photos = [
        {"file": name, "view_mm": view.tolist(), "light_mm": light.tolist()}
        for name, view, light in zip(samples.names, samples.view_mm, samples.light_mm, strict=True)
    ]
    document: dict[str, Any] = {"absolute": samples.absolute, "photos": photos}
    document["cameras"] = [_camera_entry(found) for found in samples.cameras]
    description.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def _camera_entry(found: FoundCamera) -> dict[str, Any]:
    lens, pose = found.camera.lens, found.camera.pose
    return {
        "sequence": found.sequence,
        "camera": found.name,
        "light": found.light,
        "size_px": list(lens.size_px),
        "K": lens.K.tolist(),
        "distortion": lens.distortion.tolist(),
        "R": pose.rotation.tolist(),
        "t_mm": pose.translation_mm.tolist(),
        "rms_px": found.rms_px,
        "points": found.points,
        "share": found.share,
        "sigma_mm": found.sigma_mm,
        "sigma_deg": found.sigma_deg,
    }


def _found_camera(entry: dict[str, Any]) -> FoundCamera:
    width, height = entry["size_px"]
    lens = Lens((width, height), np.array(entry["K"]), np.array(entry["distortion"]))
    pose = RigidTransform(np.array(entry["R"]), np.array(entry["t_mm"]))
    return FoundCamera(
        entry["sequence"],
        entry["camera"],
        entry["light"],
        Camera(lens, pose),
        *(entry[key] for key in ("rms_px", "points", "share", "sigma_mm", "sigma_deg")),
    )


def _load_samples(workspace: Path) -> ReflectanceSamples:
    array, description = (workspace / file for file in _SAMPLE_FILES)
    try:
        document = json.loads(description.read_text(encoding="utf-8"))
        photos = document["photos"]
        # Mapped, not read: the fit walks through it once, and it may be larger than memory.
        brdf = np.load(array, mmap_mode="r", allow_pickle=False)
        view = np.array([photo["view_mm"] for photo in photos], dtype=np.float64)
        light = np.array([photo["light_mm"] for photo in photos], dtype=np.float64)
        samples = ReflectanceSamples(
            brdf,
            view,
            light,
            tuple(photo["file"] for photo in photos),
            bool(document["absolute"]),
            tuple(_found_camera(entry) for entry in document.get("cameras", ())),
        )
    except (ValueError, KeyError, TypeError, EOFError) as error:
        raise ImpastoError(
            f"the samples cannot be read ({error})",
            where=_SAMPLE_FILES[0],
            fix="run the stage again: impasto run ... --from reflectance --force",
        ) from error
    count = len(photos)
    fits = brdf.dtype == np.float32 and brdf.ndim == 4 and brdf.shape[::3] == (count, 3)
    if not (fits and view.shape == light.shape == (count, 3)):
        raise ImpastoError(
            f"{brdf.dtype} samples of shape {brdf.shape} for {len(photos)} photographs",
            where=_SAMPLE_FILES[0],
            expected="float32, (photos, rows, columns, 3)",
        )
    return samples


SAMPLES = Artifact(_SAMPLE_FILES, _load_samples, _save_samples)


def _save_maps(workspace: Path, maps: ReflectanceMaps) -> None:
    diffuse, specular, lobe, quality, description = (workspace / file for file in _MAP_FILES)
    write_exr(diffuse, dict(zip("RGB", np.moveaxis(maps.diffuse, 2, 0), strict=True)))
    write_exr(specular, dict(zip("RGB", np.moveaxis(maps.specular, 2, 0), strict=True)))
    write_exr(lobe, dict(zip(("CXY", "CZ", "K"), np.moveaxis(maps.lobe, 2, 0), strict=True)))
    channels: dict[str, NDArray[Any]] = {
        "RESIDUAL": maps.residual,
        "COUNT": maps.count.astype(np.uint32),
        "OBSERVED": maps.lobe_observed.astype(np.uint32),
    }
    write_exr(quality, channels)
    text = json.dumps({"absolute": maps.absolute, "unit": "1/sr"}, indent=1)
    description.write_text(text + "\n", encoding="utf-8")


def _load_maps(workspace: Path) -> ReflectanceMaps:
    diffuse, specular, lobe, quality, description = (workspace / file for file in _MAP_FILES)
    measured = read_exr(quality, ("RESIDUAL", "COUNT", "OBSERVED"))
    maps = ReflectanceMaps(
        diffuse=read_float_channels(diffuse, ("R", "G", "B")),
        specular=read_float_channels(specular, ("R", "G", "B")),
        lobe=read_float_channels(lobe, ("CXY", "CZ", "K")),
        residual=measured["RESIDUAL"].astype(np.float32, copy=False),
        count=measured["COUNT"].astype(np.int32),
        lobe_observed=measured["OBSERVED"] != 0,
        absolute=parse_model(
            _Fit, read_text(description, where=_MAP_FILES[4]), where=_MAP_FILES[4]
        ).absolute,
    )
    size = maps.count.shape
    for file, image in zip(_MAP_FILES, (maps.diffuse, maps.specular, maps.lobe), strict=False):
        if image.shape[:2] != size:
            raise ImpastoError(
                f"the image is {image.shape[1]} x {image.shape[0]}",
                where=file,
                expected=f"{size[1]} x {size[0]}, as {_MAP_FILES[3]}",
                fix="run the stage again: impasto run ... --from fit --force",
            )
    return maps


MAPS = Artifact(_MAP_FILES, _load_maps, _save_maps)
