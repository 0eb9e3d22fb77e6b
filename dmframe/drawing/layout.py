"""Layout of a block diagram: boxes in columns, wires in the channels between them and in bypasses above and below.

A wire to the next column runs through the channel between the columns; a wire that skips columns runs through a bypass
above all boxes, feedback through a bypass below. No wire crosses a box, and wires do not overlap.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from statistics import median_low
from typing import final

from dmframe.block.port import Side
from dmframe.diagram.wiring import End
from dmframe.drawing.netlist import Box, Netlist, Pin, columns

PITCH, TRACK, BYPASS = 18.0, 10.0, 17.0
GRID = PITCH / 2
HEADER, STATE_LINE, GAP, MARGIN = 42.0, 13.0, 26.0, 16.0
ARROW, MARK, WALL = 11.0, 40.0, 30.0
CLEAR, COVERED = 4.0, 1000
"""Smallest distance of stubs of two nets, and the cost of a smaller one relative to a crossing."""
LETTER = 0.57
"""Width of a letter relative to its size, of a wide sans-serif font, so that other fonts fit."""


def wide(text: str, size: float) -> float:
    """Approximate width of a text."""
    return LETTER * size * len(text)


@final
@dataclass
class Placed:
    """A box with its position; `inputs` and `outputs` are the distances of the pins from the box's top."""

    box: Box
    column: int
    states: list[str]
    inputs: dict[str, float]
    outputs: dict[str, float]
    width: float
    height: float
    x: float = 0.0
    y: float = 0.0

    def input_y(self, pin: str) -> float:
        """Vertical position of an input."""
        return self.y + self.inputs[pin]

    def output_y(self, port: str) -> float:
        """Vertical position of an output."""
        return self.y + self.outputs[port]


@final
@dataclass
class Trunk:
    """Vertical segment of a net in one channel: the positions that it joins, with stubs on the left and the right."""

    net: End
    left: set[float] = field(default_factory=set)
    right: set[float] = field(default_factory=set)
    x: float = 0.0

    @property
    def heights(self) -> set[float]:
        """All positions that it joins."""
        return self.left | self.right


@final
@dataclass(frozen=True)
class Layout:
    """Geometry of a picture; `bypasses` are (height, first channel, last channel) by net and side."""

    net: Netlist
    placed: Mapping[str, Placed]
    channels: tuple[Mapping[End, Trunk], ...]
    bypasses: Mapping[tuple[End, str], tuple[float, int, int]]
    spans: tuple[tuple[float, float], ...]
    """Left and right edges of the columns."""
    wall: float | None
    width: float
    top: float
    bottom: float


def lay_out(net: Netlist) -> Layout:
    """Geometry of a picture, with the upper edge of the boxes near y = 0."""
    order = columns(net)
    column = {name: index for index, names in enumerate(order) for name in names}
    placed = {name: _sized(net, net.boxes[name], column) for names in order for name in names}
    _set_heights(net, order, placed)
    _separate(net, order, placed)
    top = min((item.y for item in placed.values()), default=0.0)
    bottom = max((item.y + item.height for item in placed.values()), default=0.0)
    bypasses = _bypasses(net, column, top, bottom)
    channels = _trunks(net, placed, bypasses, len(order))
    first = next((i for i, names in enumerate(order) if net.boxes[names[0]].side is Side.PLANT), None)
    wall_at = first if first else None  # no wall without a controller
    spans, wall, width = _set_widths(order, placed, channels, wall_at)
    heights = [height for height, _, _ in bypasses.values()]
    return Layout(
        net, placed, channels, bypasses, spans, wall, width, min([top, *heights]), max([bottom, *heights])
    )  # fmt: skip


def route(column: Mapping[str, int], source: str, target: str) -> str:
    """Route of a wire: ``direct`` to the next column, else by the ``top`` or the ``bottom`` bypass."""
    step = column[target] - column[source]
    return "direct" if step == 1 else "top" if step > 1 else "bottom"


