"""``impasto render``: one picture of an asset."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path

import click

METHODS = ("hybrid", "bump", "relief", "mesh", "reference")
BACKENDS = ("auto", "gpu", "cpu")
_LARGEST_SIDE_PX = 16384


def _size(_context: click.Context, _parameter: click.Parameter, value: str) -> tuple[int, int]:
    """Read WIDTHxHEIGHT."""
    match = re.fullmatch(r"(\d{1,6})[xX](\d{1,6})", value.strip())
    size = (int(match[1]), int(match[2])) if match else (0, 0)
    if not 1 <= min(size) <= max(size) <= _LARGEST_SIDE_PX:
        raise click.BadParameter(
            f"{value!r} is not WIDTHxHEIGHT with sides from 1 to {_LARGEST_SIDE_PX}, as 1280x720"
        )
    return size


def _distance(
    _context: click.Context, _parameter: click.Parameter, value: str
) -> tuple[float, bool]:
    """Read a factor of the framed distance, or a length; return (number, whether it is mm)."""
    text = value.strip().lower()
    try:
        number = float(text.removesuffix("mm"))
    except ValueError:
        number = math.nan
    if not 0 < number < math.inf:
        raise click.BadParameter(
            f"{value!r} is neither a factor such as 0.5 nor a length such as 400mm"
        )
    return number, text.endswith("mm")


def _finite(
    low: float = -math.inf, high: float = math.inf, *, open_low: bool = False
) -> Callable[[click.Context, click.Parameter, float | None], float | None]:
    """Check a range; NaN and infinities, which click's own ranges let through, are refused."""

    def check(
        _context: click.Context, _parameter: click.Parameter, value: float | None
    ) -> float | None:
        if value is None:
            return None
        above = value > low if open_low else value >= low
        if not (math.isfinite(value) and above and value <= high):
            bounds = ["finite"]
            if math.isfinite(low):
                bounds.append(f"{'more than' if open_low else 'at least'} {low:g}")
            if math.isfinite(high):
                bounds.append(f"at most {high:g}")
            raise click.BadParameter(f"{value:g} is not {', '.join(bounds)}")
        return value

    return check


def _asset_folder(given: Path) -> Path:
    """Return the asset folder that was given, or the one in the workspace that was given."""
    from pipeline.errors import ImpastoError

    for folder in (given, given / "asset"):
        if (folder / "asset.json").is_file():
            return folder
    raise ImpastoError(
        "there is no asset" if given.is_dir() else "there is no such folder",
        where=str(given),
        expected="an asset folder (with asset.json) or a workspace that holds one",
        fix="impasto run BUNDLE --out WORKSPACE makes one",
    )


_ELEVATION = _finite(0, 90, open_low=True)
_POSITIVE = _finite(0, open_low=True)


