from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ET
from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest

from dmframe.common.errors import OutputError
from dmframe.report.page import as_html, as_markdown
from dmframe.report.write import as_data, check_place, write_report

NAMES = ("proved", "refuted", "failing", "silent")
SECTIONS = (
    "What this means",
    "The diagram",
    "The laws",
    "V and its derivative",
    "Conditions and assumptions",
    "What follows",
    "The loop as it runs",
    "Poles, margins and the sampling period",
    "Fault injection",
    "Provenance",
)


def parsed(page: str) -> ET.Element:
    return ET.fromstring(page.removeprefix("<!DOCTYPE html>\n"))


def words(page: str) -> str:
    """The text of the page, without style sheets."""
    body = re.sub(r"<style>.*?</style>", "", page.removeprefix("<!DOCTYPE html>\n"), flags=re.DOTALL)
    body = re.sub(r"(?=</(?:td|th|li|p|h\d)>)", " ", body)
    return " ".join("".join(ET.fromstring(body).itertext()).split())


@pytest.fixture(scope="module")
def pages(contents):
    return {name: as_html([contents[name]]) for name in NAMES}


@pytest.fixture(scope="module")
def texts(contents):
    return {name: as_markdown([contents[name]]) for name in NAMES}


@pytest.mark.parametrize("name", NAMES)
def test_a_page_is_well_formed_and_fetches_nothing(pages, name):
    page = pages[name]
    for element in parsed(page).iter():
        assert element.tag not in ("script", "link", "img", "iframe", "object", "embed", "base")
        for key, value in element.attrib.items():
            assert key != "src"
            assert key != "href" or value.startswith("#"), value
    assert not re.search(r"https?:|//|@import|url\((?!#)", re.sub(r"<pre>.*?</pre>", "", page, flags=re.DOTALL))


@pytest.mark.parametrize("name", NAMES)
def test_every_link_of_a_page_leads_to_its_one_target(pages, name):
    elements = list(parsed(pages[name]).iter())
    ids = Counter(element.attrib["id"] for element in elements if "id" in element.attrib)
    assert set(ids.values()) == {1}
    used = {value[1:] for element in elements for key, value in element.attrib.items() if key == "href"}
    used |= set(re.findall(r"url\(#([^)]+)\)", pages[name]))
    assert used <= ids.keys()


@pytest.mark.parametrize("name", NAMES)
def test_every_section_is_in_page_and_markdown(pages, texts, name):
    headings = ["".join(element.itertext()) for element in parsed(pages[name]).iter("h2")]
    assert [heading for heading in headings if heading in SECTIONS] == list(SECTIONS)
    lines = texts[name].splitlines()
    assert [line[3:] for line in lines if line.startswith("## ") and line[3:] in SECTIONS] == list(SECTIONS)


@pytest.mark.parametrize("name", NAMES)
def test_no_formula_is_left_unset(pages, name):
    for math in parsed(pages[name]).iter("math"):
        assert "\\" not in "".join(math.itertext())
    assert "$" not in words(pages[name])


@pytest.mark.parametrize(
    ("name", "headline"),
    [
        ("proved", "Proved: in continuous time this control loop is stable"),
        ("refuted", "Refuted: the certificate is false"),
        ("failing", "Not proved, and not refuted: the formula for"),
        ("silent", "Not proved, and not refuted: this graph has no certificate to test: inverse: a "),
    ],
)
def test_the_verdict_comes_first_in_one_sentence(pages, texts, name, headline):
    assert words(pages[name]).count(headline) == 1
    assert f"> **{headline.split(':')[0]}**" in texts[name]


@pytest.mark.parametrize("name", ["proved", "failing"])
def test_the_numbers_of_a_page_are_those_of_the_json(contents, pages, texts, name):
    data, seen = as_data([contents[name]])["graphs"][0], words(pages[name])
    for condition in data["verdict"]["conditions"]:
        none = "" if condition["holds"] else "not found "
        shown = none if condition["value"] is None else f"{condition['value']:.4g} "
        assert f" {shown}{'holds' if condition['holds'] else 'fails'}" in seen
        assert f"| {shown.strip()} | {'holds' if condition['holds'] else '**fails**'} |" in texts[name]
    controls = data["verdict"]["mutants"]
    for text in (seen, texts[name]):
        assert f"{controls['refuted']} of {controls['tried']} were refuted" in text
        assert ", ".join(data["verdict"]["primes"]) in text
        assert data["provenance"]["graph_sha256"] in text
        for item in data["terms"]["storage"]:
            assert item["value"] in text


def test_v_along_the_run_is_given_in_words_numbers_and_picture(contents, pages):
    numbers = contents["proved"].measured.numbers
    assert numbers["V_start"] > 0
    assert numbers["steps"] == 100
    seen = words(pages["proved"])
    assert f"{numbers['V_start']:.6g} and {numbers['V_end']:.6g}" in seen
    assert f"by at most {numbers['largest_increase']:.3g}" in seen
    assert "The sampled loop is not proved." in seen
    assert 'id="g1-run-plot"' in pages["proved"]


