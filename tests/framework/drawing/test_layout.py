from __future__ import annotations

import random
from functools import cache
from itertools import combinations

import pytest

from dmframe.block.port import Side
from dmframe.drawing.layout import lay_out, segments
from dmframe.drawing.netlist import Box, Netlist, Pin, columns


def random_netlist(seed: int) -> Netlist:
    """Any wires between any blocks, feedback and self-loops included, with and without a plant."""
    rng = random.Random(seed)
    count = rng.randint(1, 11)
    sides = [rng.choice((Side.SOURCE, Side.CONTROLLER, Side.CONTROLLER, Side.PLANT)) for _ in range(count)]
    names = [f"block{i}" for i in range(count)]
    outputs = {name: [f"{name}_y{j}" for j in range(rng.randint(0, 3))] for name in names}
    every = [(name, port) for name in names for port in outputs[name]]
    nets, inputs = {}, {name: [] for name in names}
    for name, side in zip(names, sides, strict=True):
        for j in range(0 if side is Side.SOURCE or not every else rng.randint(0, 5)):
            source = rng.choice(every)
            nets.setdefault(source, []).append((name, f"u{j}"))
            inputs[name].append(Pin(f"u{j}", source))
            if rng.random() < 0.2:
                inputs[name].append(Pin(f"du{j}", source, 1, f"u{j}"))
    boxes = {
        name: Box(
            name, "kind", side, ("a", "b_hat") * rng.randint(0, 3), tuple(inputs[name]),
            tuple(port for port in outputs[name] if (name, port) in nets),
        )
        for name, side in zip(names, sides, strict=True)
    }  # fmt: skip
    return Netlist(boxes, {end: tuple(targets) for end, targets in nets.items()})


each_netlist = pytest.mark.parametrize("seeds", [range(20), range(20, 60)], ids=str)


@cache
def laid_out(seed: int):
    return lay_out(random_netlist(seed))


def overlap(one, other):
    """The common length of two collinear pieces."""
    ((a, b), (c, d)), ((e, f), (g, h)) = one, other
    if b == d == f == h:
        return min(max(a, c), max(e, g)) - max(min(a, c), min(e, g))
    if a == c == e == g:
        return min(max(b, d), max(f, h)) - max(min(b, d), min(f, h))
    return -1.0


def crosses(piece, item):
    (a, b), (c, d) = piece
    inner = 0.01
    return (
        max(a, c) > item.x + inner
        and min(a, c) < item.x + item.width - inner
        and max(b, d) > item.y + inner
        and min(b, d) < item.y + item.height - inner
    )


@each_netlist
def test_wires_cross_no_box_and_lie_on_no_other_wire(seeds):
    for seed in seeds:
        layout = laid_out(seed)
        pieces = list(segments(layout))
        for end, begin, finish in pieces:
            assert begin[0] == finish[0] or begin[1] == finish[1], seed
            assert not any(crosses((begin, finish), item) for item in layout.placed.values()), (seed, end)
        for (one, *first), (other, *second) in combinations(pieces, 2):
            assert one == other or overlap(first, second) <= 0, (seed, one, other)


@each_netlist
def test_boxes_do_not_overlap_and_every_net_is_in_one_piece(seeds):
    for seed in seeds:
        check_boxes_and_nets(laid_out(seed), seed)


def check_boxes_and_nets(layout, seed):
    for one, other in combinations(layout.placed.values(), 2):
        apart = one.x + one.width <= other.x or other.x + other.width <= one.x
        assert apart or one.y + one.height <= other.y or other.y + other.height <= one.y, seed
    for end, targets in layout.net.nets.items():
        pieces = [(begin, finish) for name, begin, finish in segments(layout) if name == end]
        source = layout.placed[end[0]]
        reached = {(source.x + source.width, source.output_y(end[1]))}
        for _ in pieces:
            for begin, finish in pieces:
                if any(on(point, (begin, finish)) for point in reached) or any(
                    on(p, other) for p in (begin, finish) for other in pieces if reached & set(other)
                ):
                    reached |= {begin, finish}
        for target, pin in targets:
            item = layout.placed[target]
            assert (item.x, item.input_y(pin)) in reached, (seed, target)


def on(point, piece):
    (x, y), ((a, b), (c, d)) = point, piece
    return min(a, c) <= x <= max(a, c) and min(b, d) <= y <= max(b, d)


@each_netlist
def test_the_plant_is_right_of_the_wall_and_the_rest_left_of_it(seeds):
    for seed in seeds:
        layout = laid_out(seed)
        sides = {item.box.side is Side.PLANT for item in layout.placed.values()}
        assert (layout.wall is not None) == (sides == {True, False}), seed
        for item in layout.placed.values():
            if layout.wall is not None:
                assert (item.x > layout.wall) == (item.box.side is Side.PLANT), seed


def test_signals_flow_from_left_to_right_and_feedback_is_reported_separately():
    def box(name, *inputs, side=Side.CONTROLLER):
        return Box(name, "kind", side, (), tuple(Pin(f"{s}_out", (s, "y")) for s in inputs), ("y",))

    net = Netlist(
        {
            "observer": box("observer", "generator"),
            "generator": box("generator", "path", "observer"),
            "path": box("path", side=Side.SOURCE),
            "inverse": box("inverse", "generator"),
            "arm": box("arm", "servo", side=Side.PLANT),
            "servo": box("servo", "inverse", "arm", side=Side.PLANT),
        },
        {
            ("path", "y"): (("generator", "path_out"),),
            ("observer", "y"): (("generator", "observer_out"),),
            ("generator", "y"): (("observer", "generator_out"), ("inverse", "generator_out")),
            ("inverse", "y"): (("servo", "inverse_out"),),
            ("servo", "y"): (("arm", "servo_out"),),
            ("arm", "y"): (("servo", "arm_out"),),
        },
    )
    order = columns(net)
    place = {name: index for index, names in enumerate(order) for name in names}
    assert place["path"] < place["generator"] < place["inverse"] < place["servo"] < place["arm"]
