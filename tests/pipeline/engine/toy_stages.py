"""A recipe of five tiny stages, named and wired like the real ones, and a bundle for them."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from pipeline.engine.recipe import Recipe, StageReference
from pipeline.engine.stage import Log, NoWork, Stage, reads, reads_bundle, writes
from pipeline.errors import ImpastoError
from pipeline.formats.artifact import Artifact
from pipeline.formats.bundle import Bundle

Numbers = dict[str, float]


def json_artifact(*files: str) -> Artifact[Numbers]:
    """Keep numbers in the first file; the others repeat its text."""

    def load(workspace: Path) -> Numbers:
        return json.loads((workspace / files[0]).read_text())

    def save(workspace: Path, value: Numbers) -> None:
        for file in files:
            (workspace / file).write_text(json.dumps(value))

    return Artifact(files, load, save)


CALIBRATION = json_artifact("calibrate/calibration.json")
RANGE = json_artifact("scan/range.json", "scan/copy.json")
SAMPLES = json_artifact("reflectance/samples.json")
MAPS = json_artifact("fit/maps.json")
ASSET = json_artifact("asset/asset.json")


@dataclass(frozen=True)
class One:
    """One bundle input."""

    bundle: Bundle = reads_bundle("calibrate")


@dataclass(frozen=True)
class CalibrateOutputs:
    """Numbers."""

    calibration: Numbers = writes(CALIBRATION)


class CalibrateConfig(BaseModel):
    """What the tests tell the stage to do."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    factor: int = Field(default=2, ge=0, le=100)
    behave: Literal["well", "error", "crash", "sleep", "memory", "peek", "nothing"] = "well"
    tags: list[str] = []


def calibrate(inputs: One, config: CalibrateConfig, log: Log) -> CalibrateOutputs:
    match config.behave:
        case "error":
            raise ImpastoError("the board was not found", where="board/0.png", fix="wash it")
        case "crash":
            raise ValueError("a defect")
        case "memory":
            raise MemoryError
        case "sleep":
            time.sleep(30)
        case "peek":
            inputs.bundle.read(inputs.bundle.files("scan")[0])
        case "nothing":
            raise NoWork("the boards are blank")
    log.progress(1, 2, "boards")
    log.metric("rms_px", np.float32(0.25))
    log.metric("endless", float("inf"))
    log.warning("the boards all lie flat")
    log.skipped("the projector", "its calibration is given")
    return CalibrateOutputs({"sum": config.factor * mean(inputs.bundle, "calibrate")})


def mean(bundle: Bundle, purpose: str) -> float:
    return float(np.mean([bundle.read(file).mean() for file in bundle.files(purpose)]))


@dataclass(frozen=True)
class ScanInputs:
    """The scan frames and the calibration."""

    bundle: Bundle = reads_bundle("scan")
    calibration: Numbers = reads(CALIBRATION)


@dataclass(frozen=True)
class ScanOutputs:
    """Numbers."""

    range_image: Numbers = writes(RANGE)


class Empty(BaseModel):
    """Nothing to set."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class ScanConfig(Empty):
    """A threshold."""

    threshold: float = 3.0


def scan(inputs: ScanInputs, config: ScanConfig, log: Log) -> ScanOutputs:
    log.metric("share_measured", 0.521)
    total = mean(inputs.bundle, "scan") + inputs.calibration["sum"]
    return ScanOutputs({"range": total, "threshold": config.threshold})


@dataclass(frozen=True)
class ReflectanceInputs:
    """The photographs."""

    bundle: Bundle = reads_bundle("photos")


@dataclass(frozen=True)
class ReflectanceOutputs:
    """Numbers."""

    samples: Numbers = writes(SAMPLES)


def reflectance(inputs: ReflectanceInputs, config: Empty, log: Log) -> ReflectanceOutputs:
    if not inputs.bundle.capture.photos:
        raise NoWork("the capture has no photographs")
    return ReflectanceOutputs({"samples": mean(inputs.bundle, "photos")})


@dataclass(frozen=True)
class FitInputs:
    """The samples."""

    samples: Numbers = reads(SAMPLES)


@dataclass(frozen=True)
class FitOutputs:
    """Numbers."""

    maps: Numbers = writes(MAPS)


def fit(inputs: FitInputs, config: Empty, log: Log) -> FitOutputs:
    return FitOutputs({"maps": 2 * inputs.samples["samples"]})


@dataclass(frozen=True)
class PackInputs:
    """The range, and the maps if there are any."""

    range_image: Numbers = reads(RANGE)
    maps: Numbers | None = reads(MAPS, optional=True)


@dataclass(frozen=True)
class PackOutputs:
    """Numbers."""

    asset: Numbers = writes(ASSET)


def pack(inputs: PackInputs, config: Empty, log: Log) -> PackOutputs:
    return PackOutputs(inputs.range_image | (inputs.maps or {"maps": -1.0}))


CALIBRATE = Stage("calibrate", 1, One, CalibrateOutputs, CalibrateConfig, calibrate)
SCAN = Stage("scan", 1, ScanInputs, ScanOutputs, ScanConfig, scan)
REFLECTANCE = Stage("reflectance", 1, ReflectanceInputs, ReflectanceOutputs, Empty, reflectance)
FIT = Stage("fit", 1, FitInputs, FitOutputs, Empty, fit)
PACK = Stage("pack", 1, PackInputs, PackOutputs, Empty, pack, folder="asset")

RECIPE: Recipe = tuple(
    StageReference(name, f"toy_stages:{name.upper()}", "asset" if name == "pack" else name)
    for name in ("calibrate", "scan", "reflectance", "fit", "pack")
)


def write_image(path: Path, value: int) -> None:
    """Write a uniform 4 x 3 image."""
    import cv2

    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.full((3, 4), value, np.uint8))


def write_bundle(folder: Path, *, photos: int = 1) -> Path:
    """Write a bundle of two board frames, two scan frames and some photographs."""
    frames: dict[str, list[Any]] = {}
    for purpose in ("calibrate", "scan"):
        frames[purpose] = []
        for index, kind in enumerate(("white", "black")):
            file = f"{purpose}/{index}.png"
            write_image(folder / file, 200 - 150 * index)
            frames[purpose].append({"file": file, "pattern": {"type": kind}})
    for index in range(photos):
        write_image(folder / f"photos/{index}.png", 100 + index)
    board = {"type": "chessboard", "inner_corners": [3, 4], "square_mm": 5.0}
    document = {
        "format": "impasto-capture",
        "version": 1,
        "name": "toy",
        "encoding": "linear",
        "cameras": {"C0": {"size_px": [4, 3]}},
        "projector": {"size_px": [8, 6], "camera": "C0"},
        "boards": {"main": board},
        "sequences": [
            {
                "name": "board",
                "purpose": "calibrate",
                "camera": "C0",
                "board": "main",
                "frames": frames["calibrate"],
            },
            {"name": "front", "purpose": "scan", "camera": "C0", "frames": frames["scan"]},
        ],
        "lights": {"L0": {"position_mm": [0, 0, 500]}},
        "photos": [
            {"file": f"photos/{index}.png", "camera": "C0", "light": "L0"}
            for index in range(photos)
        ],
    }
    (folder / "capture.json").write_text(json.dumps(document, indent=1))
    return folder


if __name__ == "__main__":
    import pipeline.cli
    import pipeline.recipe

    pipeline.recipe.RECIPE = RECIPE
    pipeline.cli.main()
