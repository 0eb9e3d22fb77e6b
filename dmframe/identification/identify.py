"""``dm.identify``: from a log and a robot to a servo, a delay, friction and base parameters, with intervals."""

from __future__ import annotations

import platform
import shlex
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from dmframe.catalogue import graphs
from dmframe.common.errors import ValueFault
from dmframe.common.version import version
from dmframe.identification.checked import checked_log
from dmframe.identification.choose import chosen
from dmframe.identification.columns import signals_of
from dmframe.identification.found import Identified
from dmframe.identification.model import model_of
from dmframe.identification.table import read_table
from dmframe.identification.twin import twins_of
from dmframe.identification.verdict import with_verdict
from dmframe.identification.write import written
from dmframe.robot.chain import SerialChain
from dmframe.robot.library import load

FAR: Final = 3.0
"""Deviation of an inertial parameter from the robot's file, in standard deviations, above which there is a notice."""
UNSURE: Final = 0.35
"""Largest relative standard deviation of a servo's main gain that counts as determined."""


def identify(
    log: str | Path,
    robot: str | SerialChain,
    *,
    columns: Sequence[str] = (),
    out: str | Path | None = None,
    verdict: bool = False,
    say: Callable[[str], None] = lambda text: None,
) -> Identified:
    """Identify a robot's closed servo from a log of commands and positions.

    Every class of servo is simulated with the robot along the commands (output error), its delay continuous, and fitted
    to the positions by Gauss-Newton; the class with the smallest information criterion is reported, or `unknown` if no
    class leaves a residual near the noise.

    Parameters
    ----------
    log
        CSV or Parquet: time [s], positions [rad], and commanded velocities [rad/s] or positions [rad].
    robot
        A robot's name, a URDF file, a graph whose robot is taken, or a chain.
    columns
        ``name=column`` for columns whose names are not guessed.
    out
        Folder to which ``identified.json``, the page ``report.html``, the robot ``twin.urdf`` and the graph
        ``twin.yaml`` are written.
    verdict
        Whether an adaptive law is compared with tuned laws without a model on the identified robot, which takes about a
        minute; with `out`, the comparison is kept there as a race, ``verdict.yaml``.
    say
        Called with a line of progress.

    Raises
    ------
    DmframeError
        The robot or the log cannot be used; the text has the place and the remedy.

    Examples
    --------
    >>> import dmframe as dm
    >>> found = dm.identify("log.csv", "ur10")           # doctest: +SKIP
    >>> found.kind, found.delay                          # doctest: +SKIP
    """
    chain = robot if isinstance(robot, SerialChain) else chain_of(robot)
    table = read_table(log, chain.joint_names)
    signals, used = signals_of(table, chain.n, columns)
    record, notices = checked_log(signals, chain, table.name)
    twins = twins_of(model_of(chain))
    choice = chosen(twins, record, say)
    given = chain.name if isinstance(robot, SerialChain) else robot
    options = [word for column in columns for word in ("--columns", column)]
    about = {
        "command": shlex.join(["dmframe", "identify", str(log), given, *options, "--out", str(out or "identified")]),
        "dmframe": version(),
        "python": platform.python_version(),
        "log": table.name,
        "sha256": table.digest,
        "robot": chain.name,
        "columns": used,
        "samples": len(record.time),
        "period": record.period,
    }
    engine = (twins.notice,) if twins.notice else ()
    columns_used = "columns: " + ", ".join(f"{a} = {b}" for a, b in used.items())
    found = Identified(choice, (*engine, columns_used, *notices), about)
    _determined(found, table.name)
    found = replace(found, notices=(*found.notices, *_doubts(found)))
    if out is not None:
        written(found, Path(out))
    return with_verdict(found, None if out is None else Path(out), say) if verdict else found


def chain_of(robot: str) -> SerialChain:
    """The chain of a robot's name, a URDF file, or a graph: a file or a packaged one."""
    if robot.endswith((".yaml", ".yml")) or robot in graphs():
        from dmframe.graph.graph import Graph

        chain = Graph.read(robot).diagram.robot
        if not isinstance(chain, SerialChain):
            raise ValueFault(f"{robot}: expected a graph with a robot, found none")
        return chain
    return load(robot, base=Path())


def _doubts(found: Identified) -> Iterator[str]:
    """A notice if the inertial parameters are far from those of the robot's file."""
    own = found.fit.theta[found.fit.unknowns.places["beta"]]
    if found.known and (most := float(np.max(np.abs(own)))) > FAR:
        yield (
            f"the inertial parameters deviate from the robot's file by {most:.2g} standard deviations (30 % of each "
            "mass, 3 kg at the tool): check that the log is of this robot, with this tool and mounting"
        )


def _determined(found: Identified, where: str) -> None:
    """Raise `ValueFault` if the log does not determine the main gain of a joint."""
    if not found.known:
        return
    name = {"pi": "k_I", "pid": "k_P"}.get(found.choice.best, "k_p")
    value, limits = found.positive(name)
    for j, (low, high) in enumerate(limits):
        if high > low * (1 + UNSURE) / (1 - UNSURE) * (1 + UNSURE) ** 2:
            text = (
                f"joint {j + 1}: the log determines {name} only within {low:.3g} to {high:.3g} 1/s around "
                f"{value[j]:.3g}; record velocity steps of every joint for 20 s"
            )
            raise ValueFault(text, location=where)