def _sized(net: Netlist, box: Box, column: Mapping[str, int]) -> Placed:
    """Size of a box, with its pins in the order of their wires: from above, from the left, from below."""
    arrival = {"top": 0, "direct": 1, "bottom": 2}
    wired = sorted(
        (pin for pin in box.inputs if not pin.order), key=lambda pin: arrival[route(column, pin.source[0], box.name)]
    )
    pins = list[Pin]()
    for pin in wired:
        pins += [pin, *(other for other in box.inputs if other.order and other.root == pin.name)]

    def height_of(port: str) -> float:
        heights = [arrival[route(column, box.name, target)] for target, _ in net.nets[box.name, port]]
        return sum(heights) / len(heights)

    ports = sorted(box.outputs, key=height_of)
    inner = max([wide(box.name, 13) * 1.08, wide(box.kind, 11), 76.0])
    width = max(inner, max((wide(pin.name, 11) for pin in pins), default=0.0) + 30) + 14
    states = _wrapped(box.states, width - 8)
    rows = max(len(pins), len(ports))
    return Placed(
        box=box,
        column=column[box.name],
        states=states,
        inputs={pin.name: HEADER + PITCH * (i + 0.5) for i, pin in enumerate(pins)},
        outputs={port: HEADER + PITCH * (i + 0.5) for i, port in enumerate(ports)},
        width=width,
        height=HEADER + PITCH * rows + (STATE_LINE * len(states) + 4 if states else 4),
    )


def _wrapped(states: tuple[str, ...], width: float) -> list[str]:
    """Break states into lines."""
    lines = list[str]()
    for index, name in enumerate(states):
        word = name + ("," if index < len(states) - 1 else "")
        if lines and wide(f"{lines[-1]} {word}", 10) <= width:
            lines[-1] += f" {word}"
        else:
            lines.append(word if lines else f"states: {word}" if wide(f"states: {word}", 10) <= width else word)
    return lines


def _set_heights(net: Netlist, order: list[list[str]], placed: dict[str, Placed]) -> None:
    """Place the boxes of each column so that direct wires are as straight as possible."""
    direct = [
        (source, target)
        for source, targets in net.nets.items()
        for target in targets
        if placed[target[0]].column == placed[source[0]].column + 1
    ]
    for names in order:
        preferred = dict[str, float]()
        for name in names:
            aims = [placed[s].output_y(port) - placed[t].inputs[pin] for (s, port), (t, pin) in direct if t == name]
            preferred[name] = median_low(aims) if aims else 0.0
        _stack(names, placed, preferred)
    for names in reversed(order):  # boxes without a direct input are aligned with their outputs
        preferred = {}
        for name in names:
            aims = [placed[t].input_y(pin) - placed[s].outputs[port] for (s, port), (t, pin) in direct if s == name]
            has_source = any(t == name for _, (t, _) in direct)
            preferred[name] = median_low(aims) if aims and not has_source else placed[name].y
        _stack(names, placed, preferred)


def _stack(names: list[str], placed: dict[str, Placed], preferred: Mapping[str, float]) -> None:
    """Place the tops at the preferred heights, and move overlapping boxes apart, evenly up and down."""
    below = float("-inf")
    for name in names:
        placed[name].y = max(preferred[name], below)
        below = placed[name].y + placed[name].height + GAP
    pushed = sum(placed[name].y - preferred[name] for name in names) / len(names)
    for name in names:
        # on a grid, so that a wire is straight or has a visible step
        placed[name].y = round((placed[name].y - pushed) / GRID) * GRID


def _bypasses(
    net: Netlist, column: Mapping[str, int], top: float, bottom: float
) -> dict[tuple[End, str], tuple[float, int, int]]:
    """Assign a bypass to each net that needs one, short ones next to the boxes; channel c is left of column c."""
    found = dict[tuple[End, str], tuple[int, int]]()
    for end, targets in net.nets.items():
        for side in ("top", "bottom"):
            ends = [column[target] for target, _ in targets if route(column, end[0], target) == side]
            if ends:
                reach = [column[end[0]] + 1, *ends]
                found[end, side] = (min(reach), max(reach))
    bypasses = dict[tuple[End, str], tuple[float, int, int]]()
    for side, sign, edge in (("top", -1.0, top), ("bottom", 1.0, bottom)):
        keys = [key for key in found if key[1] == side]
        keys.sort(key=lambda key: found[key][1] - found[key][0])
        for index, key in enumerate(keys):
            bypasses[key] = (edge + sign * (22.0 + BYPASS * index), *found[key])
    return bypasses


def _trunks(
    net: Netlist,
    placed: Mapping[str, Placed],
    bypasses: Mapping[tuple[End, str], tuple[float, int, int]],
    count: int,
) -> tuple[dict[End, Trunk], ...]:
    """Vertical segments of each net in each channel, in the order of their tracks from left to right."""
    channels: list[dict[End, Trunk]] = [{} for _ in range(count + 1)]
    for end, targets in net.nets.items():
        start = placed[end[0]].column + 1
        channels[start].setdefault(end, Trunk(end)).left.add(placed[end[0]].output_y(end[1]))
        for target, pin in targets:
            trunk = channels[placed[target].column].setdefault(end, Trunk(end))
            trunk.right.add(placed[target].input_y(pin))
    for (end, _), (height, first, last) in bypasses.items():
        for index in range(first, last + 1):
            if end in channels[index]:
                if index > first:
                    channels[index][end].left.add(height)
                if index < last:
                    channels[index][end].right.add(height)
    return tuple(_tracked(channel) for channel in channels)


