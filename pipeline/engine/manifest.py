"""A stage's manifest: what it was made from, what came out, and how it went.

All of it but the object ``run`` (times, memory) is the same whenever the same work is done.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

FORMAT, VERSION = "impasto-manifest", 1
FILE = "manifest.json"

Outcome = Literal["done", "no work"]
Files = dict[str, str]
"""SHA-256 by file."""


@dataclass(frozen=True)
class Manifest:
    """The record of one stage's last complete run.

    Parameters
    ----------
    inputs
        By input: SHA-256 of each of its files, or ``{"no work": reason}`` for one that is not
        there because its stage had nothing to do.
    outputs
        SHA-256 by file, relative to the workspace.
    reason
        Why there was no work.
    run
        ``started`` (UTC), ``elapsed_s``, ``peak_memory_bytes`` and how the latter was measured.
    """

    stage: str
    stage_version: int
    configuration: dict[str, Any]
    inputs: dict[str, Files]
    outputs: Files
    outcome: Outcome
    reason: str = ""
    metrics: dict[str, float | int | str | None] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    skipped: list[dict[str, str]] = field(default_factory=list)
    software: dict[str, str] = field(default_factory=dict)
    run: dict[str, Any] = field(default_factory=dict)

    def to_json(self) -> str:
        """Return the text of ``manifest.json``; the order of its keys is fixed."""
        document = {
            "format": FORMAT,
            "version": VERSION,
            "stage": {"name": self.stage, "version": self.stage_version},
            "outcome": self.outcome,
            "reason": self.reason,
            "configuration": self.configuration,
            "inputs": {name: dict(sorted(files.items())) for name, files in self.inputs.items()},
            "outputs": dict(sorted(self.outputs.items())),
            "metrics": self.metrics,
            "warnings": self.warnings,
            "skipped": self.skipped,
            "software": self.software,
            "run": self.run,
        }
        return json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def read_manifest(folder: Path) -> Manifest | None:
    """Read the manifest in a stage's folder; None if it is absent or damaged."""
    try:
        document = json.loads((folder / FILE).read_text(encoding="utf-8"))
        if (document["format"], document["version"]) != (FORMAT, VERSION):
            return None
        if document["outcome"] not in ("done", "no work"):
            return None
        return Manifest(
            stage=str(document["stage"]["name"]),
            stage_version=int(document["stage"]["version"]),
            configuration=dict(document["configuration"]),
            inputs={str(name): dict(files) for name, files in document["inputs"].items()},
            outputs=dict(document["outputs"]),
            outcome=document["outcome"],
            reason=str(document["reason"]),
            metrics=dict(document["metrics"]),
            warnings=[str(text) for text in document["warnings"]],
            skipped=[{"what": str(s["what"]), "why": str(s["why"])} for s in document["skipped"]],
            software=dict(document["software"]),
            run=dict(document["run"]),
        )
    except (OSError, ValueError, TypeError, KeyError, AttributeError):
        return None
