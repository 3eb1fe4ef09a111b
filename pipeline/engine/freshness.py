"""Whether a stage is up to date, and if not, why: by content, never by time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel

from pipeline.engine.hashes import HashCache
from pipeline.engine.manifest import Files, Manifest
from pipeline.engine.source import BundleSource
from pipeline.engine.stage import Stage
from pipeline.engine.workspace import Workspace
from pipeline.errors import ImpastoError
from pipeline.formats.artifact import Artifact

NO_WORK = "no work"
NOT_RUN = "not run yet"


@dataclass(frozen=True)
class Request:
    """What a stage would be made from now: the manifest's input side."""

    version: int
    configuration: dict[str, Any]
    inputs: dict[str, Files]


def request(
    stage: Stage,
    configuration: BaseModel,
    workspace: Workspace,
    source: BundleSource,
    cache: HashCache,
) -> Request:
    """Hash the stage's inputs as they are now.

    Raises
    ------
    ImpastoError
        An input has not been made, or the bundle is not valid.
    """
    inputs = {name: source.hashes(purposes) for name, purposes in stage.bundle_purposes.items()}
    for name, (artifact, _) in stage.input_artifacts.items():
        inputs[name] = _artifact_hashes(artifact, stage, workspace, cache)
    return Request(stage.version, configuration.model_dump(mode="json"), inputs)


def _artifact_hashes(
    artifact: Artifact[Any], stage: Stage, workspace: Workspace, cache: HashCache
) -> Files:
    maker = artifact.files[0].split("/", 1)[0]
    manifest = workspace.manifest(maker)
    if manifest is not None and manifest.outcome == "no work":
        return {NO_WORK: f"{manifest.stage} had no work: {_root_reason(manifest)}"}
    try:
        return {file: cache.sha256(workspace.folder / file) for file in artifact.files}
    except FileNotFoundError as error:
        raise ImpastoError(
            f"the stage {stage.name} needs {error.filename}, which has not been made",
            fix="run the stages before it too: leave out --from",
        ) from None


def _root_reason(manifest: Manifest) -> str:
    """Return the first reason of a chain of stages that had no work."""
    return manifest.reason.rsplit(" had no work: ", 1)[-1]


def missing_input(stage: Stage, wanted: Request) -> str | None:
    """Return why a required input is not there, or None if all are."""
    for name, (_, optional) in stage.input_artifacts.items():
        reason = wanted.inputs[name].get(NO_WORK)
        if reason is not None and not optional:
            return reason
    return None


def why_stale(stage: Stage, wanted: Request, workspace: Workspace, cache: HashCache) -> str | None:
    """Return why the stage has to be done (again), or None if it is up to date."""
    folder = workspace.folder / stage.folder
    if not folder.exists():
        return NOT_RUN
    manifest = workspace.manifest(stage.folder)
    if manifest is None:
        return f"{stage.folder}/manifest.json is missing or damaged"
    if (manifest.stage, manifest.stage_version) != (stage.name, wanted.version):
        return f"the stage's version was {manifest.stage_version}, is {wanted.version}"
    return (
        _changed_configuration(manifest.configuration, wanted.configuration)
        or _changed_inputs(manifest.inputs, wanted.inputs)
        or _changed_outputs(stage, manifest, workspace, cache)
    )


def _changed_configuration(old: dict[str, Any], new: dict[str, Any]) -> str | None:
    changes = [
        f"{key} was {_shown(old, key)}, is {_shown(new, key)}"
        for key in sorted(old.keys() | new.keys())
        if key not in old or key not in new or old[key] != new[key]
    ]
    return f"configuration: {', '.join(changes)}" if changes else None


def _shown(values: dict[str, Any], key: str) -> str:
    return repr(values[key]) if key in values else "not there"


def _changed_inputs(old: dict[str, Files], new: dict[str, Files]) -> str | None:
    if old.keys() != new.keys():
        return "the stage's inputs are declared differently"
    reasons = []
    for name, files in new.items():
        before = old[name]
        if NO_WORK in files:
            if before != files:
                reasons.append(files[NO_WORK])
        elif NO_WORK in before:
            reasons.append(f"{name} is there now")
        else:
            reasons += _list("changed", [f for f in files if before.get(f, files[f]) != files[f]])
            reasons += _list("added", [f for f in files if f not in before])
            reasons += _list("gone", [f for f in before if f not in files])
    return "; ".join(reasons) or None


def _list(what: str, files: list[str]) -> list[str]:
    if not files:
        return []
    others = f" and {len(files) - 1} more" if len(files) > 1 else ""
    return [f"{files[0]}{others} {what}"]


def _changed_outputs(
    stage: Stage, manifest: Manifest, workspace: Workspace, cache: HashCache
) -> str | None:
    declared = stage.output_files if manifest.outcome == "done" else ()
    if tuple(sorted(manifest.outputs)) != declared:
        return "the stage's outputs are declared differently"
    for file, digest in manifest.outputs.items():
        path = workspace.folder / file
        if not path.is_file():
            return f"{file} is missing"
        if cache.sha256(path) != digest:
            return f"{file} was changed after it was made"
    return None
