"""The cameras that were found, in ``reflectance/photos.json``."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from pipeline.formats.reflectance_maps import SAMPLES, FoundCamera, ReflectanceSamples
from pipeline.geometry.camera import Camera, Lens
from pipeline.geometry.rigid import RigidTransform

FOUND = FoundCamera(
    "pose-C2",
    "C2",
    None,
    Camera(
        Lens((4, 3), np.array([[9.5, 0, 2], [0, 9.25, 1], [0, 0, 1]]), np.arange(5) / 10),
        RigidTransform(np.diag([1.0, -1.0, -1.0]), np.array([1.0, 2, 3])),
    ),
    0.125,
    400,
    0.75,
    0.0625,
    0.5,
)


def save(folder: Path, cameras: tuple[FoundCamera, ...]) -> None:
    (folder / "reflectance").mkdir()
    samples = ReflectanceSamples(
        np.zeros((1, 2, 2, 3), np.float32), np.ones((1, 3)), np.ones((1, 3)), ("p",), True, cameras
    )
    SAMPLES.save(folder, samples)


def test_cameras_come_back_as_they_were_saved(tmp_path: Path) -> None:
    save(tmp_path, (FOUND,))
    (camera,) = SAMPLES.load(tmp_path).cameras
    assert camera.camera.lens.size_px == (4, 3)
    np.testing.assert_array_equal(camera.camera.pose.matrix, FOUND.camera.pose.matrix)
    np.testing.assert_array_equal(camera.camera.lens.K, FOUND.camera.lens.K)
    np.testing.assert_array_equal(camera.camera.lens.distortion, FOUND.camera.lens.distortion)
    for key in ("sequence", "name", "light", "rms_px", "points", "share", "sigma_mm", "sigma_deg"):
        assert getattr(camera, key) == getattr(FOUND, key)


def test_a_document_without_cameras_is_read_as_before(tmp_path: Path) -> None:
    save(tmp_path, (FOUND,))
    path = tmp_path / "reflectance" / "photos.json"
    document = json.loads(path.read_text())
    del document["cameras"]
    path.write_text(json.dumps(document))
    samples = SAMPLES.load(tmp_path)
    assert samples.cameras == ()
    assert samples.names == ("p",)
