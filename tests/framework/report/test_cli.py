from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from dmframe.certify.schema import verdict_schema
from dmframe.cli import main
from dmframe.report.linear import LinearView
from dmframe.report.references import reference

REPOSITORY = Path(__file__).parents[3]


def status_of(monkeypatch, *words):
    monkeypatch.setattr("sys.argv", ["dmframe", *words])
    with pytest.raises(SystemExit) as stopped:
        main()
    return stopped.value.code


def test_schema_prints_that_of_verdicts_when_requested(monkeypatch, capsys):
    assert status_of(monkeypatch, "schema", "--verdict") == 0
    assert json.loads(capsys.readouterr().out) == verdict_schema()


def test_verify_refuses_a_report_of_another_kind_before_it_proves_anything(monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("dmframe.certify.verify", lambda *_, **__: pytest.fail("verified first"))
    assert status_of(monkeypatch, "verify", "pendulum", "--report", "r.docx") == 2
    error = capsys.readouterr().err
    assert error == "dmframe: r.docx: expected a name that ends in .html, .md, .json, found .docx\n"


def test_verify_writes_the_report_and_reports_it(monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("dmframe.report.content.linear_view", lambda *_: LinearView("Not looked at."))
    assert status_of(monkeypatch, "verify", "pendulum", "--set", "duration=0.1", "--report", "r.md") == 0
    assert capsys.readouterr().out.endswith("wrote r.md\n")
    assert Path("r.md").read_text(encoding="utf-8").startswith("# pendulum: proved")


def test_a_source_is_cited_as_in_a_paper():
    assert reference("WangTAC2020") == (
        "H. Wang, W. Ren, C. C. Cheah, Y. Xie, S. Lyu, “Dynamic Modularity Approach to Adaptive Control of Robotic "
        "Systems With Closed Architecture”, IEEE Transactions on Automatic Control 65(6), 2020, pp. 2760–2767."
    )


def test_every_source_that_a_packaged_block_cites_is_printed_in_full():
    folders = (REPOSITORY / "blocks" / "dmframe_blocks", REPOSITORY / "plants" / "dmframe_plants")
    texts = [file.read_text(encoding="utf-8") for folder in folders for file in folder.rglob("*.py")]
    cited = {key for text in texts for key in re.findall(r"\[([A-Z]\w+\d{4}[a-z]?)\]_", text)}
    assert len(cited) > 4
    assert [key for key in cited if reference(key).startswith("see the documentation")] == []


def test_for_an_unknown_source_the_reader_is_sent_to_the_blocks_documentation():
    assert reference("Unknown1900") == "see the documentation of the block that cites it"
