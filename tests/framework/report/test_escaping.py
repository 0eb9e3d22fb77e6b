"""Every text of a graph, its robot or its blocks is escaped on a page."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import fields, is_dataclass, replace
from typing import Any

import pytest

from dmframe.common.text import Text
from dmframe.report import html, markdown
from dmframe.report.content import Content, Opening
from dmframe.report.mathml import breakable, mathml
from dmframe.report.page import as_html, as_markdown, first_page
from dmframe.report.parts import Bullets, Listing, Marked, Table

EVIL = (
    r"$\text{<script>alert(1)</script>}$",
    "<script>alert(1)</script>",
    '"><img src=x onerror=alert(1)>',
    "`</code><script>` [Evil2020] & <b>",
    r"$\href{javascript:alert(1)}{x}$",
)
OURS = {"picture", "mermaid", "run", "figure", "bode", "nyquist", "outcome", "side", "kind", "factor", "how"}
"""Fields made and read by the framework; all others may contain a name chosen by a user."""


def with_text(item: Any, text: str) -> Any:
    """The same content with `text` in every text field."""
    if isinstance(item, str):
        return Text(text) if isinstance(item, Text) else text
    if is_dataclass(item) and not isinstance(item, type):
        own = {field.name: getattr(item, field.name) for field in fields(item) if field.name not in OURS}
        return replace(item, **{key: with_text(value, text) for key, value in own.items()})
    if isinstance(item, dict):
        return {key: with_text(value, text) for key, value in item.items()}
    return type(item)(with_text(each, text) for each in item) if isinstance(item, list | tuple) else item


def intruders(page: str) -> list[str]:
    """Elements and attributes that the framework does not write."""
    elements = list(ET.fromstring(page.removeprefix("<!DOCTYPE html>\n")).iter())
    found = [each.tag for each in elements if each.tag in ("script", "img", "b")]
    found += [key for each in elements for key in each.attrib if key.startswith("on") or key == "src"]
    return found + [each.get("href", "") for each in elements if not each.get("href", "#").startswith("#")]


@pytest.mark.parametrize("text", EVIL)
@pytest.mark.parametrize("name", ["proved", "refuted", "failing"])
def test_a_text_of_others_is_a_text_wherever_it_appears(contents, name, text):
    evil = with_text(contents[name], text)
    page = as_html([evil])
    assert intruders(page) == []
    assert intruders(as_html([evil, evil])) == []
    assert "default-src 'none'" in page


@pytest.mark.parametrize("text", EVIL)
def test_the_first_page_in_a_notebook_escapes_too(contents, text):
    held = {field.name: getattr(contents["proved"], field.name) for field in fields(Opening)}
    page = first_page(with_text(Opening(**held), text))
    assert [tag for tag in intruders(page) if tag != "b"] == []
    assert ET.fromstring(page).get("class") == "dmframe"


def test_a_page_that_does_not_escape_is_caught(contents, monkeypatch):
    monkeypatch.setattr(html, "plain", html.Html)
    page = as_html([with_text(contents["refuted"], EVIL[1])])
    assert "script" in intruders(page)


def test_a_formula_takes_no_markup_of_others():
    for latex in (r"\text{<script>alert(1)</script>}", r"\text{a<b}", r"\mathrm{<b>}", "a <b> c"):
        made = mathml(latex)
        assert {each.tag for each in ET.fromstring(made).iter()} <= {"math", "mrow", "mtext", "mi", "mo"}
    assert mathml(r"\href{javascript:alert(1)}{x}").startswith("<code>\\href")
    assert "<mtext>a b</mtext>" in breakable(r"\text{a b}")


@pytest.mark.parametrize("text", ["a | b", "a\nb", "$|a|$ | b", "`a|b`"])
def test_a_text_with_a_bar_or_a_new_line_stays_in_its_cell(text):
    for cell in (text, Marked(text)):
        written = markdown.table(Table([(cell, "end")], ("one", "two")))
        head, rule, row = written.splitlines()
        assert [line.replace(r"\|", "").count("|") for line in (head, rule, row)] == [3, 3, 3]


def test_a_listing_is_fenced_by_more_backticks_than_it_has(contents):
    text = as_markdown([replace(contents["silent"], resolved="title: |\n  ````\n  # no heading\n")])
    assert "`````yaml\ntitle: |\n  ````\n  # no heading\n`````" in text


def test_what_is_wrong_stands_out_in_both():
    table = Table([("a", "1"), ("b", "2")], ("x", "y"), keys=True, numbers=(1,), failing=(1,))
    made = html.table(table)
    assert made.count('<tr class="fails"><th scope="row">b</th><td class="number">2</td></tr>') == 1
    assert markdown.table(table).splitlines()[1] == "|---|---:|"
    listed = html.Writer("g1").part(Bullets(["a", "b"], failing=(0,)))
    assert listed == '<ul><li class="fails">a</li>\n<li>b</li></ul>'
    assert html.Writer("g1").part(Listing("<a>", "yaml")) == "<pre>&lt;a&gt;</pre>"


def test_every_content_is_walked_by_these_tests():
    """A field that is omitted above must be one that the framework makes."""
    names = {field.name for field in fields(Content)}
    assert {"name", "title", "facts", "laws", "conditions", "replay", "resolved", "uncertain"} <= names - OURS
