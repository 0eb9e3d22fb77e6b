"""The commands about what there is: graphs, robots, blocks, lessons, schemas; thin calls of the library, as those of
`dmframe.cli.app`.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dmframe.cli.arguments import Listed, graph_names, home, lesson_numbers, robot_names, type_names
from dmframe.cli.streams import tell
from dmframe.errors import UnknownNameError
from dmframe.files import write_text

if TYPE_CHECKING:
    from dmframe.graph.named import Named

SCHEMA = "dmframe.schema.json"
"""Beside a new graph; the editors' YAML server finds it by the graph's first line."""


def graphs(as_json: Listed = False) -> None:
    """List the packaged graphs, with how long each runs, its clock and its title."""
    from dmframe.graph import graphs as shelf

    _tell_shelf(shelf(), as_json)


def robots(
    name: Annotated[
        str | None, typer.Argument(metavar="NAME", help="Print this robot's page.", autocompletion=robot_names)
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON, a list or the one robot.")] = False,
) -> None:
    """List the robots that come with the installed packages, or print one's joints, masses, tool and known errors."""
    from dmframe.graph import robots as shelf
    from dmframe.graph.robot_page import robot_data, robot_page

    if name is None:
        _tell_shelf(shelf(), as_json)
    else:
        tell(json.dumps(robot_data(name), indent=2) if as_json else robot_page(name))


def _tell_shelf(shelf: Named[Any], as_json: bool) -> None:
    tell(json.dumps(shelf.summary, indent=2) if as_json else str(shelf))


def new(
    name: Annotated[str, typer.Argument(help="A packaged graph, as a start.", autocompletion=graph_names)],
    file: Annotated[Path | None, typer.Argument(callback=home, help="The new file; NAME.yaml without it.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Write over a file that is there.")] = False,
) -> None:
    """Copy a packaged graph to a file of your own, to edit it; an editor completes it from the schema beside it."""
    from dmframe.catalogue import graphs as packaged
    from dmframe.config.schema import json_schema

    known = packaged()
    if name not in known:
        raise UnknownNameError(name, "graph", name, known)
    target = file or Path(f"{name}.yaml")
    text = known[name].read_text(encoding="utf-8")
    write_text(target, f"# yaml-language-server: $schema={SCHEMA}\n{text}", new=not force)
    write_text(target.with_name(SCHEMA), json.dumps(json_schema(), indent=1) + "\n")
    tell(f"wrote {target}; try: dmframe run {target}")


def blocks(
    kind: Annotated[
        str | None, typer.Argument(metavar="TYPE", help="Print this block's page.", autocompletion=type_names)
    ] = None,
    as_json: Listed = False,
) -> None:
    """List the block types, or print one block's page."""
    from dmframe.catalogue import block_types, find_block
    from dmframe.cli.options import refuse
    from dmframe.graph import blocks as shelf
    from dmframe.graph.pages import block_list, block_page

    if kind is not None:
        refuse({"--json": as_json}, "a block's page is text; leave the type out for a list")
        tell(block_page(find_block(kind, Path(), "blocks")))
    elif as_json:
        _tell_shelf(shelf(), as_json)
    else:
        tell(block_list(block_types()))


def learn(
    lesson: Annotated[
        str | None, typer.Argument(metavar="LESSON", help="Open this one.", autocompletion=lesson_numbers)
    ] = None,
    read: Annotated[bool, typer.Option("--read", help="Print it instead of writing a notebook.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Write over a notebook that is there.")] = False,
    as_json: Listed = False,
) -> None:
    """List the lessons of the course, or open one: write it as a notebook into this folder."""
    from dmframe.cli.learn import list_lessons, open_lesson
    from dmframe.cli.options import refuse

    if lesson is None:
        refuse({"--read": read, "--force": force}, "it does nothing without a lesson; name one")
        list_lessons(as_json=as_json)
    else:
        refuse({"--json": as_json}, "it does nothing with a lesson; leave the lesson out for a list")
        refuse({"--force": force and read}, "it does nothing with --read; leave one out")
        open_lesson(lesson, read=read, force=force)


def schema(
    verdict: Annotated[bool, typer.Option("--verdict", help="Of what verify --json prints, instead.")] = False,
    study: Annotated[bool, typer.Option("--study", help="Of study files, instead.")] = False,
) -> None:
    """Print the JSON Schema of graph files, for an editor."""
    from dmframe.certify.schema import verdict_schema
    from dmframe.cli.options import refuse
    from dmframe.config.schema import json_schema
    from dmframe.study.grammar import study_schema

    refuse({"--study": study and verdict}, "it does nothing with --verdict; leave one out")
    made = study_schema() if study else verdict_schema() if verdict else json_schema()
    tell(json.dumps(made, indent=2))
