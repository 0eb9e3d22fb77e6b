"""Rivals of a live page: controllers simulated next to the graph's own, on the same robot and path."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

from dmframe.common.errors import ValueFault
from dmframe.config import BaseGraph
from dmframe.diagram import Diagram
from dmframe.diagram.closed_loop import Parameter


@final
@dataclass(frozen=True)
class Rival:
    """A graph whose loop a page simulates next to its own.

    Parameters
    ----------
    graph
        It must have the joints and the error of the page's graph.
    title
        Its name on the page.
    ghost
        Draw its tool and its error; otherwise only its error is printed.
    note
        A sentence next to its error.
    """

    graph: BaseGraph
    title: str
    ghost: bool = False
    note: str = ""


def rivals_of(graph: BaseGraph) -> list[Rival]:
    """Rivals in the graph's key ``page.rivals``."""
    rivals = graph.file.page.rivals
    return [Rival(graph.rival(name), item.title, item.ghost, item.note) for name, item in rivals.items()]


def ghosts_of(graph: BaseGraph, other: BaseGraph | None) -> tuple[Rival, ...] | None:
    """Another graph as a ghost, with its name as title; that of the graph's own baseline is ``baseline``.

    None without another graph. Raises the errors of `check_rival`.
    """
    if other is None:
        return None
    own = other.swapped is not None and other.document.name == graph.document.name
    rival = Rival(other, "baseline" if own else other.name, ghost=True)
    check_rival(graph, rival)
    return (rival,)


def check_rival(mine: BaseGraph, rival: Rival) -> None:
    """Raise `ValueFault` for a rival with other joints or another error than the graph."""
    other = rival.graph
    joints = [() if each.robot is None else tuple(each.robot.joint_names) for each in (mine, other)]
    if joints[0] != joints[1]:
        raise ValueFault(
            f"{other.name}: expected the joints of {mine.name}, {_listed(joints[0])}, found {_listed(joints[1])}"
        )
    errors = [_error(each.diagram) for each in (mine, other)]
    if errors[0] != errors[1] or errors[0] is None:
        shown = ["none" if error is None else f"{error[0]} in {error[1]}" for error in errors]
        raise ValueFault(f"{other.name}: expected the error of {mine.name}, elements {shown[0]}, found {shown[1]}")


def _error(diagram: Diagram) -> tuple[int, str] | None:
    """Number of elements and unit of the tracking error."""
    from dmframe.results.metrics import goal_of

    followed = goal_of(diagram.loop)
    if followed is None:
        return None
    unit = next(signal.unit for signal in diagram.loop.outputs if signal.label == followed.actual)
    return followed.wanted.numel(), unit


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names) or "none"


def shared_parameters(mine: BaseGraph, other: BaseGraph) -> list[tuple[int, int, int]]:
    """First element in p of each graph and size of the parameters that change in both.

    These are the parameters of blocks that are equal in both graphs, such as robot, servo and path, and of the robot.
    """
    places, found, at = dict[str, tuple[int, Parameter]](), list[tuple[int, int, int]](), 0
    for parameter in mine.diagram.loop.parameters:
        places[parameter.label] = (at, parameter)
        at += parameter.symbol.numel()
    at = 0
    for parameter in other.diagram.loop.parameters:
        size, label = parameter.symbol.numel(), parameter.label
        if label in places and places[label][1].symbol.numel() == size and _same(mine, other, label):
            found.append((places[label][0], at, size))
        at += size
    return found


def _same(mine: BaseGraph, other: BaseGraph, label: str) -> bool:
    block = label.partition(".")[0]
    if block == "robot":
        return True
    blocks = (mine.diagram.blocks.get(block), other.diagram.blocks.get(block))
    return blocks[0] is not None and blocks[0] == blocks[1]
