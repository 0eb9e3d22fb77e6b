"""Equations of a planar arm, M, C, g and the regressor Y_d, printed from the simulated expressions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Final, final

from dmframe.regressor.readable import Factor, Style, Term, latex_name
from dmframe.regressor.typeset import MOST_JOINTS, Matrix, write_out
from dmframe.report.parts import Row
from dmframe.robot.chain import SerialChain

_MOMENT: Final = "mc_{"


@final
@dataclass(frozen=True)
class RobotModel:
    """Robot model in a report.

    Parameters
    ----------
    about
        Marked text: definitions of the symbols.
    rows
        The entries of M, C and g as equations.
    regressor
        One row a parameter: LaTeX name and column of Y_d, one entry a joint.
    """

    about: str
    rows: tuple[Row, ...]
    regressor: tuple[tuple[str, tuple[str, ...]], ...]


def robot_model(chain: SerialChain | None) -> RobotModel | None:
    """Equations of a planar arm with at most three joints; None for any other robot."""
    if chain is None or chain.n > MOST_JOINTS or chain.m > 2:
        return None
    written = write_out(chain)
    rows = [row for matrix in (written.M, written.C, written.g) for row in _entries(matrix)]
    columns = zip(written.Y_d.columns, zip(*_printed(written.Y_d), strict=True), strict=True)
    return RobotModel(
        about=_about(chain),
        rows=tuple(rows),
        regressor=tuple((_roman(latex_name(name)), column) for name, column in columns),
    )


def _printed(matrix: Matrix) -> list[tuple[str, ...]]:
    """Each entry as LaTeX, row by row."""
    return [tuple(_roman(_sum(terms)) for terms in row) for row in matrix.entries]


def _sum(terms: Sequence[Term]) -> str:
    """Sum that factors out terms with equal non-rate factors: -p_x2 mc_x2 s_2 (dq_1 + dq_2)."""
    style, groups = Style(latex=True), dict[tuple[tuple[str, ...], tuple[Factor, ...]], list[Term]]()
    for term in terms:
        still = tuple(name for name in term.symbols if not _is_rate(name))
        groups.setdefault((still, term.factors), []).append(term)
    pieces = list[str]()
    for (still, factors), alike in groups.items():
        if len(alike) == 1 or not (still or factors):
            pieces.append(style.sum(alike))
            continue
        sign = Fraction(-1 if all(term.value < 0 for term in alike) else 1)
        rates = [Term(term.value * sign, tuple(filter(_is_rate, term.symbols)), ()) for term in alike]
        pieces.append(f"{style.sum([Term(sign, still, factors)])} ({style.sum(rates)})")
    return " ".join(f"- {p[1:].strip()}" if p.startswith("-") else f"+ {p}" for p in pieces).removeprefix("+ ") or "0"


def _is_rate(name: str) -> bool:
    return name.rpartition("_")[0] in ("dq", "dq_ref", "ddq_ref")


def _roman(latex: str) -> str:
    """Set first moments upright, as one symbol."""
    return latex.replace(_MOMENT, rf"\mathrm{{{_MOMENT[:2]}}}_{{")


def _entries(matrix: Matrix) -> list[Row]:
    """Entries of a matrix; the symmetric M once a pair."""
    rows, printed = list[Row](), _printed(matrix)
    if len(printed) == len(printed[0]) == 1:
        return [Row(matrix.name, f"= {printed[0][0]}")]
    for i, row in enumerate(printed, start=1):
        for j, entry in enumerate(row, start=1):
            if matrix.name == "M" and j < i:
                continue
            label = f"{matrix.name}_{{{i}}}" if len(row) == 1 else f"{matrix.name}_{{{i}{j}}}"
            mirrored = f" = M_{{{j}{i}}}" if matrix.name == "M" and j > i else ""
            rows.append(Row(label + mirrored, f"= {entry}"))
    return rows


def _about(chain: SerialChain) -> str:
    joints = ", ".join(chain.joint_names)
    return (
        f"The equations of {chain.name} (joints {joints}), printed from the expressions that are simulated and "
        "proved. $c_{12} = \\cos(q_1 + q_2)$ and $s_2 = \\sin(q_2)$; $m_i$, $\\mathrm{mc}_i$ and $I_i$ "
        "are mass, first moments and inertia of link i about the origin of joint i, in its frame; $p_{x2}$ is the x "
        "coordinate of joint 2 in the frame of joint 1, $g_0$ the gravity. Parameters that are zero in this robot are "
        "omitted in M, C and g, but not in the regressor, where $\\dot q_{\\mathrm r} = \\dot q_{ref}$."
    )
