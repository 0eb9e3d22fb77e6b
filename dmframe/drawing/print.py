"""PNG and PDF of a diagram: matplotlib draws the elements of its SVG.

It supports only the SVG of `dmframe.drawing.picture`.
"""

from __future__ import annotations

import io
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from typing import Any, Final

_INCH: Final = 96.0
"""CSS pixels per inch."""

_SPACE: Final = "{http://www.w3.org/2000/svg}"
_DARK: Final = "#111111"
_RECTANGLES: Final[dict[str, dict[str, Any]]] = {
    "box": {"facecolor": "white", "edgecolor": _DARK, "linewidth": 1.4},
    "mark": {"facecolor": "white", "edgecolor": _DARK, "linewidth": 0.9},
    "ground": {"facecolor": "#f3f3f3", "edgecolor": "none"},
    "": {"facecolor": "white", "edgecolor": "none"},
}
_TEXTS: Final[dict[str, dict[str, Any]]] = {
    "title": {"fontsize": 16, "weight": "bold"},
    "name": {"fontsize": 13, "weight": "bold", "ha": "center"},
    "kind": {"style": "italic", "color": "#333333", "ha": "center"},
    "states": {"fontsize": 10, "color": "#444444", "ha": "center"},
    "region": {"fontsize": 12, "color": "#444444"},
    "label": {"style": "italic"},
    "middle": {"ha": "center"},
    "small": {"fontsize": 9.5, "ha": "center"},
}
_NARROW: Final = 0.92
"""Font scaling: boxes fit Helvetica, and matplotlib's DejaVu Sans is wider."""
_ANCHORS: Final = {"end": "right", "middle": "center"}


def printed(svg: str, kind: str, dpi: float = 200) -> bytes:
    """Picture as ``png`` or ``pdf``."""
    from dmframe.common.plotting import new_figure, styled

    root = ET.fromstring(svg)
    wide, high = float(root.get("width", 0)), float(root.get("height", 0))
    with styled():
        figure = new_figure(wide / _INCH, high / _INCH)
        figure.set_layout_engine("none")
        axes = figure.add_axes((0, 0, 1, 1))
        axes.set_axis_off()
        axes.set_xlim(0, wide)
        axes.set_ylim(high, 0)
        for place, (element, shift) in enumerate(_elements(root, 0.0)):
            _draw(axes, element, shift, place)
        buffer = io.BytesIO()
        figure.savefig(buffer, format=kind, dpi=dpi, metadata={"CreationDate": None} if kind == "pdf" else None)
    return buffer.getvalue()


def _elements(element: Any, shift: float) -> Iterator[tuple[Any, float]]:
    """Elements from the back to the front, with their vertical shift."""
    moved = re.match(r"translate\(0 ([-\d.]+)\)", element.get("transform", ""))
    shift += float(moved[1]) if moved else 0.0
    for child in element:
        if child.tag == f"{_SPACE}g":
            yield from _elements(child, shift)
        else:
            yield child, shift


def _draw(axes: Any, element: Any, shift: float, order: int) -> None:
    match element.tag.removeprefix(_SPACE):
        case "rect":
            _rectangle(axes, element, shift, order)
        case "line":
            ends = [float(element.get(key)) for key in ("x1", "x2", "y1", "y2")]
            down = [y + shift for y in ends[2:]]
            axes.plot(ends[:2], down, color=_DARK, lw=_points(2.2), dashes=(4, 2.3), zorder=order)
        case "circle":
            from matplotlib.patches import Circle

            x, y, radius = (float(element.get(key)) for key in ("cx", "cy", "r"))
            axes.add_patch(Circle((x, y + shift), radius, color=_DARK, zorder=order))
        case "path":
            _path(axes, element, shift, order)
        case "text":
            _text(axes, element, shift, order)


def _points(pixels: float) -> float:
    return pixels * 72 / _INCH


def _rectangle(axes: Any, element: Any, shift: float, order: int) -> None:
    from matplotlib.patches import FancyBboxPatch, Rectangle

    x, y, wide, high = (_length(axes, element, key) for key in ("x", "y", "width", "height"))
    look = dict(_RECTANGLES[element.get("class", "")])
    look["linewidth"] = _points(look.get("linewidth", 0))
    round_ = float(element.get("rx", 0))
    if round_:
        style = f"round,pad=0,rounding_size={min(round_, high / 2)}"
        axes.add_patch(FancyBboxPatch((x, y + shift), wide, high, boxstyle=style, zorder=order, **look))
    else:
        axes.add_patch(Rectangle((x, y + shift), wide, high, zorder=order, **look))


def _length(axes: Any, element: Any, key: str) -> float:
    """A length; 100% is the size of the picture."""
    text = element.get(key, "0")
    if text.endswith("%"):
        return float(axes.get_xlim()[1] if key == "width" else axes.get_ylim()[0])
    return float(text)


def _path(axes: Any, element: Any, shift: float, order: int) -> None:
    """Straight segments, repeated ``M x y L x y``, or an arrow head ``M x y l x y v y z``."""
    text = element.get("d")
    arrow = re.fullmatch(r"M(\S+) (\S+)l(\S+) (\S+)v(\S+)z", text)
    if arrow:
        from matplotlib.patches import Polygon

        x, y, dx, dy, v = map(float, arrow.groups())
        corners = [(x, y), (x + dx, y + dy), (x + dx, y + dy + v)]
        axes.add_patch(Polygon([(a, b + shift) for a, b in corners], color=_DARK, linewidth=0, zorder=order))
        return
    for piece in text.split("M")[1:]:
        points = [tuple(map(float, point.split())) for point in piece.split("L")]
        axes.plot([x for x, _ in points], [y + shift for _, y in points], color=_DARK, lw=_points(1.1), zorder=order,
                  solid_capstyle="round")  # fmt: skip


def _with_indices(element: Any) -> str:
    """Text of an element; indices as mathematical text of matplotlib."""
    pieces = [element.text or ""]
    for span in element:
        word = (span.text or "").replace("\u200b", "")
        index = span.get("class") == "sub"
        pieces += [rf"$_{{\mathrm{{{word}}}}}$" if index else word, span.tail or ""]
    return "".join(pieces)


def _text(axes: Any, element: Any, shift: float, order: int) -> None:
    look: dict[str, Any] = {"fontsize": 11, "color": _DARK}
    for word in element.get("class", "").split():
        look |= _TEXTS.get(word, {})
    look["ha"] = _ANCHORS.get(element.get("text-anchor", ""), look.get("ha", "left"))
    look["fontsize"] = _points(look["fontsize"]) * _NARROW
    text = _with_indices(element)
    drawn = axes.text(
        float(element.get("x")), float(element.get("y")) + shift, text, va="baseline", zorder=order,
        parse_math="$" in text, **look,
    )  # fmt: skip
    if "label" in element.get("class", "").split():
        from matplotlib.patheffects import withStroke

        drawn.set_path_effects([withStroke(linewidth=_points(3), foreground="white")])