def _tracked(channel: dict[End, Trunk]) -> dict[End, Trunk]:
    """Order the tracks for few crossings and no overlapping stubs."""
    order = list[End]()
    for end in channel:
        choices = [[*order[:i], end, *order[i:]] for i in range(len(order) + 1)]
        order = min(choices, key=lambda choice: _crossings(choice, channel))
    for _ in range(2):
        for end in list(channel):
            rest = [other for other in order if other != end]
            choices = [[*rest[:i], end, *rest[i:]] for i in range(len(rest) + 1)]
            order = min([order, *choices], key=lambda choice: _crossings(choice, channel))
    return {end: channel[end] for end in order}


def _crossings(order: list[End], channel: Mapping[End, Trunk]) -> int:
    cost = 0
    for index, end in enumerate(order):
        for other in order[index + 1 :]:
            left, right = channel[end], channel[other]
            cost += sum(min(left.heights) <= y <= max(left.heights) for y in right.left)
            cost += sum(min(right.heights) <= y <= max(right.heights) for y in left.right)
            cost += COVERED * sum(abs(a - b) < CLEAR for a in right.left for b in left.right)
    return cost


def _separate(net: Netlist, order: list[list[str]], placed: dict[str, Placed]) -> None:
    """Shift a column slightly if no order of tracks separates the stubs on its left."""
    for index in range(1, len(order)):
        for shift in (0.0, GRID, -2 * GRID, 3 * GRID, -4 * GRID):  # cumulative, in both directions
            for name in order[index]:
                placed[name].y += shift
            channel = _trunks(net, placed, {}, len(order))[index]
            if _crossings(list(channel), channel) < COVERED:
                break


def _set_widths(
    order: list[list[str]],
    placed: Mapping[str, Placed],
    channels: tuple[dict[End, Trunk], ...],
    wall_at: int | None,
) -> tuple[tuple[tuple[float, float], ...], float | None, float]:
    """Set all x from left to right; return the columns' edges, the wall's x and the total width."""
    x, wall, spans = MARGIN, None, list[tuple[float, float]]()
    for index, channel in enumerate(channels):
        sources = order[index - 1] if index else []
        labels = [wide(port, 11) for name in sources for port in placed[name].outputs]
        x += max(labels, default=0.0) + (8 if labels else 0)
        trunks = [trunk for trunk in channel.values() if len(trunk.heights) > 1]
        here = [trunk for trunk in trunks if wall_at != index or trunk.net[0] in sources]
        x = _set_tracks(here, x)
        if wall_at == index:
            wall = x + WALL / 2
            x = _set_tracks([trunk for trunk in trunks if trunk not in here], x + WALL)
        if index == len(order):
            break
        marks = any(pin.order for name in order[index] for pin in placed[name].box.inputs)
        x += (MARK if marks else 0) + (ARROW if channel else 0)
        width = max(placed[name].width for name in order[index])
        for name in order[index]:
            placed[name].x, placed[name].width = x, width
        spans.append((x, x + width))
        x += width
    return tuple(spans), wall, x + MARGIN


def _set_tracks(trunks: list[Trunk], x: float) -> float:
    for index, trunk in enumerate(trunks):
        trunk.x = x + TRACK * index + 4
    return x + TRACK * len(trunks)


def segments(layout: Layout) -> Iterator[tuple[End, tuple[float, float], tuple[float, float]]]:
    """Straight segments of all nets, ``(net, from, to)``."""
    for index, channel in enumerate(layout.channels):
        for end, trunk in channel.items():
            if len(trunk.heights) > 1:
                yield end, (trunk.x, min(trunk.heights)), (trunk.x, max(trunk.heights))
            yield from _stubs(layout, index, end, trunk)
    for (end, _), (height, first, last) in layout.bypasses.items():
        yield end, (layout.channels[first][end].x, height), (layout.channels[last][end].x, height)


def _stubs(
    layout: Layout, index: int, end: End, trunk: Trunk
) -> Iterator[tuple[End, tuple[float, float], tuple[float, float]]]:
    source = layout.placed[end[0]]
    straight = len(trunk.heights) == 1
    edge = source.x + source.width
    if source.column + 1 == index:
        y = source.output_y(end[1])
        if not straight:
            yield end, (edge, y), (trunk.x, y)
    for target, pin in layout.net.nets[end]:
        item = layout.placed[target]
        if item.column == index:
            y = item.input_y(pin)
            yield end, (edge if straight else trunk.x, y), (item.x, y)
