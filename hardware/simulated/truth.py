"""The truth of a simulated capture, in files that nothing in the bundle points to.

``surface.npz``: x_mm, y_mm (row 0 the smallest y), height_mm, normal_xy, mask, in the canvas frame
(origin at the canvas's centre, z out of the paint). ``brdf.npz``: rho_d, rho_s, C, k on the same
grid. ``scan.npz``: depth_um of each pixel centre of C0, and what it shows (1 canvas, 2 frame,
3 table). ``truth.json``: where canvas, cameras, projector, lamps and boards are. ``photos/``:
noise-free photographs from places that the capture does not have.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware.simulated.layout import (
    BOARD,
    SCAN_CAMERA,
    Layout,
    direction,
    look_from,
)
from hardware.simulated.motif import CANVAS_MM
from hardware.simulated.optics import Image, lens_rays, open_eye, see_by_lamp, spread
from hardware.simulated.painting import FRAME_TOP_MM, Painting
from hardware.simulated.rig import Physics
from hardware.simulated.subjects import PaintedCanvas, PaintingOnTable
from pipeline.formats.atomic import write_text_atomically
from pipeline.formats.images import write_png
from pipeline.geometry.camera import Camera

_TEST_PLACES = ((-90.0, 88.0, 120.0, 40.0), (-50.0, 50.0, 170.0, 35.0), (110.0, 60.0, -70.0, 60.0))
"""Azimuth and elevation of camera and lamp, degrees."""

_TEST_CAMERA_MM, _TEST_LAMP_MM = 530.0, 560.0


def write_truth(
    folder: Path, layout: Layout, canvas: PaintedCanvas, physics: Physics, seed: int, tests: int
) -> None:
    """Write all files of the truth into ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    _write_surface(folder, canvas.painting)
    _write_scan(folder, layout, canvas)
    document = {
        "seed": seed,
        "units": "value = responsivity_per_s * exposure_s * intensity / (r_mm/1000)^2 * cos * f",
        "rig_from_canvas": layout.rig_from_canvas.matrix.tolist(),
        "frame_height_mm": FRAME_TOP_MM,
        "cameras": {name: _device(camera) for name, camera in layout.cameras.items()},
        "projector": _device(layout.projector)
        | {"relative_to_C0": _pose(layout.projector, layout.cameras[SCAN_CAMERA])},
        "lamps": {
            name: {"position_mm": place.tolist(), "intensity": physics.lamp_intensity}
            for name, place in layout.stops.items()
        },
        "turntable": {"axis_point_mm": [0.0, 0.0, 0.0], "axis_direction": [0.0, 0.0, 1.0]},
        "boards": _boards(layout),
        "test_photos": _write_tests(folder, layout, canvas, physics, tests),
    }
    write_text_atomically(folder / "truth.json", json.dumps(document, indent=1) + "\n")


def _write_surface(folder: Path, painting: Painting) -> None:
    """Write heights and reflectance, cut to the canvas, the parts under the frame masked."""
    columns = np.abs(painting.x_mm) <= CANVAS_MM[0] / 2 + 1e-9
    rows = np.abs(painting.y_mm) <= CANVAS_MM[1] / 2 + 1e-9

    def upward(image: NDArray[Any]) -> NDArray[Any]:
        return np.ascontiguousarray(image[np.ix_(rows, columns)][::-1])

    np.savez_compressed(
        folder / "surface.npz",
        x_mm=painting.x_mm[columns],
        y_mm=painting.y_mm[rows][::-1],
        height_mm=upward(painting.heights_mm),
        normal_xy=upward(painting.normals)[..., :2].astype(np.float16),
        mask=upward(painting.canvas),
    )
    lobe = upward(painting.lobe).astype(np.float16)
    np.savez_compressed(
        folder / "brdf.npz",
        rho_d=upward(painting.diffuse).astype(np.float16),
        rho_s=upward(painting.specular).astype(np.float16),
        C=lobe[..., [0, 0, 1]],
        k=lobe[..., 2],
    )


