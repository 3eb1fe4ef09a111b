"""``impasto doctor``: what this machine has, and what to do about what it lacks.

Every check is bounded in time; drivers that may hang or crash are asked in a process of their own.
"""

from __future__ import annotations

import importlib.metadata
import json
import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import click

PACKAGES = ("numpy", "numba", "scipy", "opencv-contrib-python-headless", "OpenEXR", "rawpy", "wgpu")
ADAPTER_TIMEOUT_S = 30.0
ENOUGH_MEMORY_GIB = 4.0
ENOUGH_DISK_GIB = 10.0

_LIST_ADAPTERS = """
import json, wgpu
KEYS = "device", "adapter_type", "backend_type", "description"
print(json.dumps([
    {key: str(adapter.info.get(key, "")) for key in KEYS}
    for adapter in wgpu.gpu.enumerate_adapters_sync()
]))
"""


@dataclass(frozen=True)
class Finding:
    """One line; ``ok`` is True, False (needs attention) or None (optional and absent)."""

    subject: str
    ok: bool | None
    found: str
    advice: str = ""


def python_and_packages() -> list[Finding]:
    """Report the interpreter, and the version of every package that the stages stand on."""
    findings = [Finding("Python", True, f"{platform.python_version()}, {sys.executable}")]
    for package in PACKAGES:
        try:
            findings.append(Finding(package, True, importlib.metadata.version(package)))
        except importlib.metadata.PackageNotFoundError:
            advice = "delete .venv and run ./impasto again, or pip install " + package
            findings.append(Finding(package, False, "not installed", advice))
    return findings


def machine() -> list[Finding]:
    """Report cores, memory and the disk of the current folder."""
    cores = (
        len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    )
    findings = [Finding("Processor", True, f"{platform.machine()}, {cores} cores for this process")]
    if hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
        memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 2**30
        advice = "" if memory >= ENOUGH_MEMORY_GIB else f"{ENOUGH_MEMORY_GIB:.0f} GiB are advised"
        findings.append(Finding("Memory", not advice, f"{memory:.1f} GiB", advice))
    free = shutil.disk_usage(Path.cwd()).free / 2**30
    advice = "" if free >= ENOUGH_DISK_GIB else "a RAW capture of a painting takes about 10 GiB"
    findings.append(Finding("Disk here", not advice, f"{free:.1f} GiB free", advice))
    return findings


def adapters() -> list[Finding]:
    """Report the GPU adapters that wgpu finds, asked in a process of their own."""
    advice = "renders fall back to the CPU; Debian: apt install mesa-vulkan-drivers"
    try:
        answer = subprocess.run(  # noqa: S603 - our own interpreter and script
            [sys.executable, "-c", _LIST_ADAPTERS],
            capture_output=True,
            text=True,
            timeout=ADAPTER_TIMEOUT_S,
            check=True,
        )
        found = json.loads(answer.stdout)
    except subprocess.TimeoutExpired:
        return [Finding("GPU adapter", False, f"no answer in {ADAPTER_TIMEOUT_S:.0f} s", advice)]
    except (subprocess.CalledProcessError, json.JSONDecodeError) as error:
        lines = str(getattr(error, "stderr", "") or error).strip().splitlines()
        return [Finding("GPU adapter", False, lines[-1] if lines else "wgpu failed", advice)]
    if not found:
        return [Finding("GPU adapter", False, "none", advice)]
    return [
        Finding(
            "GPU adapter",
            True,
            f"{entry['device']} ({entry['backend_type']}, "
            f"{'software' if entry['adapter_type'] == 'CPU' else entry['adapter_type']}; "
            f"{entry['description']})",
        )
        for entry in found
    ]


def cameras() -> list[Finding]:
    """Report video devices, and the program that talks to still cameras."""
    video = sorted(str(path) for path in Path("/dev").glob("video*"))
    gphoto2 = shutil.which("gphoto2")
    return [
        Finding("Video cameras", True if video else None, ", ".join(video) or "none"),
        Finding("gphoto2", True if gphoto2 else None, gphoto2 or "not installed"),
    ]


def serial_ports() -> list[Finding]:
    """Report the serial ports (turntable, light arc), and whether this user may open them."""
    from serial.tools import list_ports

    ports = sorted(list_ports.comports(), key=lambda port: port.device)
    findings = []
    for port in ports:
        usable = os.access(port.device, os.R_OK | os.W_OK)
        advice = "" if usable else "no permission; add yourself to the group dialout, log in again"
        findings.append(Finding("Serial port", usable, f"{port.device} {port.description}", advice))
    return findings or [Finding("Serial port", None, "none")]


def displays() -> list[Finding]:
    """Report the displays that a projector could be driven on."""
    named = [
        f"{key}={os.environ[key]}" for key in ("DISPLAY", "WAYLAND_DISPLAY") if os.environ.get(key)
    ]
    connected = []
    for status in sorted(Path("/sys/class/drm").glob("card*-*/status")):
        try:
            if status.read_text().strip() == "connected":
                connected.append(status.parent.name.partition("-")[2])
        except OSError:
            continue
    found = ", ".join(named + connected)
    return [Finding("Displays", True if found else None, found or "none")]


CHECKS: tuple[Callable[[], list[Finding]], ...] = (
    python_and_packages,
    machine,
    adapters,
    cameras,
    serial_ports,
    displays,
)


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Print the findings as JSON.")
def doctor(as_json: bool) -> None:
    """Show what this machine has: versions, GPU adapters, cameras, serial ports, displays.

    Exits with status 1 if something that the pipeline needs is missing.
    """
    findings = [finding for check in CHECKS for finding in check()]
    if as_json:
        click.echo(json.dumps([asdict(finding) for finding in findings], indent=2))
    else:
        _print(findings)
    if any(finding.ok is False and finding.subject in PACKAGES for finding in findings):
        raise SystemExit(1)


def _print(findings: list[Finding]) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for heading in ("", "", "found", "what to do"):
        table.add_column(heading)
    marks = {True: "[green]ok[/]", False: "[red]!![/]", None: "[dim]--[/]"}
    for finding in findings:
        table.add_row(marks[finding.ok], finding.subject, finding.found, finding.advice)
    Console().print(table)
