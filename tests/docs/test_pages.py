"""Pages: links resolve, and lists of a page are complete."""

from __future__ import annotations

import ast
import json
import re
import tomllib
from dataclasses import fields, is_dataclass
from pathlib import Path

import pytest
import typer.main
from typer.testing import CliRunner

from dmframe.block import certificate
from dmframe.catalogue import graphs
from dmframe.cli.app import app
from dmframe.cli.groups import GROUPS, grouped
from dmframe.config.document import read_document, read_file
from dmframe.config.grammar import GraphFile, LogSection, RobotSection, SolverSection
from dmframe.robot.library import robots

ROOT = Path(__file__).parents[2]
PAGES = [*ROOT.glob("*.md"), *ROOT.joinpath("docs").rglob("*.md")]
LINK = re.compile(r"\]\(([^)\s]+)\)")
CODE = re.compile(r"```.*?```", re.DOTALL)


def read(*parts: str) -> str:
    return ROOT.joinpath(*parts).read_text(encoding="utf-8")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_between_pages_resolve(page: Path) -> None:
    links = [link for link in LINK.findall(CODE.sub("", page.read_text(encoding="utf-8"))) if "://" not in link]
    missing = [link for link in links if not page.parent.joinpath(link.split("#")[0]).exists()]
    assert missing == []


def test_every_page_can_be_reached_from_the_readme() -> None:
    seen, todo = set[Path](), [ROOT / "README.md"]
    while todo:
        page = todo.pop().resolve()
        if page in seen or page.suffix != ".md" or not page.is_file():
            continue
        seen.add(page)
        todo += [page.parent / link for link in LINK.findall(page.read_text(encoding="utf-8"))]
    assert sorted(page.name for page in ROOT.joinpath("docs").rglob("*.md") if page.resolve() not in seen) == []


def test_the_reference_lists_every_command_and_option() -> None:
    text = read("docs", "reference", "command_line.md")
    group = typer.main.get_command(app)
    for name, command in group.commands.items():  # type: ignore[attr-defined]
        rows = [line for line in text.splitlines() if line.startswith(f"| `dmframe {name}")]
        assert rows, name
        for parameter in command.params:
            first, *older = [option for option in parameter.opts if option.startswith("--")] or [""]
            assert first == "--help" or any(first in row for row in rows), f"{name} {first}"
            assert all(f"`{option}`" in text for option in older), f"{name} {older}"


def test_the_reference_has_the_groups_of_the_help_and_each_command_is_in_one() -> None:
    text = read("docs", "reference", "command_line.md")
    parts = {part.partition("\n")[0]: part for part in text.split("\n## ")}
    assert list(grouped(list(typer.main.get_command(app).commands))) == list(GROUPS)  # type: ignore[attr-defined]
    for name, rows in GROUPS.items():
        listed = re.findall(r"^\| `dmframe (\w+)", parts[name], re.MULTILINE)
        assert list(dict.fromkeys(listed)) == list(rows)


def test_one_meaning_has_one_option_in_all_commands() -> None:
    commands = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    options = [(name, parameter.opts) for name, command in commands.items() for parameter in command.params]
    for name, words in options:
        assert ("--out" in words) == ("-o" in words), f"{name}: -o and --out are one option"
        if {"--seconds", "--horizon", "--duration"} & set(words):
            assert words[0] == "--until", f"{name}: {words}"
    assert {name for name, words in options if "--until" in words} > {"run", "drive", "rehearse", "analyse", "robot"}


def test_the_reference_lists_every_key_of_a_graph_file() -> None:
    text = read("docs", "reference", "graph_file.md")
    for section in (GraphFile, RobotSection, SolverSection, LogSection):
        for key in section.model_fields:
            assert f"`{key}`" in text, key


def test_the_reference_lists_every_field_of_a_certificate_and_every_kind_of_term_and_condition() -> None:
    text = read("docs", "reference", "certificate.md")
    assert [item.name for item in fields(certificate.Certificate) if f"| `{item.name}` |" not in text] == []
    kinds = [item for item in vars(certificate).values() if is_dataclass(item) and item is not certificate.Certificate]
    assert len(kinds) > 8
    assert [kind.__name__ for kind in kinds if f"`{kind.__name__}(" not in text] == []


def test_the_index_lists_every_page_of_its_folders() -> None:
    text = read("docs", "index.md")
    pages = [page for page in ROOT.joinpath("docs").rglob("*.md") if page.name != "index.md"]
    pages = [page for page in pages if page.parent.name != "course"]  # listed by the course's own index: test_course.py
    assert len(pages) > 30
    assert "(course/index.md)" in text
    assert [page.name for page in pages if f"({page.relative_to(ROOT / 'docs')})" not in text] == []


