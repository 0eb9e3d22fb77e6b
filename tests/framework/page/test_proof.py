"""The certificate in a live page, and its check in the reader's browser."""

from __future__ import annotations

import base64
import json
import subprocess
import time
import zlib
from pathlib import Path
from typing import Any

from in_chromium import Chromium

import dmframe as dm
from dmframe.page.page import assembled
from dmframe.page.proof import Proof, checker_script, packed, proof_of, shortened
from tests.framework.checker.certificates import SAME, certificate, node_path, replaced
from tests.framework.in_node import content

NAME = "pendulum"
SHOWN = "document.querySelector('#proof summary, #proof p')?.textContent"


def _proof(data: dict[str, Any], script: str | None = None) -> Proof:
    allowed = checker_script()
    return Proof(packed(json.dumps(data)), packed(allowed if script is None else script), allowed)


def test_the_shortened_program_decides_as_the_file(tmp_path: Path) -> None:
    script = tmp_path / "checker.js"
    script.write_text(checker_script(), "utf-8")
    ask = "require(process.argv[1]); const data = JSON.parse(require('fs').readFileSync(0, 'utf8'));"
    ask += "console.log(JSON.stringify(globalThis.checker.check(data)))"
    found = []
    for path in (script, Path(dm.__file__).parent / "checker" / "check.js"):
        command = [node_path(), "-e", ask, str(path)]
        text = json.dumps(certificate("arm2_joint"))
        done = subprocess.run(command, input=text, capture_output=True, text=True, check=True)
        found.append(json.loads(done.stdout))
    assert found[0]["status"] == "re-proved"
    assert {key: found[0][key] for key in SAME} == {key: found[1][key] for key in SAME}


def test_a_page_proves_itself_in_the_browser_and_shows_a_false_certificate(tab: Chromium, tmp_path: Path) -> None:
    data, page = certificate(NAME), tmp_path / "page.html"
    false = {**data, "rates": {**data["rates"], "arm.dq": replaced(data, data["rates"]["arm.dq"])}}
    page.write_text(assembled(content(NAME), _proof(certificate(NAME))), "utf-8")
    tab.opened(page)
    assert tab.until(SHOWN).startswith("Proved again in this browser")
    assert not tab.said
    page.write_text(assembled(content(NAME), _proof(false)), "utf-8")
    tab.opened(page)
    assert "refuted" in tab.until(SHOWN)
    page.write_text(assembled(content(NAME), _proof(certificate(NAME), f"{checker_script()};")), "utf-8")
    tab.opened(page)  # another program than the policy allows
    tab.until("document.getElementById('headline').textContent !== 'Loading'")
    for _ in range(100):  # the browser's message may come after the page is shown
        assert not tab.value(SHOWN)
        if any("Content Security Policy" in text for text in tab.said):
            break
        time.sleep(0.1)
    assert any("Content Security Policy" in text for text in tab.said)


def test_a_page_without_a_proof_contains_no_certificate() -> None:
    graph = dm.load(NAME)
    proof = proof_of(graph, graph.verify().verdict)
    held = json.loads(zlib.decompress(base64.b64decode(proof.certificate)))
    assert held["terms"] == certificate(NAME)["terms"]
    assert proof_of(graph, dm.load("pendulum_kinematic").verify().verdict) == Proof()
    assert 'id="certificate"></script>' in assembled(content(NAME))


def test_the_program_of_a_page_has_less_than_12_kb() -> None:
    assert len(zlib.compress(checker_script().encode(), 9)) < 12_000


def test_a_script_is_shortened_without_a_change_of_its_texts() -> None:
    script = """
// a comment
const total = (first, second) => first - -second; // another one
const text = (item) => `first: ${total(item.count, 2)} // ${/^(a b)$/.test("x  y")}` + "first // count" + item.length;
"""
    found = shortened(script, frozenset({"text"}))
    assert found == (
        'const d=(first,e)=>first- -e;const text=(c)=>`first: ${d(c.count, 2)} // ${/^(a b)$/.test("x  y")}`'
        '+"first // count"+c.length;'
    )


def test_the_page_of_ur10_fast_with_its_proof_stays_below_200_kb() -> None:
    assert len(dm.load("ur10_fast").page().html.encode()) < 200_000
