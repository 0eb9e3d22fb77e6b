from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from dmframe.certify.schema import verdict_schema
from dmframe.cli import main
from dmframe.report.references import _REFERENCES, reference

REPOSITORY = Path(__file__).parents[3]


def status_of(monkeypatch, *words):
    monkeypatch.setattr("sys.argv", ["dmframe", *words])
    with pytest.raises(SystemExit) as stopped:
        main()
    return stopped.value.code


def test_schema_prints_that_of_verdicts_when_asked(monkeypatch, capsys):
    assert status_of(monkeypatch, "schema", "--verdict") == 0
    assert json.loads(capsys.readouterr().out) == verdict_schema()


def test_verify_refuses_a_report_of_another_kind_before_it_proves_anything(monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("dmframe.certify.verify", lambda *_, **__: pytest.fail("verified first"))
    assert status_of(monkeypatch, "verify", "pendulum", "--report", "r.docx") == 2
    told = capsys.readouterr().err
    assert told == "dmframe: r.docx: expected a name that ends in .html, .md, .json, found .docx\n"


def test_verify_writes_the_report_and_says_so(monkeypatch, capsys, tmp_path, contents):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("dmframe.report.write.gather", lambda *_, **__: contents["proved"])
    assert status_of(monkeypatch, "verify", "pendulum", "--report", "r.md") == 0
    assert capsys.readouterr().out.endswith("wrote r.md\n")
    assert Path("r.md").read_text(encoding="utf-8").startswith("# arm2_joint: proved")


def test_sources_are_those_of_the_documentation():
    bibliography = (REPOSITORY / "docs" / "references.bib").read_text(encoding="utf-8")
    for key, text in _REFERENCES.items():
        entry = re.search(rf"@\w+\{{{key},(.*?)\n\}}", bibliography, re.DOTALL)
        assert entry, key
        title = re.search(r"title\s*=\s*\{(.*?)\},?\n", entry[1], re.DOTALL)[1]
        plain = " ".join(title.replace("{", "").replace("}", "").split())
        assert plain.lower() in text.lower()


def test_every_source_that_a_packaged_block_cites_is_told_in_full():
    folders = (REPOSITORY / "blocks" / "dmframe_blocks", REPOSITORY / "plants" / "dmframe_plants")
    texts = [file.read_text(encoding="utf-8") for folder in folders for file in folder.rglob("*.py")]
    cited = {key for text in texts for key in re.findall(r"\[([A-Z]\w+\d{4}[a-z]?)\]_", text)}
    assert len(cited) > 4
    assert cited - _REFERENCES.keys() == set()


def test_a_source_of_somebody_elses_block_is_told_where_to_find():
    assert reference("Nobody1900") == "see the documentation of the block that cites it"
