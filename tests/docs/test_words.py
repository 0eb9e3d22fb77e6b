"""The word list of lint: hits in prose, no hits in code, spans of code and targets of links."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

WORDS = Path(__file__).parents[1] / "words.py"


@pytest.fixture
def words(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    spec = importlib.util.spec_from_file_location("words", WORDS)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.setattr(module, "ROOT", tmp_path)
    return module


@pytest.mark.parametrize(
    ("line", "word"),
    [
        ("The verdict says which states are bounded.", "says"),
        ("No block knows the delay.", "knows"),
        ("The law learns it; it is learnt once.", "learns"),
        ("What is left of the error is small.", "What is left"),
        ("Nothing is proved of it, whatever the gain is.", "Nothing is"),
        ("The maker's servo in place of ours.", "maker"),
        ("It was told so.", "told"),
    ],
)
def test_a_private_word_in_the_prose_of_a_page_is_a_hit(
    words: ModuleType, tmp_path: Path, line: str, word: str
) -> None:
    page = tmp_path / "page.md"
    page.write_text(f"# A page\n\n{line}\n", encoding="utf-8")
    found = list(words.hits([page]))
    assert found[0].startswith(f"page.md:3: {word}: ")


@pytest.mark.parametrize(
    "text",
    [
        "A key of JSON: `says`.\n",
        "```python\nsays = knows\n```\n",
        "See [the page](what_it_says.md).\n",
        "The outstanding issue; `maker_gravity` is 1; he understands.\n",
    ],
)
def test_code_targets_of_links_and_parts_of_words_are_none(words: ModuleType, tmp_path: Path, text: str) -> None:
    page = tmp_path / "page.md"
    page.write_text(text, encoding="utf-8")
    assert list(words.hits([page])) == []


def test_words_of_prose_are_allowed_in_code_and_the_others_are_not(words: ModuleType, tmp_path: Path) -> None:
    module = tmp_path / "module.py"
    module.write_text("says = 1\n_told = 2\n", encoding="utf-8")
    assert list(words.hits([module])) == ["module.py:2: told: _told = 2"]


def test_a_private_word_in_the_code_of_the_package_is_a_hit_in_names_too(words: ModuleType, tmp_path: Path) -> None:
    code = "def steered():\n    'True if the run blew up.'\n    wildcard = kept_below = 1\n"
    for folder, count in (("dmframe", 2), ("tests", 0)):
        file = tmp_path / folder / "module.py"
        file.parent.mkdir()
        file.write_text(code, encoding="utf-8")
        assert len(list(words.hits([file]))) == count
