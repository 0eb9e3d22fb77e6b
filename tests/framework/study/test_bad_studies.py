"""Bad studies and their messages, word for word.

In `bad_studies.txt` ``== name`` begins a case, ``|`` a line of a study whose first two lines are those of a good one;
what remains is the whole message.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from dmframe.common.errors import DmframeError
from dmframe.study.read import load_study

TEXT = (Path(__file__).parent / "bad_studies.txt").read_text(encoding="utf-8")
CASES = [case.split("\n", 1) for case in TEXT.removeprefix("== ").split("\n== ")]


@pytest.mark.parametrize(("name", "body"), CASES, ids=[name for name, _ in CASES])
def test_a_bad_study_is_refused_with_the_place_and_the_remedy_of_each_fault(
    name: str, body: str, study: Any, arm: Path
) -> None:
    lines = body.strip("\n").split("\n")
    text = "\n".join(line[2:] for line in lines if line.startswith("|"))
    with pytest.raises(DmframeError) as caught:
        study(text + "\n").check()
    found = str(caught.value).replace(f"{arm.parent}/", "")
    assert found.split("\n") == [line for line in lines if line and not line.startswith("|")], name


def test_a_graph_in_place_of_a_study_is_one_fault(arm: Path) -> None:
    with pytest.raises(DmframeError) as caught:
        load_study(arm)
    text = "expected a study, found a graph without a section uncertain; write a study with the key graph"
    assert str(caught.value) == f"{arm}: {text}: {arm.name}"