MATH = re.compile(r"\$\$.*?\$\$|\$[^$\n]+\$|`[^`\n]+`", re.DOTALL)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_no_page_cites_as_a_docstring_does(page: Path) -> None:
    """``[Key]_`` is reStructuredText: Markdown prints the underscore."""
    text = MATH.sub("", CODE.sub("", page.read_text(encoding="utf-8")))
    assert re.findall(r"\[\w+\]_|:math:|``", text) == []


def test_the_how_to_lists_every_packaged_robot() -> None:
    text = read("docs", "how_to", "robots.md")
    assert all(f"`{name}`" in text for name in robots())


def test_the_readmes_two_commands_are_targets_of_the_makefile() -> None:
    commands = re.findall(r"^make (\w+)", read("README.md"), re.MULTILINE)
    assert commands == ["run", "test"]
    assert all(re.search(rf"^{target}:", read("Makefile"), re.MULTILINE) for target in commands)


def test_the_readmes_graph_is_the_packaged_one() -> None:
    text = re.search(r"```yaml\n(.*?)```", read("README.md"), re.DOTALL)
    assert text is not None
    shown, packaged = read_document(text[1], "README").data, read_file(graphs()["ur10_fast"]).data
    assert {**shown, "title": ""} == {**packaged, "title": ""}


def test_the_readmes_pictures_are_small_enough() -> None:
    pictures = re.findall(r"!\[[^\]]*\]\(([^)]+)\)", read("README.md"))
    assert [Path(picture).suffix for picture in pictures] == [".gif", ".png"]  # one of them moves
    sizes = [ROOT.joinpath(picture).stat().st_size for picture in pictures]
    assert sizes[0] < 400_000
    assert sizes[1] < 200_000


def test_the_readme_is_short() -> None:
    assert len(read("README.md").splitlines()) <= 125


def test_the_readmes_figures_are_those_that_the_tests_hold() -> None:
    tree = ast.parse(read("tests", "blocks", "test_section_v.py"))
    (table,) = (
        ast.literal_eval(node.value)
        for node in tree.body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "RMS"
    )
    assert len(table) == 8
    assert all(f"{error} mm" in read("README.md") for error in table.values())


def test_claims_name_paths_and_commands_that_exist() -> None:
    rows = [line for line in read("CLAIMS.md").splitlines() if line.startswith("| ")][1:]
    assert len(rows) > 10
    group = typer.main.get_command(app)
    targets = set(re.findall(r"^(\w+):", read("Makefile"), re.MULTILINE))
    for row in rows:
        shown = re.findall(r"`([^`]+)`", row.strip("|").split(" | ")[1])
        assert shown, row
        for item in shown:
            words = item.split()
            if words[0] == "dmframe":
                assert words[1] in group.commands, row  # type: ignore[attr-defined]
            elif words[0] == "make":
                assert words[1] in targets, row
            else:
                assert ROOT.joinpath(item.split("::")[0]).exists(), row
                if "::" in item:
                    assert f"def {item.split('::')[1]}(" in read(item.split("::")[0]), row


def test_no_page_names_a_machines_folder() -> None:
    pattern = re.compile(r"/(?:work|root|tmp|home)/")
    assert [str(page) for page in PAGES if pattern.search(page.read_text(encoding="utf-8"))] == []


def test_the_citation_file_has_the_version_of_the_distribution() -> None:
    version = tomllib.loads(read("pyproject.toml"))["project"]["version"]
    assert f"\nversion: {version}\n" in read("CITATION.cff")


def test_the_reference_lists_every_key_of_the_json(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    text = read("docs", "reference", "command_line.md")
    for words in (["run", "pendulum", "--until", "0.02", "--no-plots", "--json"], ["verify", "pendulum", "--json"]):
        reported = CliRunner().invoke(app, words)
        assert all(f"`{key}`" in text for key in json.loads(reported.stdout)), words


def test_each_message_of_the_troubleshooting_page_is_one_of_the_code() -> None:
    files = [path for folder in ("dmframe", "blocks") for path in sorted(ROOT.joinpath(folder).rglob("*.py"))]
    code = re.sub(r'"\s*\n\s*f?"', "", "".join(path.read_text(encoding="utf-8") for path in files))
    code = re.sub(r"\{[^{}]*\}", "...", code)
    messages = re.findall(r"(?<!\*)\*([^*\n]+)\*(?!\*)", read("docs", "how_to", "troubleshooting.md"))
    pieces = [piece.strip(" ?,.;") for message in messages for piece in message.split("...")]
    assert len(messages) > 10
    assert [piece for piece in pieces if piece not in code] == []