@click.command(short_help="Draw an asset into a picture.")
@click.argument("asset", type=click.Path(path_type=Path))
@click.option(
    "--out", required=True, type=click.Path(path_type=Path, dir_okay=False), help=".png or .exr"
)
@click.option("--method", type=click.Choice(METHODS), default="hybrid", show_default=True)
@click.option("--backend", type=click.Choice(BACKENDS), default="auto", show_default=True)
@click.option("--size", metavar="WxH", callback=_size, default="1280x720", show_default=True)
@click.option(
    "--azimuth", type=float, callback=_finite(), default=-90.0, show_default=True,
    help="Where the camera stands: 0 right of the canvas, 90 above, -90 below; degrees.",
)  # fmt: skip
@click.option(
    "--elevation", type=float, callback=_ELEVATION, default=90.0, show_default=True,
    help="The camera's angle above the canvas plane: 90 frontal, near 0 grazing; degrees.",
)  # fmt: skip
@click.option(
    "--distance", metavar="FACTOR|MM", callback=_distance, default="1", show_default=True,
    help="From the canvas's centre: 1 just frames the canvas; or a length, 400mm.",
)  # fmt: skip
@click.option(
    "--fov", type=float, callback=_finite(0, 170, open_low=True), default=30.0, show_default=True,
    help="Vertical field of view, degrees.",
)  # fmt: skip
@click.option(
    "--light-azimuth", type=float, callback=_finite(), default=135.0, show_default=True,
    help="Where the lamp stands, as --azimuth.",
)  # fmt: skip
@click.option(
    "--light-elevation", type=float, callback=_ELEVATION, default=45.0, show_default=True,
    help="The lamp's angle above the canvas plane; small is raking light; degrees.",
)  # fmt: skip
@click.option(
    "--light-distance", type=float, callback=_POSITIVE, default=1000.0, show_default=True,
    help="From the canvas's centre to the lamp, mm.",
)  # fmt: skip
@click.option(
    "--light-intensity", type=float, callback=_finite(0), default=math.pi, show_default="pi",
    help="Radiant intensity of the lamp, W/sr.",
)  # fmt: skip
@click.option(
    "--exposure", type=float, callback=_POSITIVE, default=None,
    help="Factor on the radiance (.png); by default the brightest 1 % begins at 0.9.",
)  # fmt: skip
@click.option("--bits", type=click.Choice(["8", "16"]), default="8", help="Depth of a .png.")
@click.option(
    "--samples", type=click.IntRange(1, 256), default=1, show_default=True,
    help="Rays per pixel, a square number.",
)  # fmt: skip
@click.option("--no-shadows", is_flag=True, help="Let the relief cast no shadow on itself.")
@click.option("--no-adaptive", is_flag=True, help="hybrid: draw every box, however flat it looks.")
def render(
    asset: Path,
    out: Path,
    method: str,
    backend: str,
    size: tuple[int, int],
    azimuth: float,
    elevation: float,
    distance: tuple[float, bool],
    fov: float,
    light_azimuth: float,
    light_elevation: float,
    light_distance: float,
    light_intensity: float,
    exposure: float | None,
    bits: str,
    samples: int,
    no_shadows: bool,
    no_adaptive: bool,
) -> None:
    """Draw ASSET (an asset folder, or a workspace that holds one) into a picture.

    Without a graphics adapter the exact reference is drawn on the CPU, and the last line says so.
    """
    from pipeline.formats.asset import load_asset
    from renderers import draw, tone
    from renderers.adaptive import Adaptive
    from renderers.painting import PaintOptions
    from renderers.view import arc_light, orbit_view

    if out.suffix.lower() not in tone.SUFFIXES:
        raise click.BadParameter(f"{out.name!r} ends in neither .png nor .exr", param_hint="--out")
    if round(samples**0.5) ** 2 != samples:
        raise click.BadParameter(f"{samples} is not a square number", param_hint="--samples")
    if method == "reference" and backend == "gpu":
        raise click.UsageError("the reference is drawn on the CPU; leave --backend gpu out")
    painting = load_asset(_asset_folder(asset))
    number, in_mm = distance
    view = orbit_view(
        painting,
        azimuth_deg=azimuth,
        elevation_deg=elevation,
        distance=1.0 if in_mm else number,
        distance_mm=number if in_mm else None,
        field_of_view_deg=fov,
        size_px=size,
    )
    light = arc_light(
        painting,
        azimuth_deg=light_azimuth,
        elevation_deg=light_elevation,
        distance_mm=light_distance,
        intensity=light_intensity,
    )
    options = PaintOptions(
        shadows=not no_shadows,
        samples=samples,
        adaptive=None if no_adaptive else Adaptive(),
    )
    result = draw.render(painting, view, [light], method=method, backend=backend, options=options)
    factor = tone.automatic_exposure(result.image) if exposure is None else exposure
    tone.write_image(out, result.image, exposure=factor, bits=int(bits))
    shown = f", exposure {factor:.4g}" if out.suffix.lower() == ".png" else ", linear"
    line = f"{out}: {size[0]} x {size[1]}, {result.method}, {result.adapter}"
    line += f", {result.elapsed_s:.2f} s{shown}"
    click.echo("; ".join([line, *result.notes]))
