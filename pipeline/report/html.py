"""The few pieces of HTML that the report is made of; every text is escaped here."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence
from importlib import resources

from pipeline.report.figures import FalseColour, Picture, data_uri, fit_width, round_length

escape = html.escape


def figure(
    picture: Picture,
    caption: str,
    *,
    scale: FalseColour | None = None,
    overlay: str = "",
    lossless: bool = False,
) -> str:
    """Return a picture with its caption, the legend of its false colour, and an SVG overlay.

    The overlay is SVG in units of the picture's own pixels, made by this package only.
    """
    rows, columns = picture.shape[:2]
    address = data_uri(fit_width(picture), lossless=lossless)
    drawing = (
        f'<svg viewBox="0 0 {columns} {rows}" preserveAspectRatio="none" aria-hidden="true">'
        f"{overlay}</svg>"
        if overlay
        else ""
    )
    return (
        f'<figure><div class="picture"><img src="{address}" alt="{escape(caption)}">{drawing}</div>'
        f"{legend(scale) if scale else ''}<figcaption>{escape(caption)}</figcaption></figure>"
    )


def drawing(svg: str, caption: str) -> str:
    """Return an SVG drawing, made by this package only, with its caption."""
    return (
        f'<figure><div class="picture">{svg}</div><figcaption>{escape(caption)}</figcaption>'
        "</figure>"
    )


def bullets(lines: Iterable[str]) -> str:
    """Return a list; nothing for no lines."""
    items = "".join(f"<li>{escape(line)}</li>" for line in lines)
    return f"<ul>{items}</ul>" if items else ""


def details(summary: str, body: str) -> str:
    """Return what opens only when asked."""
    return f"<details><summary>{escape(summary)}</summary>{body}</details>"


def legend(scale: FalseColour) -> str:
    """Return the colour bar of a picture in false colour, with its ends and unit."""
    bar = data_uri(scale.legend, lossless=True)
    beyond = f" ({scale.clipped:.1%} lie beyond)" if scale.clipped > 0.0005 else ""
    return (
        f'<div class="legend"><span>{number(scale.low)}</span><img src="{bar}" alt="">'
        f"<span>{number(scale.high)} {escape(scale.unit)}{beyond}</span></div>"
    )


def scale_bar(rows: int, columns: int, spacing_mm: float) -> str:
    """Return an SVG scale bar of a round length for a picture with ``spacing_mm`` per pixel."""
    length_mm = round_length(columns * spacing_mm / 4)
    width, unit = length_mm / spacing_mm, rows / 100
    left, top = columns * 0.03, rows * 0.955
    label = f"{length_mm:g} mm"
    return (
        f'<g stroke="none"><rect x="{left:.2f}" y="{top:.2f}" width="{width:.2f}" '
        f'height="{unit:.2f}" fill="#fff" stroke="#222" stroke-width="{unit / 6:.2f}"/>'
        f'<text x="{left:.2f}" y="{top - unit:.2f}" font-size="{unit * 3.4:.2f}" fill="#fff" '
        f'stroke="#222" stroke-width="{unit / 2:.2f}" paint-order="stroke" '
        f'font-family="Arial, sans-serif">{label}</text></g>'
    )


def grid(figures: Iterable[str], kind: str = "") -> str:
    """Lay figures out side by side; ``kind`` is a class of ``page.css``."""
    return f'<div class="grid {kind}">{"".join(figures)}</div>'


def table(headings: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a table; numbers are set right-aligned."""
    head = "".join(f"<th>{escape(heading)}</th>" for heading in headings)
    body = "".join(f"<tr>{''.join(_cell(value) for value in row)}</tr>" for row in rows)
    return f'<div class="scroll"><table><tr>{head}</tr>{body}</table></div>'


def _cell(value: object) -> str:
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return f'<td class="number">{number(value)}</td>'
    return f"<td>{escape(str(value))}</td>"


def number(value: float) -> str:
    """Write a number for people: three significant digits, integers whole, no exponent."""
    if value != value or value in (float("inf"), float("-inf")):
        return "–"
    if isinstance(value, int) or (value == int(value) and abs(value) < 1e6):
        return f"{int(value):,}".replace(",", "\u202f")
    size = abs(value)
    if size >= 1000:
        return f"{value:,.0f}".replace(",", "\u202f")
    decimals = 3 if size < 0.1 else 2 if size < 10 else 1
    return f"{value:.{decimals}f}" if size >= 0.001 else f"{value:.2g}"


def section(anchor: str, title: str, text: str, body: str) -> str:
    """Return a section with its heading and one paragraph for the reader."""
    return (
        f'<section id="{escape(anchor)}"><h2>{escape(title)}</h2><p>{escape(text)}</p>{body}'
        "</section>"
    )


def facts(pairs: Iterable[tuple[str, str]]) -> str:
    """Return the key figures under the title."""
    cells = "".join(f"<div><b>{escape(value)}</b>{escape(name)}</div>" for name, value in pairs)
    return f'<div class="facts">{cells}</div>'


def document(title: str, head: str, sections: Sequence[tuple[str, str, str]]) -> str:
    """Return the whole page; ``sections`` are (anchor, short title, html). No outside resources."""
    style = resources.files("pipeline.report").joinpath("page.css").read_text(encoding="utf-8")
    links = "".join(f'<a href="#{escape(a)}">{escape(short)}</a>' for a, short, _ in sections)
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        '<meta http-equiv="Content-Security-Policy" content="default-src \'none\'; '
        "img-src data:; style-src 'unsafe-inline'\">"
        f"<title>{escape(title)}</title><style>{style}</style></head><body>"
        f"<header><h1>{escape(title)}</h1>{head}<nav>{links}</nav></header>"
        f"<main>{''.join(body for _, _, body in sections)}"
        '<footer class="soft"><p>Made by Impasto. Every figure on this page was computed from the '
        "capture; nothing is loaded from elsewhere.</p></footer></main></body></html>\n"
    )