@pytest.mark.parametrize("name", ["refuted", "silent", "failing"])
def test_v_is_not_shown_where_it_means_nothing(contents, pages, name):
    assert "V_start" not in contents[name].measured.numbers
    assert "g1-run-plot" not in pages[name]
    assert "is not shown" in words(pages[name]) or "there is no" in words(pages[name])
    assert "No conclusions: the certificate is not proved." in words(pages[name])


def test_a_refutation_names_the_block_the_signals_and_the_point(contents, pages, texts):
    found, witness = contents["refuted"].summary["refutation"], contents["refuted"].witness
    assert witness.blame == ("dynamics",)
    for text in (words(pages["refuted"]), texts["refuted"]):
        assert found["prime"] in text
        assert found["residue"] in text
        assert ", ".join(found["signals"]) in text
    for label, residues in witness.point:
        assert residues == ", ".join(found["point"][label])


def test_a_failing_condition_is_marked_and_no_kappa_is_made_up(pages):
    fails = [row for row in parsed(pages["failing"]).iter("tr") if row.get("class") == "fails"]
    assert any("M" in "".join(row.itertext()) for row in fails)
    assert "suffices" not in words(pages["failing"])


def test_what_a_block_states_is_text_and_not_markup(pages):
    assert "x &lt; y &amp; z" in pages["refuted"]


def test_the_command_that_replays_a_report_is_one_that_a_shell_takes(pages):
    assert "dmframe verify 'it'\"'\"'s'" in words(pages["proved"])


def test_the_robots_equations_are_in_reports_of_planar_arms(pages, texts):
    assert "The robot's equations" in words(pages["proved"])
    assert r"C_{12} = - p_{x2} \mathrm{mc}_{x2} s_{2} (\dot q_{1} + \dot q_{2})" in texts["proved"]


def test_several_graphs_make_one_page_with_an_overview(contents):
    both = [contents["proved"], contents["refuted"]]
    page = as_html(both)
    rows = [["".join(cell.itertext()) for cell in row] for row in parsed(page).iter("tr")][:3]
    assert rows[1][:2] == ["arm2_joint", "Proved"]
    assert rows[2][:2] == ["lie", "Refuted"]
    ids = [element.attrib["id"] for element in parsed(page).iter() if "id" in element.attrib]
    assert len(ids) == len(set(ids))
    assert as_markdown(both).count("\n## Provenance\n") == 2


def test_the_json_holds_verdict_laws_formulas_run_and_provenance(contents):
    text = json.dumps(as_data(list(contents.values())), allow_nan=False)
    first = json.loads(text)["graphs"][0]
    assert first["verdict"] == contents["proved"].summary
    assert first["laws"][0]["equations"][0]["tag"] == "1"
    assert first["terms"]["V"][0]["left"] == "V"
    assert first["measured"]["numbers"]["kappa"] == first["verdict"]["kappa"]["chosen"]
    assert first["provenance"]["seed"] == 0


@pytest.fixture
def gathered(contents, monkeypatch):
    """Without a new simulation; the arguments of `gather` are recorded."""
    calls = list[dict[str, object]]()

    def gather(*_, tell, **named):
        calls.append(named)
        return contents["silent"]

    monkeypatch.setattr("dmframe.report.write.gather", gather)
    return calls


@pytest.mark.parametrize("ending", ["html", "md", "json", "HTML"])
def test_a_report_is_written_by_its_ending(silent, tmp_path, gathered, ending):
    write_report(tmp_path / f"r.{ending}", [silent])
    start = {"html": "<!DOCTYPE html>", "md": "# silent", "json": "{"}[ending.lower()]
    assert (tmp_path / f"r.{ending}").read_text(encoding="utf-8").startswith(start)
    assert [path.name for path in tmp_path.iterdir()] == [f"r.{ending}"]


def test_a_report_states_how_it_came_about(proved, silent, tmp_path, gathered):
    write_report(tmp_path / "r.md", [replace(proved, seed=3), replace(silent, seed=3)])
    file = silent.graph.document.name
    words = ["dmframe", "verify", "arm2_joint", file, "--set", "arm2_joint:duration=0.2"]
    words += ["--seed", "3", "--report", "r.md"]
    assert gathered == [{"command": words, "seed": 3}] * 2


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("r.pdf", "r.pdf: expected a name that ends in .html, .md, .json, found .pdf"),
        ("report", "report: expected a name that ends in .html, .md, .json, found no ending"),
        ("folder.md", "folder.md: expected a file, found a folder; choose a file in it"),
        ("no/r.md", "no/r.md: the folder no does not exist; create it first, or choose another"),
    ],
)
def test_a_path_where_no_report_can_be_written_is_refused_before_any_computation(tmp_path, monkeypatch, name, text):
    monkeypatch.chdir(tmp_path)
    Path("folder.md").mkdir()
    with pytest.raises(OutputError) as caught:
        check_place(Path(name))
    assert caught.value.text == text


def test_a_report_that_cannot_be_written_leaves_the_old_one(silent, tmp_path, gathered, monkeypatch):
    path = tmp_path / "r.json"
    path.write_text("old")

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", full)
    with pytest.raises(OutputError, match=r"r\.json: cannot be written: no space left on device; free some space"):
        write_report(path, [silent])
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]
