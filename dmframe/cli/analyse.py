"""``dmframe analyse``: poles, margins, passivity, how slow the clock may be, the least K_c."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from typing import Any

from dmframe.analyse.linear import Linear
from dmframe.analyse.period import Bracket
from dmframe.analyse.servo import JointLoop
from dmframe.analyse.summary import NOTE, Analysis, analyse, summary
from dmframe.analyse.tie import TieGain
from dmframe.cli.show import columns
from dmframe.cli.streams import tell
from dmframe.config import Graph, load_graph
from dmframe.units import plain


def analyse_graph(name: str, overrides: Sequence[str], *, horizon: float, as_json: bool) -> None:
    """Analyse one graph and print it."""
    graph = load_graph(name, overrides)
    diagram = graph.diagram()
    found = analyse(
        diagram,
        graph.file.clock,
        solver=graph.solver,
        start=graph.start,
        horizon=horizon,
        uncertain=graph.intervals(diagram),
    )
    tell(json.dumps(summary(graph.name, found), indent=2) if as_json else page(graph, found))


def page(graph: Graph, found: Analysis) -> str:
    """An analysis for the terminal."""
    heads = ("joint", "M_jj", "B", "crossover", "phase margin", "gain margin", "passive alone", "with the inverse")
    parts = [
        f"{graph.name}: {graph.file.title}".rstrip(": "),
        "",
        "joint loops: servo, motor, diagonal of M and viscous friction at the set-point, other joints held",
        columns([heads, *(_row(joint) for joint in found.joints)]),
        "",
        "closed loop, linearised at the set-point, estimates at their true values",
        columns(_loop(found)),
        "",
        "largest stable sampling period",
        columns(_periods(found)),
        "",
        *_least_K_c(graph, found.ties),
        *(f"  {text}" for text in _wrapped(NOTE)),
    ]
    return "\n".join(parts)


def _row(joint: JointLoop) -> tuple[str, ...]:
    m = joint.margins
    return (
        joint.joint,
        f"{joint.inertia:.4g} kg m^2",
        f"{joint.viscous:.4g} N m s/rad",
        f"{m.gain_crossover:.4g} rad/s",
        f"{m.phase:.1f} deg",
        "infinite" if math.isinf(m.gain) else f"{m.gain:.3g}",
        "yes" if joint.passive_servo.holds else "no",
        "-" if joint.passive_port is None else "yes" if joint.passive_port.holds else "no",
    )


def _loop(found: Analysis) -> Iterator[tuple[str, ...]]:
    at_rest, moving = found.at_rest, found.moving
    yield "", "at rest", "moving (no slope of Coulomb friction)"
    yield "slowest pole", _pole(at_rest, 0), _pole(moving, 0)
    yield "fastest pole", _pole(at_rest, -1), _pole(moving, -1)
    yield "poles at zero, where the loop rests anywhere", str(at_rest.at_rest), str(moving.at_rest)
    if found.clock is not None:
        radii = (f"{linear.spectral_radius(found.clock):.6f}" for linear in (at_rest, moving))
        yield f"spectral radius at {plain(found.clock, 's')}", *radii


def _pole(linear: Linear, place: int) -> str:
    pole = linear.pole(place)
    if pole is None:
        return "none"
    return f"{pole.real:.4g}" + (f" +- {abs(pole.imag):.4g}j" if pole.imag else "") + " 1/s"


def _periods(found: Analysis) -> Iterator[tuple[str, str]]:
    periods = found.periods
    for name, bracket in (("linearised, at rest", periods.at_rest), ("linearised, moving", periods.moving)):
        yield name, _bracket(bracket)
    yield "simulated", _bracket(periods.simulated)
    yield "", periods.simulated.meaning


def _least_K_c(graph: Graph, ties: Sequence[TieGain]) -> Iterator[str]:
    if ties:
        over = "the intervals of uncertain:" if graph.file.uncertain else "the graph's own servo gains"
        yield f"K_c of the PID inverse [1/s]: the least that makes M̄ ≥ 0 over {over}, rounded upwards"
        heads = ("joint", "K_c of the graph", "least K_c", "least without friction")
        yield columns([heads, *(_tie(tie) for tie in ties)])
        yield ""


def _tie(tie: TieGain) -> tuple[str, ...]:
    own = f"{float(tie.own):.6g}" + ("" if tie.holds else ", too small")
    return tie.joint, own, f"{float(tie.least):g}", f"{float(tie.least_without_friction):g}"


def _bracket(bracket: Bracket) -> str:
    if bracket.stable == 0:
        return f"none; unstable at {_time(bracket.unstable)}"
    if math.isinf(bracket.unstable):
        return f"above {_time(bracket.stable)}, the longest looked at"
    stable, unstable = _time(bracket.stable), _time(bracket.unstable)
    return stable if stable == unstable else f"between {stable} and {unstable}"


def _time(value: float) -> str:
    return plain(value, "s", 5)


def _wrapped(text: str) -> Any:
    import textwrap

    return textwrap.wrap(text, 110)
