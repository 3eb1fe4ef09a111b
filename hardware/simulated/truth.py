"""The truth of a simulated capture, in files that nothing in the bundle points to.

``surface.npz``: x_mm, y_mm (row 0 is the smallest y), height_mm, normal_xy, mask, in the canvas
frame (origin at the canvas's centre, z out of the paint). ``brdf.npz``: rho_d, rho_s, C, k on the
same grid. ``scan.npz``: depth_um of every pixel of C0, and the object it shows. ``truth.json``:
where canvas, cameras, projector and lamps are.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware.simulated.optics import PaintingSolid, look
from hardware.simulated.painting import BASE_MM, FRAME_WIDTH_MM, Scene
from hardware.simulated.rig import Bench
from pipeline.formats.atomic import write_text_atomically
from pipeline.geometry.camera import Camera
from pipeline.geometry.rigid import RigidTransform


def write_truth(
    folder: Path,
    bench: Bench,
    scene: Scene,
    solid: PaintingSolid,
    rig_from_object: RigidTransform,
) -> None:
    """Write all files of the truth into ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    rows, columns = np.nonzero(scene.canvas)
    part = np.s_[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]

    def upward(image: NDArray[Any]) -> NDArray[Any]:
        return np.ascontiguousarray(image[part][::-1])

    width, tall = scene.size_mm
    heights = scene.heights_mm.astype(np.float64)
    down, right = np.gradient(heights, scene.spacing_mm)
    normals = np.stack([-right, down], axis=-1) / np.sqrt(1 + right**2 + down**2)[..., None]
    np.savez_compressed(
        folder / "surface.npz",
        x_mm=(np.arange(scene.canvas.shape[1]) * scene.spacing_mm - width / 2)[part[1]],
        y_mm=(tall / 2 - np.arange(scene.canvas.shape[0]) * scene.spacing_mm)[part[0]][::-1],
        height_mm=upward(heights - BASE_MM).astype(np.float32),
        normal_xy=upward(normals).astype(np.float32),
        mask=upward(scene.canvas),
    )
    np.savez_compressed(
        folder / "brdf.npz",
        rho_d=upward(scene.diffuse).astype(np.float16),
        rho_s=upward(scene.specular).astype(np.float16),
        C=upward(scene.lobe[..., [0, 0, 1]]).astype(np.float16),
        k=upward(scene.lobe[..., 2]).astype(np.float16),
    )
    camera = bench.cameras["C0"]
    seen = look(camera, solid, rig_from_object, 1)
    depth = camera.depth(rig_from_object.apply(seen.points_mm))
    np.savez_compressed(
        folder / "scan.npz",
        depth_um=np.nan_to_num(depth * 1000).astype(np.uint32),
        object=_objects(scene, seen.points_mm),
    )
    to_canvas = RigidTransform(np.eye(3), np.array([0.0, 0.0, BASE_MM]))
    document = {
        "rig_from_canvas": (rig_from_object @ to_canvas).matrix.tolist(),
        "cameras": {name: _entry(camera) for name, camera in bench.cameras.items()},
        "projector": _entry(bench.projector),
        "lamps": {name: {"position_mm": place.tolist()} for name, place in bench.lamps.items()},
        "turntable": {"axis_point_mm": [0, 0, 0], "axis_direction": [0, 0, 1]},
    }
    write_text_atomically(folder / "truth.json", json.dumps(document, indent=1) + "\n")


def _objects(scene: Scene, points_mm: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Return 1 for the canvas, 2 for the frame, 3 for the table, 0 for nothing."""
    half = np.argwhere(scene.canvas)
    rows, columns = np.ptp(half, axis=0) * scene.spacing_mm / 2
    out = np.maximum(np.abs(points_mm[..., 0]) - columns, np.abs(points_mm[..., 1]) - rows)
    kind = np.where(out <= 0, 1, np.where(out <= FRAME_WIDTH_MM, 2, 3))
    return np.where(np.isfinite(out), kind, 0).astype(np.uint8)


def _entry(camera: Camera) -> dict[str, Any]:
    return {
        "size_px": list(camera.lens.size_px),
        "K": camera.lens.K.tolist(),
        "distortion": camera.lens.distortion.tolist(),
        "R": camera.pose.rotation.tolist(),
        "t_mm": camera.pose.translation_mm.tolist(),
    }
