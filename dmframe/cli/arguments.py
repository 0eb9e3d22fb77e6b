"""What several commands take, and what a shell completes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final

import typer

from dmframe.files import expanded


def home(path: Path | None) -> Path | None:
    """A path that an option names, ``--report=~/x.html`` too, which no shell expands."""
    return None if path is None else expanded(path)


def graph_names(begin: str) -> list[str]:
    """For a shell's completion: packaged graphs, and graph files."""
    from dmframe.catalogue import graphs as packaged

    folder = Path(begin).parent
    try:
        files = [str(path) for path in folder.iterdir() if path.suffix in (".yaml", ".yml")]
    except OSError:
        files = []
    return [name for name in (*files, *packaged()) if name.startswith(begin)]


def type_names(begin: str) -> list[str]:
    """For a shell's completion: types of blocks."""
    from dmframe.catalogue import block_modules

    return [name for name in block_modules() if name.startswith(begin)]


def robot_names(begin: str) -> list[str]:
    """For a shell's completion: packaged robots."""
    from dmframe.robot.library import robots as known

    return [name for name in known() if name.startswith(begin)]


def lesson_numbers(begin: str) -> list[tuple[str, str]]:
    """For a shell's completion: numbers of lessons, with their titles."""
    from dmframe.lessons import lessons

    return [(str(number), lesson.title) for number, lesson in lessons().items() if str(number).startswith(begin)]


NOTHING: Final[list[str]] = []
"""What an option that may be repeated holds where it is not given; typer reads it, nobody changes it."""
TUBE = "0.05 rad"

Graphs = Annotated[
    list[str],
    typer.Argument(metavar="GRAPH...", help="Graph files, or names of packaged graphs.", autocompletion=graph_names),
]
OneGraph = Annotated[
    str,
    typer.Argument(metavar="GRAPH", help="A graph file, or the name of a packaged graph.", autocompletion=graph_names),
]
Overrides = Annotated[
    list[str],
    typer.Option(
        "--set",
        metavar="BLOCK.PARAM=VALUE",
        help="Change a value; may be repeated. A.yaml:BLOCK.PARAM=VALUE: of that graph alone.",
    ),
]
Trust = Annotated[
    bool,
    typer.Option("--trust", help="Run the code of blocks in the graph's folder, though others may have written it."),
]
LimitsFile = Annotated[
    Path | None,
    typer.Option("--limits", metavar="FILE", callback=home, help="Limits that are narrower than the robot's own."),
]
FigureFormats = Annotated[
    str, typer.Option("--figures", metavar="FORMATS", help="Figures as svg, png, pdf; or several: svg,png.")
]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object (a list for several graphs).")]
Listed = Annotated[bool, typer.Option("--json", help="Print a JSON list.")]

Rank = Annotated[
    bool, typer.Option("--rank", help="Instead: the kinematic parameters with which J_hat keeps its rank.")
]
Tube = Annotated[
    str | None,
    typer.Option(metavar="ANGLE", help="With --rank: how far each joint may be from its path.", show_default=TUBE),
]
Least = Annotated[
    str | None, typer.Option(metavar="C", help="With --rank: the least singular value that is asked for.")
]
Shape = Annotated[str | None, typer.Option(metavar="SHAPE", help="With --rank: box or ball.", show_default="box")]
Centre = Annotated[
    str | None, typer.Option(metavar="AT", help="With --rank: about the truth or the start.", show_default="truth")
]
Scale = Annotated[
    str | None,
    typer.Option(metavar="HOW", help="With --rank: half-widths uniform, or by length.", show_default="uniform"),
]
Boxes = Annotated[
    str | None,
    typer.Option(
        metavar="N",
        help="With --rank: the most boxes; more take longer and find a larger region.",
        show_default="40000",
    ),
]
