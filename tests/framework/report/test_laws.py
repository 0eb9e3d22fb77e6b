from __future__ import annotations

import pytest

from dmframe.block import AbstractBlock
from dmframe.report.laws import Row, law_of, rows_of
from dmframe_blocks.pid_inverse import PidInverse
from dmframe_blocks.waypoints import Waypoints


def test_a_blocks_equations_keep_their_order_numbers_and_alignment():
    law = law_of(PidInverse)
    groups = [part for part in law.body if not isinstance(part, str)]
    assert [row.tag for group in groups for row in group] == ["1", "2", "3", "4", "", "5", "6"]
    assert groups[0][1] == Row(r"\dot w", r"= -\Lambda\, \tau_{dc} \sigma", "2")
    assert law.body[0] == r"With $e = q - q_r$ and $z = \int (q_c - q_r)$, products element by element:"


def test_parameters_notes_and_sources_are_read_from_their_sections():
    law = law_of(PidInverse)
    assert law.parameters["Lambda_P"] == law.parameters["Lambda_I"] == "Adaptation gains of the ratios w_P and w_I."
    assert law.notes == "Not for: a PI velocity servo; see `pi_inverse`."
    assert law.source == "[WangTAC2020] eqs. (32)-(39), Theorem 4 and Remark 5."


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        (r"x = y \tag{7}", (Row("x", "= y", "7"),)),
        (r"f(a = b) \ge 0", (Row("", r"f(a = b) \ge 0"),)),
        (
            "a &= b \\\\\n  &\\quad + c \\tag{1}\n\nd = e",
            (Row("a", "= b"), Row("", r"\quad + c", "1"), Row("d", "= e")),
        ),
        (r"y = \begin{cases} 1 & a \\ 0 & b \end{cases}", (Row("y", r"= \begin{cases} 1 & a \\ 0 & b \end{cases}"),)),
    ],
)
def test_equations_are_split_into_lines(source, expected):
    assert rows_of(source) == expected


def test_a_block_without_a_docstring_has_an_empty_law():
    class Bare(AbstractBlock):
        pass

    Bare.__doc__ = None
    law = law_of(Bare)
    assert (law.summary, law.body, law.notes) == ("", (), "")


def test_a_fraction_in_a_law_stays_whole():
    rows = next(part for part in law_of(Waypoints).body if not isinstance(part, str))
    assert r"\tfrac{t - t_i}{t_{i+1} - t_i}" in rows[0].right + rows[1].right
