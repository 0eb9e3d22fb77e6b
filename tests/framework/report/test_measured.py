from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dmframe.common.errors import StartError
from dmframe.common.notebook import embedded
from dmframe.report.measured import measure
from dmframe.simulate import Divergence


def test_a_graph_that_cannot_be_simulated_gives_the_reason(proved, monkeypatch):
    def refuse(*_, **__):
        raise StartError("start: out of reach")

    monkeypatch.setattr("dmframe.config.graph.simulate", refuse)
    found = measure(proved.graph, proved.verdict)
    assert found.sentence.endswith("The graph could not be simulated: start: out of reach.")
    assert (found.facts, found.figure) == ((), "")


def test_a_run_that_diverged_is_reported_with_its_state(proved, monkeypatch):
    run = proved.graph.until(0.1).simulate(proved.diagram)
    states = {label: rows.copy() for label, rows in run.states.items()}
    states["arm.dq"][-1] = 1e200
    blown = replace(run, states=states, divergence=Divergence("arm", "dq", 0, 0.1))
    monkeypatch.setattr("dmframe.config.graph.simulate", lambda *_, **__: blown)
    with np.errstate(all="ignore"):
        found = measure(proved.graph, proved.verdict)
    assert found.facts[0][1].endswith("the run diverged: `arm.dq` is no longer finite")
    assert found.numbers["diverged"] is True
    assert found.numbers["V"][-1] is None


def test_in_continuous_time_the_report_blames_no_sampling(continuous):
    graph = continuous.graph.until(0.3)
    found = measure(graph, continuous.verdict)
    assert "the simulation differs from the theorem's loop by the integration error only" in found.sentence
    assert "sampling" not in found.sentence


@pytest.mark.parametrize(
    ("svg", "expected"),
    [
        ('<svg xmlns="http://x"><a id="b"/></svg>', '<svg id="p"><a id="p-b"/></svg>'),
        ('<?xml version="1"?>\n<svg><use xlink:href="#b"/></svg>', '<svg id="p"><use href="#p-b"/></svg>'),
        ("<svg><style>text, .x { a: b }</style></svg>", '<svg id="p"><style>#p text, #p .x { a: b }</style></svg>'),
        ('<svg><g clip-path="url(#c)"/><metadata>m</metadata></svg>', '<svg id="p"><g clip-path="url(#p-c)"/></svg>'),
    ],
)
def test_a_picture_in_a_page_keeps_its_names_and_styles_to_itself(svg, expected):
    assert embedded(svg, "p") == expected
