from __future__ import annotations

import math

import pytest

from dmframe.analysis import Bracket, analyse
from dmframe.common.errors import EngineError
from dmframe.report.linear import _bracket, linear_view
from dmframe.report.page import as_html, as_markdown


def test_poles_margins_and_periods_are_those_of_the_analysis(proved, analysed):
    view, graph = analysed.linear, proved.graph
    found = analyse(proved.diagram, graph.file.clock, solver=graph.solver, start=graph.start, horizon=0.2)
    assert [row[0] for row in view.joints] == ["joint1", "joint2"]
    assert view.joints[0][3] == f"{found.joints[0].margins.phase:.1f} deg"
    assert view.loop[0][1] == f"{found.at_rest.poles[0].real:.4g}"
    assert view.numbers["largest_stable_period"]["at_rest"]["stable"] == found.periods.at_rest.stable
    page, text = as_html([analysed]), as_markdown([analysed])
    assert 'id="g1-bode"' in page
    assert 'id="g1-nyquist"' in page
    for row in (*view.joints, *view.loop, *view.periods):
        assert row[1] in page
        assert row[1] in text


@pytest.mark.parametrize(
    ("stable", "unstable", "text"),
    [
        (0.0, 1e-5, "none; unstable at 10 µs"),
        (10.0, math.inf, "above 10 s, the longest tested"),
        (0.004, 0.005, "4 ms to 5 ms"),
        (0.0038971, 0.0038972, "3.897 ms"),
    ],
)
def test_a_bracket_is_parsed_as_a_reader_parses_it(stable, unstable, text):
    assert _bracket(Bracket(stable, unstable, "")) == text


def test_a_loop_without_a_linear_analysis_gives_the_reason(proved, monkeypatch):
    def refuse(*_, **__):
        raise EngineError("no equilibrium")

    monkeypatch.setattr("dmframe.analysis.analyse", refuse)
    view = linear_view(proved.graph)
    assert view.sentence == "This loop has no linear analysis: no equilibrium."
    assert (view.joints, view.bode, dict(view.numbers)) == ((), "", {})
