"""Sections given by the caller of a report, as in docs/how_to/extend.md."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from dmframe.common.errors import ValueFault
from dmframe.report import write
from dmframe.report.content import gather
from dmframe.report.linear import LinearView
from dmframe.report.parts import Paragraph, Section
from dmframe.report.write import as_data, write_report
from tests.page_code import page_module


@pytest.fixture(scope="module")
def content(proved):
    """Data for a report without a linear analysis, which takes longest."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("dmframe.report.content.linear_view", lambda *_: LinearView("Not looked at."))
        return gather(proved.graph, proved.verdict, command=["dmframe"], seed=0)


@pytest.fixture
def largest_efforts(tmp_path):
    return page_module("docs/how_to/extend.md", "efforts.py", tmp_path).largest_efforts


@pytest.fixture
def written(content, proved, tmp_path, monkeypatch):
    """Text of a report with sections, in a format, from content that was collected already."""

    def written(ending, *sections):
        monkeypatch.setattr(write, "gather", lambda *_, **__: content)
        path = tmp_path / f"report{ending}"
        write_report(path, [proved], replay=["dmframe"], sections=sections)
        return path.read_text(encoding="utf-8")

    return written


def test_the_section_of_the_page_holds_the_maxima_of_the_run(written, content, largest_efforts):
    run = content.measured.run
    text = written(".md", largest_efforts)
    rows = text.split("## Largest efforts\n\n")[1].split("\n\n")[0].splitlines()
    heads = [cell.strip() for cell in rows[0].strip("|").split("|")]
    assert heads == ["joint", "dynamics.tau_dc [N m]", "servo.u [V]", "arm.g [N m]"]
    assert len(rows) == 4
    for row, k in zip(rows[2:], range(2), strict=True):
        cells = [cell.strip() for cell in row.strip("|").split("|")]
        assert cells[0] == f"`joint{k + 1}`"
        for head, cell in zip(heads[1:], cells[1:], strict=True):
            values = run[head.split(" ")[0]][:, k]
            assert float(cell) == pytest.approx(max(values.max(), -values.min()), rel=1e-2)
    assert np.abs(run["servo.u"]).max() > 1
    page = written(".html", largest_efforts)
    assert page.count(">Largest efforts<") == 2  # its heading, and its entry in the contents


def test_it_precedes_the_provenance_and_changes_no_other_section(written, largest_efforts):
    own, plain = (
        [line for line in written(".md", *sections).splitlines() if line.startswith("## ")]
        for sections in ((largest_efforts,), ())
    )
    assert own[own.index("## Largest efforts") + 1] == "## Provenance"
    assert [head for head in own if head != "## Largest efforts"] == plain


def test_a_graph_that_was_not_simulated_has_the_section_too(content, largest_efforts):
    section = largest_efforts(replace(content, measured=replace(content.measured, run=None)))
    assert section.parts == [Paragraph("The graph could not be simulated.")]


def test_data_have_neither_the_sections_nor_the_recording(written, content, largest_efforts):
    assert json.loads(written(".json", largest_efforts)) == json.loads(written(".json"))
    assert list(as_data([content])["graphs"][0]["measured"]) == ["sentence", "facts", "numbers"]


@pytest.mark.parametrize(
    ("sections", "text"),
    [
        ([lambda _: "a text"], "expected <lambda> to return a Section, found 'a text'"),
        ([lambda _: Section("laws", "Again", [])], "the section name 'laws' is used already; choose another"),
        ([lambda _: Section("own", "One", [])] * 2, "the section name 'own' is used already; choose another"),
    ],
)
def test_what_is_not_a_section_of_its_own_is_refused(written, sections, text):
    with pytest.raises(ValueFault, match=text):
        written(".md", *sections)
