"""SVG picture of a diagram, in the usual layout of control engineering."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from xml.sax.saxutils import escape, quoteattr

from dmframe.block.port import Side
from dmframe.common.names import unicode_name
from dmframe.diagram.wiring import End
from dmframe.drawing.layout import MARGIN, Layout, Placed, lay_out, segments
from dmframe.drawing.netlist import Wired, netlist

_STYLE = """
text { font-family: system-ui, 'Segoe UI', Roboto, 'Noto Sans', 'Liberation Sans', sans-serif }
text { fill: #1c2326; font-size: 11px }
.title { font-size: 16px; font-weight: bold }
.name { font-size: 13px; font-weight: bold; text-anchor: middle }
.kind { font-style: italic; fill: #333; text-anchor: middle }
.states { font-size: 10px; fill: #444; text-anchor: middle }
.region { fill: #444; font-size: 12px; letter-spacing: 0.06em }
.label { font-style: italic; paint-order: stroke; stroke: #fff; stroke-width: 3px; stroke-linejoin: round }
.middle { text-anchor: middle }
.box { fill: #fff; stroke: #111; stroke-width: 1.4 }
.ground { fill: #f3f3f3 }
.wire { fill: none; stroke: #111; stroke-width: 1.1 }
.wall { stroke: #111; stroke-width: 2.2; stroke-dasharray: 9 5 }
.mark { fill: #fff; stroke: #111; stroke-width: 0.9 }
.small { font-size: 9.5px; text-anchor: middle }
.sub { font-size: 0.78em; font-style: normal }
"""
_INDEXED = re.compile(r"(?<![\w\u0300-\u036f])([^\W\d_]{1,2}[\u0300-\u036f]*)_(\w[\w\u0300-\u036f]*)")
"""A symbol of one or two letters, perhaps with an accent, and its index: q_ref, w_P, mc_x2."""
_LOWER = 2.5
"""Shift of an index below its line [pixels]."""
_HEAD, _FOOT = 62.0, 34.0
_CONTROLLER, _PLANT = "controller", "robot and servo"


def svg(diagram: Wired, title: str = "") -> str:
    """SVG of a diagram.

    From left to right: sources, controller, the boundary of the closed architecture, and plant. Commands cross the
    boundary forward; measurements return below. An input that is the derivative of another one is marked d/dt.
    """
    layout = lay_out(netlist(diagram))
    shift = _HEAD - layout.top
    width = max(layout.width, 360.0, 9.6 * len(title) + 2 * MARGIN)
    height = layout.bottom + shift + _FOOT
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" width="{width:g}" '
        f'height="{height:g}" role="img">',
        f"<title>{escape(title or 'block diagram')}</title>",
        f"<style>{_STYLE}</style>",
        f'<rect width="{width:g}" height="{height:g}" fill="#fff"/>',
        *_ground(layout, width, height),
        _text(MARGIN, 22, title, "title") if title else "",
        f'<g transform="translate(0 {shift:g})">',
        *_wires(layout, diagram),
        *(line for item in layout.placed.values() for line in _box(item)),
        *(line for item in layout.placed.values() for line in _marks(item)),
        *_boundary_arrows(layout),
        *_labels(layout),
        "</g>",
        "</svg>",
    ]
    return "\n".join(part for part in parts if part) + "\n"


def _ground(layout: Layout, width: float, height: float) -> Iterator[str]:
    """Background: the plant's region, and the boundary with its labels."""
    if layout.wall is None:
        return
    x, top, bottom = layout.wall, 34.0, height - 10
    yield f'<rect class="ground" x="{x:g}" y="{top:g}" width="{width - x - 8:g}" height="{bottom - top:g}" rx="4"/>'
    yield f'<line class="wall" x1="{x:g}" y1="{top:g}" x2="{x:g}" y2="{bottom:g}"/>'
    yield _text(x - 12, 48, _CONTROLLER, "region", "end")
    yield _text(x + 12, 48, _PLANT, "region")
    yield _text(x + 12, bottom - 3, "closed architecture", "region")


def _wires(layout: Layout, diagram: Wired) -> Iterator[str]:
    """Nets as groups, with arrows at inputs and dots at branches."""
    pieces = dict[End, list[tuple[tuple[float, float], tuple[float, float]]]]()
    for end, begin, finish in segments(layout):
        pieces.setdefault(end, []).append((begin, finish))
    for end, lines in pieces.items():
        targets = [f"{block}.{port}" for block, port in layout.net.nets[end]]
        unit = next(port.unit for port in diagram.blocks[end[0]].outputs if port.name == end[1])
        about = f"{end[0]}.{end[1]} -> {', '.join(targets)}" + (f" [{unit}]" if unit else "")
        yield f'<g class="net"><title>{escape(about)}</title>'
        path = " ".join(f"M{a:g} {b:g}L{c:g} {d:g}" for (a, b), (c, d) in lines)
        yield f'<path class="wire" d="{path}"/>'
        for block, port in layout.net.nets[end]:
            item = layout.placed[block]
            yield _arrow(item.x, item.input_y(port), 1)
        for x, y in _branches(lines):
            yield f'<circle cx="{x:g}" cy="{y:g}" r="2.4" fill="#111"/>'
        yield "</g>"


def _branches(lines: list[tuple[tuple[float, float], tuple[float, float]]]) -> list[tuple[float, float]]:
    """Points where three or four segments of a net meet."""
    directions = Counter[tuple[float, float]]()
    points = {point for line in lines for point in line}
    for x, y in points:
        for (a, b), (c, d) in lines:
            inside = (a == c == x and min(b, d) < y < max(b, d)) or (b == d == y and min(a, c) < x < max(a, c))
            directions[x, y] += 2 if inside else (x, y) in ((a, b), (c, d))
    return sorted(point for point, count in directions.items() if count >= 3)


def _box(item: Placed) -> Iterator[str]:
    box, middle = item.box, item.x + item.width / 2
    radius = 18 if box.side is Side.SOURCE else 6
    yield f'<g class="block" data-name={quoteattr(box.name)}>'
    yield (
        f'<rect class="box" x="{item.x:g}" y="{item.y:g}" width="{item.width:g}" '
        f'height="{item.height:g}" rx="{radius}"/>'
    )
    yield _text(middle, item.y + 18, box.name, "name")
    yield _text(middle, item.y + 33, box.kind, "kind")
    for pin, height in item.inputs.items():
        yield _text(item.x + 7, item.y + height + 4, unicode_name(pin), "pin", symbols=True)
    first = item.y + item.height - 6 - 13 * (len(item.states) - 1)
    for index, line in enumerate(item.states):
        yield _text(middle, first + 13 * index, line, "states", symbols=True)
    yield "</g>"


def _marks(item: Placed) -> Iterator[str]:
    """d/dt in front of each derived input, connected to the wire that it differentiates."""
    for pin in item.box.inputs:
        if not pin.order:
            continue
        y, origin, branch = item.input_y(pin.name), item.input_y(pin.root), item.x - 46
        yield f'<circle cx="{branch:g}" cy="{origin:g}" r="2.4" fill="#111"/>'
        yield f'<path class="wire" d="M{branch:g} {origin:g}L{branch:g} {y:g}L{item.x:g} {y:g}"/>'
        yield f'<rect class="mark" x="{item.x - 40:g}" y="{y - 7:g}" width="28" height="14" rx="3"/>'
        yield _text(
            item.x - 26, y + 3.5, "d/dt" if pin.order == 1 else f"d{_raised(pin.order)}/dt{_raised(pin.order)}", "small"
        )
        yield _arrow(item.x, y, 1)


def _raised(number: int) -> str:
    return str(number).translate(str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹"))


def _boundary_arrows(layout: Layout) -> Iterator[str]:
    """Arrows where signals cross the boundary."""
    if layout.wall is None:
        return
    for _, (x, y), (end, other) in segments(layout):
        if y == other and min(x, end) < layout.wall < max(x, end):
            # only lower bypasses carry feedback
            back = any(height == y and key[1] == "bottom" for key, (height, _, _) in layout.bypasses.items())
            yield _arrow(layout.wall + (-14 if back else 14), y, -1 if back else 1)


def _labels(layout: Layout) -> Iterator[str]:
    """Signal names at outputs, and on bypasses."""
    for item in layout.placed.values():
        for port in item.outputs:
            yield _text(item.x + item.width + 5, item.output_y(port) - 4, unicode_name(port), "label", symbols=True)
    for (end, direction), (height, first, last) in layout.bypasses.items():
        source = layout.placed[end[0]].column
        under = {source + 1 if direction == "top" else source}
        if layout.wall is not None:
            under |= {i for i in range(first, last) if _last_before(layout, i)}
        for index in sorted(under):
            left, right = layout.spans[index]
            yield _text((left + right) / 2, height - 4, unicode_name(end[1]), "label middle", symbols=True)


def _last_before(layout: Layout, index: int) -> bool:
    """True for the column left of the boundary."""
    assert layout.wall is not None
    after = layout.spans[index + 1][0] if index + 1 < len(layout.spans) else float("inf")
    return layout.spans[index][1] < layout.wall < after


def _arrow(x: float, y: float, direction: int) -> str:
    return f'<path d="M{x:g} {y:g}l{-8 * direction} -3.4v6.8z" fill="#111"/>'


def _text(x: float, y: float, text: str, kind: str, anchor: str = "", *, symbols: bool = False) -> str:
    """A text; the indices of `symbols` are subscripts."""
    placed = f' text-anchor="{anchor}"' if anchor else ""
    shown = _INDEXED.sub(_subscript, escape(text)) if symbols else escape(text)
    return f'<text class="{kind}" x="{x:g}" y="{y:g}"{placed}>{shown}</text>'


def _subscript(found: re.Match[str]) -> str:
    """A subscript, and after it the former line for what follows."""
    index = found[2].replace("_", ",")
    return f'{found[1]}<tspan class="sub" dy="{_LOWER}">{index}</tspan><tspan dy="-{_LOWER}">\u200b</tspan>'
