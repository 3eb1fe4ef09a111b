"""Doing one stage: load, run, save, record, swap in."""

from __future__ import annotations

import platform
import time
from collections.abc import Callable
from dataclasses import fields
from datetime import UTC, datetime
from importlib import metadata
from typing import Any

from pydantic import BaseModel

import pipeline
from pipeline.engine import manifest as manifests
from pipeline.engine.freshness import NO_WORK, Request, missing_input, request
from pipeline.engine.hashes import HashCache
from pipeline.engine.manifest import Files, Manifest
from pipeline.engine.record import PeakMemory, RecordingLog
from pipeline.engine.source import BundleSource
from pipeline.engine.stage import NoWork, Stage
from pipeline.engine.workspace import Workspace
from pipeline.errors import ImpastoError

PACKAGES = ("numpy", "numba", "scipy", "opencv-contrib-python-headless", "OpenEXR", "rawpy")


def execute(
    stage: Stage,
    configuration: BaseModel,
    wanted: Request,
    workspace: Workspace,
    source: BundleSource,
    cache: HashCache,
    show_progress: Callable[[float, float, str], None],
) -> Manifest:
    """Do the stage and swap its folder in; on any error the old folder stays as it was.

    Inputs are always loaded from the workspace, even those that were made a moment ago, so that a
    resumed run sees exactly what an undisturbed one saw.

    Raises
    ------
    ImpastoError
        From the stage; if it cannot be saved; or if its inputs changed while it ran.
    """
    started, clock, memory = datetime.now(UTC), time.perf_counter(), PeakMemory()
    log = RecordingLog(show_progress)
    new = workspace.staging / stage.folder
    try:
        new.mkdir()
        reason = missing_input(stage, wanted)
        outputs: Files = {}
        if reason is None:
            try:
                values = stage.run(_load(stage, wanted, workspace, source), configuration, log)
                outputs = _save(stage, values, workspace, cache)
            except NoWork as nothing:
                reason = str(nothing)
        if request(stage, configuration, workspace, source, cache) != wanted:
            raise ImpastoError(
                f"the inputs of {stage.name} changed while it ran", fix="run the command again"
            )
        peak, method = memory.bytes_and_method()
        manifest = Manifest(
            stage=stage.name,
            stage_version=stage.version,
            configuration=wanted.configuration,
            inputs=wanted.inputs,
            outputs=outputs,
            outcome="done" if reason is None else "no work",
            reason=reason or "",
            metrics=log.metrics,
            warnings=log.warnings,
            skipped=log.skips,
            software=_software(),
            run={
                "started": started.isoformat(timespec="seconds"),
                "elapsed_s": round(time.perf_counter() - clock, 3),
                "peak_memory_bytes": peak,
                "peak_memory_is": method,
            },
        )
        (new / manifests.FILE).write_text(manifest.to_json(), encoding="utf-8")
        workspace.commit(stage.folder)
    finally:
        workspace.clean_staging()
    cache.moved(new, workspace.folder / stage.folder)
    return manifest


def _load(stage: Stage, wanted: Request, workspace: Workspace, source: BundleSource) -> Any:
    values: dict[str, Any] = {
        name: source.limited_to(purposes) for name, purposes in stage.bundle_purposes.items()
    }
    for name, (artifact, _) in stage.input_artifacts.items():
        there = NO_WORK not in wanted.inputs[name]
        values[name] = artifact.load(workspace.folder) if there else None
    return stage.inputs(**values)


def _save(stage: Stage, values: Any, workspace: Workspace, cache: HashCache) -> Files:
    if not isinstance(values, stage.outputs):
        raise TypeError(f"{stage.name} returned {type(values).__name__}, not its Outputs")
    for declared in fields(stage.outputs):
        artifact, value = declared.metadata["artifact"], getattr(values, declared.name)
        if value is None:
            raise TypeError(f"{stage.name} gave nothing for {declared.name}")
        try:
            artifact.save(workspace.staging, value)
        except OSError as error:
            raise ImpastoError(
                f"it could not be written: {error.strerror or error}",
                where=str(workspace.folder / artifact.files[0]),
            ) from error
    written = sorted(
        str(path.relative_to(workspace.staging))
        for path in (workspace.staging / stage.folder).rglob("*")
        if path.is_file()
    )
    if tuple(written) != stage.output_files:
        raise RuntimeError(f"{stage.name} wrote {written}, declared {list(stage.output_files)}")
    return {file: cache.sha256(workspace.staging / file) for file in written}


def _software() -> dict[str, str]:
    versions = {"impasto": pipeline.__version__, "python": platform.python_version()}
    for package in PACKAGES:
        try:
            versions[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    return versions
