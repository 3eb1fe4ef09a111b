"""What the bundle gives of the rig, and what is therefore still to be calibrated."""

from __future__ import annotations

import numpy as np

from pipeline.errors import ImpastoError
from pipeline.formats.capture import CameraEntry, Capture, ProjectorEntry
from pipeline.geometry.camera import Camera, Lens
from pipeline.geometry.rigid import RigidTransform


def scan_camera_of(capture: Capture) -> str:
    """Name the camera that takes the scan."""
    scans = [s.camera for s in capture.sequences if s.purpose == "scan"]
    if scans:
        return scans[0]
    return capture.projector.camera if capture.projector else next(iter(capture.cameras))


def to_calibrate(capture: Capture, scan_camera: str) -> list[str]:
    """Name the cameras to calibrate from boards, the scan's first; say what cannot be found."""
    recorded = {s.camera for s in capture.sequences if s.purpose == "calibrate"}
    wanted = []
    for name in sorted(capture.cameras, key=lambda name: name != scan_camera):
        source = capture.cameras[name].lens_of or name
        for_projector = capture.projector is not None and capture.projector.camera == name
        incomplete = capture.projector is not None and not is_complete(capture.projector)
        if capture.cameras[source].K is None or (for_projector and incomplete):
            if name in recorded:
                wanted.append(name)
            elif (
                capture.cameras[source].K is None and name == scan_camera and source not in recorded
            ):
                raise _missing(f"cameras.{source}.K", f"the lens of camera {name}")
            elif for_projector and incomplete:
                raise _missing("projector.K", "the projector")
    return wanted


def _missing(key: str, what: str) -> ImpastoError:
    return ImpastoError(
        f"{what} is neither given nor to be calibrated",
        where=f"capture.json: {key}",
        expected="the values, or sequences of purpose calibrate with a board",
    )


def is_complete(entry: ProjectorEntry) -> bool:
    """Tell whether lens and pose are given."""
    return entry.K is not None and entry.R is not None


def lens_of(entry: CameraEntry | ProjectorEntry) -> Lens | None:
    """Return the entry's lens; None without K."""
    if entry.K is None:
        return None
    distortion = np.array(entry.distortion or (0.0,) * 5)
    return Lens(entry.size_px, np.array(entry.K), distortion)


def pose_of(entry: CameraEntry | ProjectorEntry) -> RigidTransform | None:
    """Return the entry's pose; None without R or t_mm."""
    if entry.R is None or entry.t_mm is None:
        return None
    return RigidTransform(np.array(entry.R), np.array(entry.t_mm))


def given_lenses(capture: Capture) -> dict[str, Lens]:
    """Return the given lenses by camera name, borrowed ones included."""
    lenses = {}
    for name, entry in capture.cameras.items():
        lens = lens_of(capture.cameras[entry.lens_of or name])
        if lens is not None:
            lenses[name] = lens
    return lenses


def given_projector(entry: ProjectorEntry | None) -> Camera | None:
    """Return the projector seen from its camera, if it is given completely."""
    lens, pose = (None, None) if entry is None else (lens_of(entry), pose_of(entry))
    return Camera(lens, pose) if lens is not None and pose is not None else None
