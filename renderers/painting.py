"""The painting on the GPU: bump mapping, relief mapping in boxes, and the full mesh.

``hybrid`` draws the plane at d0 with bump mapping, then the boxes with relief mapping, each as
opaque as its parallax deserves. ``bump`` draws the plane only, ``relief`` one box around the whole
field, ``mesh`` two triangles per patch. All shade with the same function, from the true height.

Heights, normals and interpolation weights are float32, reflectance is float16 (relative error
below 5e-4, as the asset is archived). The picture is float32, or float16 where boxes blend.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import UsageError
from pipeline.formats.asset import Asset
from renderers import packing
from renderers.adapter import Adapter, GpuUnavailable
from renderers.adaptive import Adaptive
from renderers.pipelines import (
    DEPTH_FORMAT,
    VISIBLE_FORMAT,
    colour_format,
    painting_pipelines,
    read_colours,
    upload_buffer,
    upload_texture,
)
from renderers.view import Light, View

Method = Literal["hybrid", "bump", "relief", "mesh"]
METHODS: tuple[Method, ...] = get_args(Method)

_HOLE = np.float32(-1e30)  # outside the canvas: even a 1e-14th of it is below HOLE_LIMIT
_NOTHING = (-1e9, -1e9, 0, 0)  # place on the grid of a pixel that sees no canvas
_BOX_VERTICES = 14


@dataclass(frozen=True)
class PaintOptions:
    """How a frame is drawn.

    Parameters
    ----------
    shadows
        Whether the relief shadows itself.
    samples
        Rays per pixel, on a regular grid: a square number in [1, 256].
    adaptive
        The choice between bump and relief per box (``hybrid`` only); None draws all boxes.
    """

    shadows: bool = True
    samples: int = 1
    adaptive: Adaptive | None = field(default_factory=Adaptive)

    def __post_init__(self) -> None:
        side = round(self.samples**0.5) if self.samples > 0 else 0
        if side * side != self.samples or not 1 <= side <= 16:
            raise UsageError(
                f"{self.samples} samples per pixel do not fill a square grid",
                expected="a square number from 1 to 256: 1, 4, 9, 16 ...",
            )


class Painting:
    """One asset, uploaded once and drawn from any view in any light.

    Raises
    ------
    GpuUnavailable
        The asset is larger than the adapter's textures.
    """

    def __init__(self, asset: Asset, adapter: Adapter) -> None:
        self.asset, self.adapter = asset, adapter
        self._check_size("painting", asset.heights_mm.shape[::-1])
        self._box_tops = packing.box_tops(asset)
        valid = packing.valid_samples(asset)
        heights = np.where(valid, asset.heights_mm, _HOLE).astype(np.float32)
        reflectance = {"diffuse": asset.diffuse, "specular": asset.specular, "lobe": asset.lobe}
        device = adapter.device
        self._textures = [
            upload_texture(device, "heights", heights[..., None], "r32float"),
            upload_texture(device, "normals", asset.normals.astype(np.float32), "rg32float"),
            *(
                upload_texture(device, name, _four_halves(image), "rgba16float")
                for name, image in reflectance.items()
            ),
        ]
        self._bounds = [upload_buffer(device, array) for array in packing.pack_bounds(asset)]

    def draw(
        self,
        view: View,
        lights: Sequence[Light],
        method: Method = "hybrid",
        options: PaintOptions | None = None,
    ) -> NDArray[np.float32]:
        """Draw one frame.

        Returns
        -------
        (h, w, 4) float32
            Linear RGB radiance, premultiplied by the coverage in the last channel.

        Raises
        ------
        GpuUnavailable
            The view has lens distortion, or the picture is larger than the adapter's textures.
        """
        options = options or PaintOptions()
        self._check_size("picture", view.size_px)
        if np.any(view.camera.lens.distortion):
            raise GpuUnavailable(
                "the view has lens distortion", expected="a pinhole", fix="use --backend cpu"
            )
        width, height = view.size_px
        if min(self.asset.heights_mm.shape) < 2:  # no patch, nothing to see
            return np.zeros((height, width, 4), np.float32)

        asset, tops = self.asset, self._box_tops
        boxes = np.zeros(0, packing.BOX)
        alpha = np.zeros(len(tops), np.float32)
        if method == "relief":
            boxes = packing.pack_whole_box(asset)
        elif method == "hybrid":
            alpha = packing.drawn_alphas(asset, tops, view, options.adaptive)
            boxes = packing.pack_boxes(asset, tops, alpha, view)
        hidden = packing.opaque_patches(asset, alpha)[..., None]
        opaque_boxes = upload_texture(self.adapter.device, "opaque boxes", hidden, "r8unorm")
        lamps, scale = packing.pack_lamps(self.asset, lights)

        side = round(options.samples**0.5)
        offsets = (np.arange(side) + 0.5) / side - 0.5
        total = np.zeros((height, width, 4))
        for y, x in product(offsets, offsets):
            frame = packing.pack_frame(self.asset, view, (x, y), len(lights), options.shadows)
            total += self._draw_once(frame, lamps, boxes, opaque_boxes, method, view.size_px)
        total /= options.samples
        total[..., :3] *= scale
        return total.astype(np.float32)

    def _draw_once(
        self,
        frame: NDArray[np.void],
        lamps: NDArray[np.void],
        boxes: NDArray[np.void],
        opaque_boxes: Any,
        method: Method,
        size_px: tuple[int, int],
    ) -> NDArray[np.floating]:
        device = self.adapter.device
        opaque = int(np.count_nonzero(boxes["alpha"] == 1.0))
        blends = opaque < len(boxes)
        pipelines = painting_pipelines(self.adapter, blends)
        resources = [
            upload_buffer(device, frame, uniform=True),
            upload_buffer(device, lamps),
            upload_buffer(device, boxes),
            *self._textures,
            opaque_boxes,
            *self._bounds,
        ]
        group = device.create_bind_group(
            layout=pipelines.layout,
            entries=[{"binding": i, "resource": r} for i, r in enumerate(resources)],
        )
        visible = self._target(VISIBLE_FORMAT, size_px)
        target = self._target(colour_format(blends), size_px)
        depth = self._target(DEPTH_FORMAT, size_px).create_view()
        seen = device.create_bind_group(
            layout=pipelines.visible_layout,
            entries=[{"binding": 0, "resource": visible.create_view()}],
        )
        encoder = device.create_command_encoder()

        geometry = encoder.begin_render_pass(
            color_attachments=[_attachment(visible, clear=_NOTHING)],
            depth_stencil_attachment=_depth_attachment(depth, clear=True),
        )
        geometry.set_bind_group(0, group)
        if method in ("hybrid", "bump"):
            geometry.set_pipeline(pipelines.plane)
            geometry.draw(4)
        if opaque:
            geometry.set_pipeline(pipelines.box)
            geometry.draw(_BOX_VERTICES, opaque)
        if method == "mesh":
            rows, columns = self.asset.heights_mm.shape
            geometry.set_pipeline(pipelines.mesh)
            geometry.draw(6 * (rows - 1) * (columns - 1))
        geometry.end()

        shading = encoder.begin_render_pass(
            color_attachments=[_attachment(target, clear=(0, 0, 0, 0))]
        )
        shading.set_bind_group(0, group)
        shading.set_bind_group(1, seen)
        shading.set_pipeline(pipelines.shade)
        shading.draw(3)
        shading.end()

        if blends:
            blending = encoder.begin_render_pass(
                color_attachments=[_attachment(target)],
                depth_stencil_attachment=_depth_attachment(depth),
            )
            blending.set_bind_group(0, group)
            blending.set_pipeline(pipelines.blended_box)
            blending.draw(_BOX_VERTICES, len(boxes) - opaque, 0, opaque)
            blending.end()
        device.queue.submit([encoder.finish()])
        return read_colours(device, target, size_px, blends=blends)

    def _target(self, texture_format: str, size_px: tuple[int, int]) -> Any:
        import wgpu

        usage = wgpu.TextureUsage.RENDER_ATTACHMENT
        if texture_format != DEPTH_FORMAT:
            usage |= wgpu.TextureUsage.TEXTURE_BINDING | wgpu.TextureUsage.COPY_SRC
        return self.adapter.device.create_texture(
            size=(*size_px, 1), format=texture_format, usage=usage
        )

    def _check_size(self, what: str, size: tuple[int, ...]) -> None:
        largest = self.adapter.largest_texture
        if max(size) > largest:
            raise GpuUnavailable(
                f"the {what} is {size[0]} x {size[1]}",
                expected=f"at most {largest} a side on {self.adapter}",
                fix="use --backend cpu",
            )


def _attachment(texture: Any, clear: tuple[float, ...] | None = None) -> dict[str, Any]:
    attachment = {"view": texture.create_view(), "load_op": "load", "store_op": "store"}
    return attachment if clear is None else attachment | {"load_op": "clear", "clear_value": clear}


def _depth_attachment(view: Any, *, clear: bool = False) -> dict[str, Any]:
    return {
        "view": view,
        "depth_load_op": "clear" if clear else "load",
        "depth_clear_value": 0.0,
        "depth_store_op": "store",
    }


def _four_halves(image: NDArray[np.float32]) -> NDArray[np.float16]:
    """Widen (rows, columns, 3) to four channels of float16; too large values are clipped."""
    largest = float(np.finfo(np.float16).max)
    four = np.zeros((*image.shape[:2], 4), np.float16)
    four[..., :3] = np.clip(np.nan_to_num(image), -largest, largest)
    return four
