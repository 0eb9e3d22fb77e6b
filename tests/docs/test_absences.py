"""Each sentence of the docs that denies a feature is compared with the code; a new feature makes it false."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.main import get_command

from dmframe.catalogue import block_types
from dmframe.cli.app import app
from dmframe.virtual import dashboard
from dmframe.virtual.functions import Functions, names_of

DOCS = Path(__file__).parents[2] / "docs"
SECTION = re.compile(
    r"^## (What is not emulated|Not (?:available|supported|simulated|included))\n(.*?)(?=^## |\Z)", re.M | re.S
)


def commands() -> dict[str, set[str]]:
    """Every command of the command line with its options."""
    found = get_command(app).commands  # type: ignore[attr-defined]
    return {name: {option for item in command.params for option in item.opts} for name, command in found.items()}


def packaged(*words: str) -> list[str]:
    """Block types with one of the words in their name or in the first line of their documentation."""
    shape = re.compile("|".join(words), re.IGNORECASE)
    blocks = block_types()
    return [name for name, block in blocks.items() if shape.search(f"{name} {(block.__doc__ or '').splitlines()[0]}")]


def inputs_of(*names: str) -> set[str]:
    """Those of these names that a packaged block has as an input."""
    return {port.name for block in block_types().values() for port in block.inputs} & set(names)


def emulated(*names: str) -> list[str]:
    """Script functions that the virtual robot executes."""
    return [name for name in names if name in names_of(Functions)]


ABSENT: list[tuple[str, str, Callable[[], object]]] = [
    ("how_to/simulink.md", "no canvas", lambda: commands().keys() & {"canvas", "edit", "gui"}),
    (
        "how_to/simulink.md",
        "transfer functions, logic or state machines",
        lambda: packaged("transfer", "logic", "state machine"),
    ),
    (
        "how_to/simulink.md",
        "FMUs cannot be imported",
        lambda: [name for name in commands() if "import" in name] + packaged("fmu"),
    ),
    (
        "how_to/simulink.md",
        "Code is not generated for a particular target",
        lambda: commands()["export"] & {"--target", "--board"},
    ),
    ("how_to/camera.md", "The goal has to be at rest", lambda: inputs_of("dchi_d", "ddchi_d")),
    ("how_to/camera.md", "there is no such block", lambda: packaged("image tracking", "image observer")),
    ("how_to/camera.md", "With uncertain lengths and an uncertain camera", lambda: inputs_of("W_k")),
    ("how_to/reality.md", "Backlash", lambda: packaged("backlash", "ripple", "anti-windup", "thermal")),
    (
        "how_to/virtual_robot.md",
        "Motions: ",
        lambda: emulated("servoc", "movec", "movep", "optimovej", "force_mode", "direct_torque", "freedrive_mode"),
    ),
    (
        "how_to/virtual_robot.md",
        "The dashboard's",
        lambda: [
            name for name in ("load", "play", "pause") if not answer(name).startswith(("Failed", "File not found"))
        ],
    ),
]
"""A page, words of its sentence, and the feature that would make the sentence false."""


def answer(command: str) -> str:
    """An answer of the virtual robot's dashboard."""
    return str(dashboard._COMMANDS[command](None, "a.urp"))


@pytest.mark.parametrize(("page", "words", "there"), ABSENT, ids=[f"{page}: {words}" for page, words, _ in ABSENT])
def test_what_a_page_denies_does_not_exist(page: str, words: str, there: Callable[[], object]) -> None:
    sections = " ".join(text for _, text in SECTION.findall((DOCS / page).read_text(encoding="utf-8")))
    assert words in " ".join(sections.split()), "the sentence has changed: state it here as it is now"
    assert not there()


def test_every_page_with_such_a_section_has_a_test_of_it() -> None:
    with_section = {
        path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md") if SECTION.search(path.read_text("utf-8"))
    }
    studies = {"study/stress.md"}  # names cases that were not run, not features
    assert with_section - studies == {page for page, _, _ in ABSENT}


@pytest.mark.parametrize("line", ["no FMU", "no contact", "FMU in or out"])
def test_no_page_denies_what_exists(line: str) -> None:
    assert not [path.name for path in DOCS.rglob("*.md") if line in path.read_text(encoding="utf-8")]


def test_the_checks_see_features_that_exist() -> None:
    assert "--fmi2" in commands()["export"]
    assert packaged("camera")
    assert inputs_of("x_d")
    assert emulated("speedj")
