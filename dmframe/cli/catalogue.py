"""Commands that list graphs, robots, blocks, lessons and schemas."""

from __future__ import annotations

import difflib
import json
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dmframe.cli.arguments import NOTHING, Listed, graph_names, home, lesson_numbers, robot_names, type_names
from dmframe.cli.streams import tell
from dmframe.common.errors import LISTS, UnknownNameError
from dmframe.common.files import check_new, contains, write_text

if TYPE_CHECKING:
    from dmframe.config.registry import Registry

SCHEMA = "dmframe.schema.json"
"""Schema file next to a new graph; the YAML server of an editor finds it by the graph's first line."""
NEW = (1, 7)
"""Axes of a robot for which `new` writes a graph."""


def graphs(as_json: Listed = False) -> None:
    """List the packaged graphs with duration, clock and title."""
    from dmframe.graph.registries import graphs as registry

    _print(registry(), as_json)


def robots(
    name: Annotated[
        str | None, typer.Argument(metavar="NAME", help="Print this robot's page.", autocompletion=robot_names)
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON, a list or the one robot.")] = False,
) -> None:
    """List the packaged robots, or print joints, masses, tool and known errors of one."""
    if name is None:
        from dmframe.graph.registries import robots as registry

        _print(registry(), as_json)
    else:
        from dmframe.graph.robot_page import robot_data, robot_page

        tell(json.dumps(robot_data(name), indent=2) if as_json else robot_page(name))


def _print(registry: Registry[Any], as_json: bool) -> None:
    tell(json.dumps(registry.summary, indent=2) if as_json else str(registry))


def new(
    name: Annotated[
        str,
        typer.Argument(
            help="A packaged graph to copy; or a robot: a name, or a URDF, xacro or MJCF file.",
            autocompletion=graph_names,
        ),
    ],
    file: Annotated[Path | None, typer.Argument(callback=home, help="The new file; NAME.yaml without it.")] = None,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", metavar="FILE", callback=home, help="The new file, as an option.")
    ] = None,
    tool: Annotated[str | None, typer.Option(metavar="FRAME", help="Tool frame of the robot; default: flange.")] = None,
    hold: Annotated[
        list[str],
        typer.Option(metavar="JOINT=POSITION", help="Hold a joint of the robot at an angle or a length; repeatable."),
    ] = NOTHING,
    force: Annotated[bool, typer.Option("--force", help="Overwrite an existing file.")] = False,
) -> None:
    """Copy a packaged graph, or write a first graph for a robot, with the schema for completion in an editor."""
    from dmframe.catalogue import graphs as packaged
    from dmframe.cli.options import angles, refuse
    from dmframe.config.schema import json_schema
    from dmframe.graph.first import first_graph, is_robot
    from dmframe.robot.library import robots as packaged_robots

    refuse({"--out": out if file is not None else None}, "the new file is given twice; leave one out")
    known, notes = packaged(), tuple[str, ...]()
    target = file or out or Path(f"{Path(name).name.partition('.')[0]}.yaml")
    if name in known:
        refuse({"--tool": tool is not None, "--hold": bool(hold)}, "a packaged graph has its own; name a robot")
        text = known[name].read_text(encoding="utf-8")
    elif is_robot(name):
        made = first_graph(name, target.parent, tool, angles("--hold", hold), axes=NEW, stem=target.stem)
        text, notes = made.text, made.notes
        if not force:
            check_new(target)  # before the robot's file is written
        for model, content in made.robot.items():
            place = target.with_name(model)
            if contains(place, content):
                continue  # from an earlier call
            write_text(place, content, new=not force)
            notes = (f"wrote {place}, a copy of the robot with the changes below, which the graph reads", *notes)
    else:
        # a graph may be a misspelt one; a robot is never the spelling of another one
        misspelt = bool(difflib.get_close_matches(name, known, n=1, cutoff=0.6))
        choices = known if misspelt else [*known, *packaged_robots()]
        kind = "graph" if misspelt else "graph or robot"
        raise UnknownNameError(name, kind, name, choices, spelling=misspelt, others=LISTS)
    write_text(target, f"# yaml-language-server: $schema={SCHEMA}\n{text}", new=not force)
    write_text(target.with_name(SCHEMA), json.dumps(json_schema(), indent=1) + "\n")
    for note in notes:
        tell(note)
    tell(f"wrote {target}; try: dmframe run {target}")
    if name not in known:
        tell(f"then: dmframe verify {target}; dmframe run {target} --baseline, the same gain without adaptation")
        chosen = [*(["--tool", tool] if tool else []), *(word for item in hold for word in ("--hold", item))]
        tell(f"tuned and compared with other laws: {shlex.join(['dmframe', 'design', name, *chosen])} --out DIR")


def blocks(
    kind: Annotated[
        str | None, typer.Argument(metavar="TYPE", help="Print this block's page.", autocompletion=type_names)
    ] = None,
    as_json: Listed = False,
) -> None:
    """List the block types, or print one block's page."""
    from dmframe.catalogue import block_types, find_block
    from dmframe.cli.options import refuse
    from dmframe.graph.pages import block_list, block_page
    from dmframe.graph.registries import blocks as registry

    if kind is not None:
        refuse({"--json": as_json}, "a block's page is text; leave the type out for a list")
        tell(block_page(find_block(kind, Path(), "blocks")))
    elif as_json:
        _print(registry(), as_json)
    else:
        tell(block_list(block_types()))


def learn(
    lesson: Annotated[
        str | None, typer.Argument(metavar="LESSON", help="Open this one.", autocompletion=lesson_numbers)
    ] = None,
    read: Annotated[bool, typer.Option("--read", help="Print it instead of writing a notebook.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Overwrite an existing notebook.")] = False,
    as_json: Listed = False,
) -> None:
    """List the lessons of the course, or open one: write it as a notebook into this folder."""
    from dmframe.cli.learn import list_lessons, open_lesson
    from dmframe.cli.options import refuse

    if lesson is None:
        refuse({"--read": read, "--force": force}, "it has no effect without a lesson; name one")
        list_lessons(as_json=as_json)
    else:
        refuse({"--json": as_json}, "it has no effect with a lesson; leave the lesson out for a list")
        refuse({"--force": force and read}, "it has no effect with --read; leave one out")
        open_lesson(lesson, read=read, force=force)


def schema(
    verdict: Annotated[bool, typer.Option("--verdict", help="Schema of verify --json instead.")] = False,
    study: Annotated[bool, typer.Option("--study", help="Schema of study files instead.")] = False,
    race: Annotated[bool, typer.Option("--race", help="Schema of race files instead.")] = False,
) -> None:
    """Print the JSON Schema of graph files, or of others, for an editor."""
    from dmframe.certify.schema import verdict_schema
    from dmframe.cli.options import refuse
    from dmframe.config.schema import json_schema
    from dmframe.race.grammar import race_schema
    from dmframe.study.grammar import study_schema

    refuse({"--study": study and verdict, "--race": race and verdict}, "it has no effect with --verdict; leave one out")
    refuse({"--race": race and study}, "it has no effect with --study; leave one out")
    made = race_schema() if race else study_schema() if study else verdict_schema() if verdict else json_schema()
    tell(json.dumps(made, indent=2))
