"""Groups of commands in ``dmframe --help``, each command with a summary of one line."""

from __future__ import annotations

from typing import Any, Final, final

from typer.core import TyperGroup

GROUPS: Final[dict[str, dict[str, str]]] = {
    "Start": {
        "demo": "Open a live page: a controller next to its rivals.",
        "design": "Design a controller for a robot.",
        "which": "Choose a controller by five questions.",
        "new": "Copy a packaged graph, or write one for a robot.",
        "path": "Write a recorded path as a block for a graph.",
        "graphs": "List the packaged graphs.",
        "robots": "List the packaged robots, or describe one.",
        "blocks": "List the block types, or describe one.",
        "learn": "List the lessons of the course, or open one.",
    },
    "One graph": {
        "check": "Build a graph; print blocks, wires, shapes, units.",
        "explain": "Describe a graph and its certificate in sentences.",
        "run": "Simulate graphs; write signals, figures, a summary.",
        "studio": "Edit a graph in a browser, with its verdict.",
        "draw": "Draw the block diagram.",
        "page": "Write a live page that simulates in a browser.",
    },
    "Proof and analysis": {
        "verify": "Prove dV/dt for all gains, and check the conditions.",
        "audit": "Compare the files of a folder with its graph's model.",
        "analyse": "Linearise: margins, poles, largest stable period.",
        "regressor": "Print or write the regressor of a robot; prove it.",
    },
    "Many runs": {
        "race": "Tune several laws by one protocol and compare them.",
        "study": "Run a graph with varied parameters.",
        "tune": "Optimise parameters over the plants of a study.",
    },
    "A real or a virtual robot": {
        "experiment": "Propose an excitation for identify.",
        "identify": "Identify servo, delay and friction from a log.",
        "delay": "Identify the delay of a graph's robot in samples.",
        "rehearse": "Simulate delay, jitter, lost samples and a load.",
        "drive": "Drive a robot through the gate.",
        "replay": "Recompute the commands of a drive; report differences.",
        "robot": "Serve a virtual UR robot with a hidden servo.",
        "export": "Write the controller as C, FMU or for ROS 2.",
    },
    "Files": {
        "schema": "Print the JSON Schema of a kind of files.",
    },
}
"""Commands by group, in the order of the help."""
OTHER: Final = "Other"
"""Group of a command that no group has."""


def grouped(names: list[str]) -> dict[str, list[str]]:
    """The given commands by group."""
    known = {group: [name for name in rows if name in names] for group, rows in GROUPS.items()}
    found = {name for rows in known.values() for name in rows}
    rest = {OTHER: [name for name in names if name not in found]}
    return {group: rows for group, rows in (known | rest).items() if rows}


@final
class GroupedCommands(TyperGroup):
    """Prints the commands in groups, with whole summaries."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """One section for each group."""
        commands = {name: self.get_command(ctx, name) for name in self.list_commands(ctx)}
        shown = [name for name, command in commands.items() if command is not None and not command.hidden]
        width = max(map(len, shown), default=0)
        for group, names in grouped(shown).items():
            with formatter.section(group):
                rows = GROUPS.get(group, {})
                texts = {name: rows.get(name) or _sentence(commands[name]) for name in names}
                formatter.write_dl([(name.ljust(width), text) for name, text in texts.items()])


def _sentence(command: Any) -> str:
    """The first paragraph of a command's help."""
    return " ".join((command.help or "").split("\n\n")[0].split())
