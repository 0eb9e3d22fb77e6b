"""``dmframe which``: five questions about a robot and its task, and the graph to take."""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING, Annotated

import typer

from dmframe.cli.streams import tell
from dmframe.common.errors import DmframeError, MissingError

if TYPE_CHECKING:
    from dmframe.graph.which import Guide, Question


def which(
    servo: Annotated[
        str | None, typer.Option(metavar="KIND", help="The joints' servo: stiff, p_pi, soft, torque or unknown.")
    ] = None,
    period: Annotated[str | None, typer.Option(metavar="S", help="Sampling period of the commands: 8 ms.")] = None,
    path: Annotated[
        str | None, typer.Option(metavar="KIND", help="The path of the tool: repeats, varies or stops.")
    ] = None,
    load: Annotated[str | None, typer.Option(metavar="KIND", help="The load: constant or changes.")] = None,
    known: Annotated[
        str | None,
        typer.Option(metavar="WHAT", help="delay: lengths and delay; lengths: these alone; or nothing."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Choose a controller: answer five questions, or give the answers as options.

    A terminal prompts for the other answers; elsewhere all options are required.
    """
    from dmframe.graph.which import guide

    found = guide()
    given = {"servo": servo, "period": period, "path": path, "load": load, "known": known}
    answers = {key: found.questions[key].checked(text) for key, text in given.items() if text is not None}
    missing = [key for key in found.questions if key not in answers]
    if missing and not (sys.stdin.isatty() and sys.stderr.isatty()):
        raise MissingError(
            f"no terminal to ask; give {', '.join(f'--{key}' for key in missing)}, for example:"
            f" dmframe which {' '.join(_example(found, key) for key in found.questions)}"
        )
    answers |= {key: _answer(found.questions[key]) for key in missing}
    selection = found.select(answers)
    tell(json.dumps(selection.summary, indent=2) if as_json else str(selection))


def _example(found: Guide, key: str) -> str:
    default = found.questions[key].default
    return f"--{key} " + (f"'{default}'" if " " in default else default)


def _answer(question: Question) -> str:
    """Ask on the terminal until the answer is one: a choice, its number, or the default for an empty line."""
    names = list(question.choices)
    tell(f"\n{question.text}", aside=True)
    for number, (name, meaning) in enumerate(question.choices.items(), 1):
        tell(f"  {number}  {name:{max(map(len, names))}}  {meaning}", aside=True)
    while True:
        text = str(typer.prompt("answer", default=question.default, err=True)).strip()
        if names and text.isdecimal() and 1 <= int(text) <= len(names):
            text = names[int(text) - 1]
        try:
            return question.checked(text)
        except DmframeError as error:
            tell(error.text, aside=True)
