"""The doctor: every finding in words, every check bounded."""

from __future__ import annotations

import importlib.metadata
import json
import subprocess

import pytest
from click.testing import CliRunner

from pipeline.commands import doctor as module
from pipeline.commands.doctor import Finding, adapters, doctor, python_and_packages


def test_it_lists_what_the_machine_has() -> None:
    result = CliRunner().invoke(doctor, ["--json"])
    assert result.exit_code == 0, result.output
    subjects = {entry["subject"] for entry in json.loads(result.output)}
    assert {"Python", "numpy", "GPU adapter", "Serial port", "Displays"} <= subjects


def test_the_table_names_versions() -> None:
    result = CliRunner().invoke(doctor, [])
    assert importlib.metadata.version("numpy") in result.output


def test_a_missing_package_is_named_and_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "PACKAGES", ("no-such-package-at-all",))
    monkeypatch.setattr(module, "CHECKS", (python_and_packages,))
    result = CliRunner().invoke(doctor, [])
    assert result.exit_code == 1
    assert "not installed" in result.output


def test_a_driver_that_hangs_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    def hang(*_: object, **options: object) -> None:
        raise subprocess.TimeoutExpired("python", float(str(options["timeout"])))

    monkeypatch.setattr(module.subprocess, "run", hang)
    (finding,) = adapters()
    assert finding.ok is False
    assert "no answer in 30 s" in finding.found
    assert "mesa-vulkan-drivers" in finding.advice


def test_a_driver_that_crashes_is_quoted(monkeypatch: pytest.MonkeyPatch) -> None:
    def crash(*_: object, **__: object) -> None:
        raise subprocess.CalledProcessError(1, "python", stderr="first\nlast words\n")

    monkeypatch.setattr(module.subprocess, "run", crash)
    assert adapters() == [
        Finding("GPU adapter", False, "last words", adapters()[0].advice),
    ]
