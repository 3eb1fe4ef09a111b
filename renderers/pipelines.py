"""The painting's shaders compiled, and memory moved to and from the device."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from renderers.adapter import Adapter

_SHADERS = ("painting.wgsl", "intersect.wgsl", "shading.wgsl")
_OVER = {
    "color": {"src_factor": "src-alpha", "dst_factor": "one-minus-src-alpha"},
    "alpha": {"src_factor": "one", "dst_factor": "one-minus-src-alpha"},
}


VISIBLE_FORMAT = "rg32float"
DEPTH_FORMAT = "depth32float"


@dataclass(frozen=True)
class Pipelines:
    """One render pipeline per way of drawing, all with the same bindings.

    ``plane``, ``box`` and ``mesh`` write the place on the grid that a pixel sees, ``shade`` turns
    it into light, ``blended_box`` draws over that.
    """

    layout: Any
    visible_layout: Any
    plane: Any
    box: Any
    mesh: Any
    shade: Any
    blended_box: Any


def shader_source() -> str:
    """Return the WGSL of the painting, its files joined."""
    folder = Path(__file__).parent
    return "\n".join((folder / name).read_text(encoding="utf-8") for name in _SHADERS)


def colour_format(blends: bool) -> str:
    """Return the picture's format: WebGPU does not blend float32."""
    return "rgba16float" if blends else "rgba32float"


@lru_cache(maxsize=2)
def painting_pipelines(adapter: Adapter, blends: bool) -> Pipelines:
    """Compile the shaders for pictures of ``colour_format(blends)``.

    Raises
    ------
    wgpu.GPUValidationError
        The WGSL does not compile; the text has the compiler's message.
    """
    import wgpu

    device = adapter.device
    module = device.create_shader_module(label="painting", code=shader_source())
    stages = wgpu.ShaderStage.VERTEX | wgpu.ShaderStage.FRAGMENT
    texture = {"texture": {"sample_type": "unfilterable-float", "view_dimension": "2d"}}
    storage = {"buffer": {"type": "read-only-storage"}}
    resources = [{"buffer": {"type": "uniform"}}, *[storage] * 2, *[texture] * 6, *[storage] * 2]
    layout = device.create_bind_group_layout(
        entries=[{"binding": i, "visibility": stages, **r} for i, r in enumerate(resources)]
    )
    visible_layout = device.create_bind_group_layout(
        entries=[{"binding": 0, "visibility": wgpu.ShaderStage.FRAGMENT, **texture}]
    )
    depth = {"format": DEPTH_FORMAT, "depth_write_enabled": True, "depth_compare": "greater"}
    strip = {"topology": "triangle-strip"}
    triangles = {"topology": "triangle-list"}
    far_faces = strip | {"front_face": "ccw", "cull_mode": "front"}

    def pipeline(name: str, primitive: dict[str, str], target: dict[str, Any], **more: Any) -> Any:
        """Build the pipeline of ``<name>_fragment`` and, unless told, ``<name>_vertex``."""
        groups = [layout, visible_layout] if name == "shade" else [layout]
        vertex = more.pop("vertex", f"{name}_vertex")
        return device.create_render_pipeline(
            label=name,
            layout=device.create_pipeline_layout(bind_group_layouts=groups),
            vertex={"module": module, "entry_point": vertex},
            primitive=primitive,
            fragment={"module": module, "entry_point": f"{name}_fragment", "targets": [target]},
            **more,
        )

    visible = {"format": VISIBLE_FORMAT}
    colour = {"format": colour_format(blends)}
    over = colour | ({"blend": _OVER} if blends else {})
    return Pipelines(
        layout=layout,
        visible_layout=visible_layout,
        plane=pipeline("plane", strip, visible, depth_stencil=depth),
        box=pipeline("box", far_faces, visible, depth_stencil=depth),
        mesh=pipeline("mesh", triangles, visible, depth_stencil=depth),
        shade=pipeline("shade", triangles, colour),
        blended_box=pipeline(
            "blended_box", far_faces, over, depth_stencil=depth, vertex="box_vertex"
        ),
    )


def upload_texture(device: Any, label: str, image: NDArray[Any], texture_format: str) -> Any:
    """Upload (rows, columns, channels) and return the texture's view."""
    import wgpu

    rows, columns, _ = image.shape
    texture = device.create_texture(
        label=label,
        size=(columns, rows, 1),
        format=texture_format,
        usage=wgpu.TextureUsage.TEXTURE_BINDING | wgpu.TextureUsage.COPY_DST,
    )
    device.queue.write_texture(
        {"texture": texture},
        np.ascontiguousarray(image),
        {"bytes_per_row": image.nbytes // rows, "rows_per_image": rows},
        (columns, rows, 1),
    )
    return texture.create_view()


def upload_buffer(device: Any, data: NDArray[Any], *, uniform: bool = False) -> dict[str, Any]:
    """Upload an array as a whole buffer's binding; an empty one becomes one zero element."""
    import wgpu

    content = data.tobytes() or bytes(data.itemsize)
    usage = wgpu.BufferUsage.UNIFORM if uniform else wgpu.BufferUsage.STORAGE
    buffer = device.create_buffer_with_data(data=content, usage=usage)
    return {"buffer": buffer, "offset": 0, "size": len(content)}


def read_colours(
    device: Any, texture: Any, size_px: tuple[int, int], *, blends: bool
) -> NDArray[np.floating]:
    """Read a picture of ``colour_format(blends)`` back, (height, width, 4)."""
    width, height = size_px
    number = np.dtype("<f2" if blends else "<f4")
    data = device.queue.read_texture(
        {"texture": texture},
        {"bytes_per_row": width * 4 * number.itemsize, "rows_per_image": height},
        (width, height, 1),
    )
    return np.frombuffer(data, dtype=number).reshape(height, width, 4)
