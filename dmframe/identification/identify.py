"""``dm.identify``: from a log and a robot to a servo, a delay, friction and base parameters, with intervals."""

from __future__ import annotations

import platform
import shlex
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from dmframe.catalogue import graphs
from dmframe.common.errors import DmframeError, ValueFault
from dmframe.common.version import version
from dmframe.identification.built import built
from dmframe.identification.checked import Checked, checked_log
from dmframe.identification.choose import Choice, chosen
from dmframe.identification.clipped import Limit
from dmframe.identification.columns import signals_of
from dmframe.identification.found import Identified
from dmframe.identification.model import model_of
from dmframe.identification.solve import Fit
from dmframe.identification.table import read_table
from dmframe.identification.torque import MEASURED, factors
from dmframe.identification.twin import Twins, twins_of
from dmframe.identification.verdict import with_verdict
from dmframe.identification.write import set_aside, written
from dmframe.robot.chain import SerialChain
from dmframe.robot.convert import read_any
from dmframe.robot.flange import flange_of
from dmframe.robot.library import load

FAR: Final = 3.0
"""Deviation of an inertial parameter from the robot's file, in standard deviations, above which there is a notice."""
CLEARLY: Final = 0.1
"""Decrease of the sum of the joints' logarithms of residuals with which another reading of the times is used."""
EXPECTED: Final = "three joints take 10 to 40 s of computing, six about two minutes"
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
    try:
        found = _identified(log, robot, columns, out, say)
    except Exception:
        if out is not None:
            set_aside(Path(out))
        raise
    if out is not None:
        written(found, Path(out))
    return with_verdict(found, None if out is None else Path(out), say) if verdict else found


def _identified(
    log: str | Path,
    robot: str | SerialChain,
    columns: Sequence[str],
    out: str | Path | None,
    say: Callable[[str], None],
) -> Identified:
    chain = robot if isinstance(robot, SerialChain) else chain_of(robot)
    table = read_table(log, chain.joint_names)
    signals, used = signals_of(table, chain.n, columns)
    needed = {name: values for name, values in signals.items() if name not in MEASURED}
    checked, twins = checked_log(needed, chain, table.name), twins_of(model_of(chain))
    say(EXPECTED)
    choice, notices = _read(twins, checked, say)
    if checked.limits:  # a command between the first and the estimated limit was clipped wrongly
        checked = checked.again(estimated(checked.limits, choice.fits[choice.best]))
        choice, notices = _read(twins, checked, say)
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
        "samples": len(checked.log.time),
        "period": checked.log.period,
    }
    engine = (twins.notice,) if twins.notice else ()
    columns_used = "columns: " + ", ".join(f"{a} = {b}" for a, b in used.items())
    found = built(Identified(choice, (*engine, columns_used, *notices), about, limits=checked.limits), twins)
    if found.known:
        found = replace(found, torques=factors(found.fit, signals))
    _determined(found, table.name)
    return replace(found, notices=(*found.notices, *_doubts(found), *_above(found)))


def _read(twins: Twins, checked: Checked, say: Callable[[str], None]) -> tuple[Choice, tuple[str, ...]]:
    """The candidates, with the reading of irregular times that explains the log best; and notices."""
    choice, notices = chosen(twins, checked.log, say), checked.notices
    for other, text in checked.others:
        if choice.sharp(choice.best):
            break
        say(f"other reading of the times: {text}")
        again = chosen(twins, other, say)
        if again.left < choice.left - CLEARLY:
            choice, notices = again, (*checked.notices, text)
    return choice, notices


def estimated(limits: tuple[Limit, ...], fit: Fit) -> tuple[Limit, ...]:
    """The limits of the commands after a fit."""
    change = fit.theta[fit.unknowns.places["command"]]
    return tuple(replace(limit, speed=limit.speed + float(own)) for limit, own in zip(limits, change, strict=False))


def chain_of(robot: str) -> SerialChain:
    """The chain of a robot's name, a URDF file, or a graph: a file or a packaged one.

    The chain of a URDF file ends at the flange, before the fingers of a gripper, as in a graph that `new` writes.
    """
    if robot.endswith((".yaml", ".yml")) or robot in graphs():
        from dmframe.graph.graph import Graph

        chain = Graph.read(robot).diagram.robot
        if not isinstance(chain, SerialChain):
            raise ValueFault(f"{robot}: expected a graph with a robot, found none")
        return chain
    tool = None
    if robot.lower().endswith(".urdf"):
        with suppress(DmframeError):  # `load` reports a file that cannot be read, or a robot with several arms
            tool = flange_of(read_any(Path(robot).expanduser()).root, robot)
    return load(robot, base=Path(), tool=tool)


def _doubts(found: Identified) -> Iterator[str]:
    """A notice if the inertial parameters are far from those of the robot's file."""
    own = found.fit.theta[found.fit.unknowns.places["beta"]]
    if found.known and (most := float(np.max(np.abs(own)))) > FAR:
        yield (
            f"the inertial parameters deviate from the robot's file by {most:.2g} standard deviations (30 % of each "
            "mass, 3 kg at the tool): check that the log is of this robot, with this tool and mounting"
        )


def _above(found: Identified) -> Iterator[str]:
    """A notice if the fit leaves more than noise."""
    if found.known and found.above > 1:
        yield (
            f"the residual is up to {found.above:.2g} times the noise, also from other starts: intervals are widened "
            "by this factor"
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
