"""Arguments and options shared by commands, and shell completion."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final

import typer

from dmframe.common.files import expanded


def home(path: Path | None) -> Path | None:
    """Expand ``~`` in a path, for ``--report=~/x.html``, which no shell expands."""
    return None if path is None else expanded(path)


def graph_names(begin: str) -> list[str]:
    """Shell completion: packaged graphs and graph files."""
    from dmframe.catalogue import graphs as packaged

    folder = Path(begin).parent
    try:
        files = [str(path) for path in folder.iterdir() if path.suffix in (".yaml", ".yml")]
    except OSError:
        files = []
    return [name for name in (*files, *packaged()) if name.startswith(begin)]


def type_names(begin: str) -> list[str]:
    """Shell completion: block types."""
    from dmframe.catalogue import block_modules

    return [name for name in block_modules() if name.startswith(begin)]


def robot_names(begin: str) -> list[str]:
    """Shell completion: packaged robots."""
    from dmframe.robot.library import robots as known

    return [name for name in known() if name.startswith(begin)]


def lesson_numbers(begin: str) -> list[tuple[str, str]]:
    """Shell completion: lesson numbers with titles."""
    from dmframe.lessons import lessons

    return [(str(number), lesson.title) for number, lesson in lessons().items() if str(number).startswith(begin)]


NOTHING: Final[list[str]] = []
"""Default of repeatable options; typer reads it, no code changes it."""
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
        help="Change a value; may be repeated. A.yaml:BLOCK.PARAM=VALUE: for that graph only.",
    ),
]
Trust = Annotated[
    bool,
    typer.Option("--trust", help="Run the code of blocks in the graph's folder, even if written by others."),
]
LimitsFile = Annotated[
    Path | None,
    typer.Option("--limits", metavar="FILE", callback=home, help="Limits narrower than those of the robot."),
]
FigureFormats = Annotated[
    str, typer.Option("--figures", metavar="FORMATS", help="Figures as svg, png, pdf; or several: svg,png.")
]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object (a list for several graphs).")]
Listed = Annotated[bool, typer.Option("--json", help="Print a JSON list.")]

Rank = Annotated[bool, typer.Option("--rank", help="Instead: kinematic parameters for which J_hat keeps its rank.")]
Tube = Annotated[
    str | None,
    typer.Option(metavar="ANGLE", help=f"With --rank: largest deviation of each joint from its path; default: {TUBE}."),
]
Least = Annotated[str | None, typer.Option(metavar="C", help="With --rank: required least singular value.")]
Shape = Annotated[str | None, typer.Option(metavar="SHAPE", help="With --rank: box or ball; default: box.")]
Centre = Annotated[
    str | None,
    typer.Option(metavar="AT", help="With --rank: around the true or the initial values; default: truth."),
]
Scale = Annotated[
    str | None,
    typer.Option(metavar="HOW", help="With --rank: half-widths uniform, or by length; default: uniform."),
]
Boxes = Annotated[
    str | None,
    typer.Option(
        metavar="N",
        help="With --rank: maximum number of boxes; more take longer and find a larger region; default: 40000.",
    ),
]