def _write_scan(folder: Path, layout: Layout, canvas: PaintedCanvas) -> None:
    camera = layout.cameras[SCAN_CAMERA]
    eye = open_eye(camera, lens_rays(camera.lens, 1))
    hits = PaintingOnTable(canvas, layout.rig_from_canvas).trace(eye.origin_mm, eye.directions)
    width, height = camera.lens.size_px
    depth = np.rint(camera.depth(hits.points_mm) * 1000)
    np.savez_compressed(
        folder / "scan.npz",
        depth_um=np.nan_to_num(depth).astype(np.int32).reshape(height, width),
        object=hits.kind.reshape(height, width),
    )


def _write_tests(
    folder: Path, layout: Layout, canvas: PaintedCanvas, physics: Physics, count: int
) -> list[dict[str, Any]]:
    """Photograph the painting from elsewhere, without noise; poses map canvas coordinates."""
    entries = []
    subject = PaintingOnTable(canvas, layout.rig_from_canvas)
    (folder / "photos").mkdir(exist_ok=True)
    lens = layout.cameras["C1"].lens
    rays = lens_rays(lens, physics.samples)
    for number, (azimuth, elevation, lamp_azimuth, lamp_elevation) in enumerate(
        _TEST_PLACES[:count]
    ):
        centre = layout.rig_from_canvas.translation_mm
        camera = look_from(centre + _TEST_CAMERA_MM * direction(azimuth, elevation), lens)
        lamp = centre + _TEST_LAMP_MM * direction(lamp_azimuth, lamp_elevation)
        eye = open_eye(camera, rays)
        seen = spread(see_by_lamp(eye, subject, lamp, physics.lamp_intensity), physics.spread_px)
        exposure_s = _exposure(seen, physics)
        file = f"photos/{number:03d}.png"
        write_png(folder / file, physics.sensor.record(seen, exposure_s, None))
        pose = camera.pose @ layout.rig_from_canvas
        entries.append(
            {
                "file": file,
                "size_px": list(lens.size_px),
                "K": lens.K.tolist(),
                "distortion": lens.distortion.tolist(),
                "exposure_s": exposure_s,
                "responsivity_per_s": physics.sensor.responsivity_per_s,
                "R": pose.rotation.tolist(),
                "t_mm": pose.translation_mm.tolist(),
                "light_mm": layout.rig_from_canvas.inverse().apply(lamp).tolist(),
                "intensity": physics.lamp_intensity,
                "noise": False,
            }
        )
    return entries


def _exposure(seen: Image, physics: Physics) -> float:
    """Return the exposure that puts the 99.8th percentile at 0.8 of full scale."""
    return round(0.8 / (float(np.quantile(seen, 0.998)) * physics.sensor.responsivity_per_s), 6)


def _boards(layout: Layout) -> dict[str, Any]:
    """Return board to C0, and the corners' true pixels, of each board sequence."""
    camera = layout.cameras[SCAN_CAMERA]
    columns, rows = BOARD.inner_corners
    grid = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)
    corners = np.concatenate([grid * BOARD.square_mm, np.zeros((len(grid), 1))], axis=1)
    boards = {}
    for name, pose in layout.boards.items():
        seen = camera.pose @ pose
        boards[name] = {
            "R": seen.rotation.tolist(),
            "t_mm": seen.translation_mm.tolist(),
            "corners_px": camera.project(pose.apply(corners)).tolist(),
        }
    return boards


def _device(camera: Camera) -> dict[str, Any]:
    return {
        "size_px": list(camera.lens.size_px),
        "K": camera.lens.K.tolist(),
        "distortion": camera.lens.distortion.tolist(),
        "R": camera.pose.rotation.tolist(),
        "t_mm": camera.pose.translation_mm.tolist(),
        "position_mm": camera.centre_mm.tolist(),
    }


def _pose(device: Camera, base: Camera) -> dict[str, Any]:
    relative = device.pose @ base.pose.inverse()
    return {"R": relative.rotation.tolist(), "t_mm": relative.translation_mm.tolist()}
