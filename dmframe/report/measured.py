"""Simulation of the graph, and V along it, for a report."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, final

import numpy as np

from dmframe.certify import Verdict
from dmframe.common.errors import DmframeError
from dmframe.common.plotting import figure_svg
from dmframe.common.units import plain
from dmframe.config import BaseGraph
from dmframe.exact.rational import as_float
from dmframe.results.along import StorageTrace, along
from dmframe.results.metrics import tracking_error, turn_error
from dmframe.results.storage_figure import StoragePicture, storage_picture
from dmframe.simulate import Log, Recording

ROUNDING = 1e-6
"""Relative increase of V, of its initial value, that the integration error explains."""

INSTANTS = 9
"""Rows in the table of V over time."""


@final
@dataclass(frozen=True)
class Measured:
    """Result of the simulated run.

    Parameters
    ----------
    sentence
        Marked text: relation between theorem and run, and whether V rose.
    facts
        Rows of a table, marked texts.
    numbers
        The facts as plain data.
    figure
        SVG, or empty.
    table
        Instants [s] with V, for a page without figures.
    run
        The recorded signals, for other sections; None if the graph could not be simulated.
    """

    sentence: str
    facts: tuple[tuple[str, str], ...] = ()
    numbers: Mapping[str, Any] = field(default_factory=dict)
    figure: str = ""
    caption: str = ""
    table: tuple[tuple[float, float], ...] = ()
    run: Recording | None = None


def measure(graph: BaseGraph, verdict: Verdict, tell: Callable[[str], None] = lambda _: None) -> Measured:
    """Simulate the graph for the duration in its file, and evaluate V along the run if it is defined."""
    clock = graph.file.clock
    tell(f"simulating {plain(graph.file.duration, 's')}")
    try:
        run = graph.simulate(graph.diagram, log=Log())
    except DmframeError as error:
        return Measured(f"{_sentence(clock, verdict)} The graph could not be simulated: {error.text}.")
    facts, numbers = _run_facts(run)
    tell("evaluating V along the run")
    found, why = _along(verdict, run)
    if found is None:
        return Measured(f"{_sentence(clock, verdict)} {why}", tuple(facts), numbers, run=run)
    more, v_numbers = _v_facts(found, clock)
    over = verdict.samples is not None
    kept = np.unique(np.linspace(0, found.time.size - 1, INSTANTS).astype(int))
    names = [rf"${term.of.latex}$ ({term.block})" for term in found.terms]
    return Measured(
        sentence=f"{_sentence(clock, verdict)} {_judged_over_samples(found) if over else _judged(found, clock)}",
        facts=(*facts, *more),
        numbers={**numbers, **v_numbers},
        figure=figure_svg(storage_picture(StoragePicture(found, names), run)),
        caption="$V$ along the simulated run (above), and its largest terms, each with its weight (below).",
        table=tuple((float(found.time[k]), float(found.V[k])) for k in kept),
        run=run,
    )


def _sentence(clock: float | None, verdict: Verdict) -> str:
    if verdict.samples is not None:
        return (
            "The theorem is in discrete time and covers the estimates, not the distance of the robot from its path. "
            "The figures below are measured on one simulation, from one start, along one path."
        )
    if clock is None:
        return (
            "The theorem and this graph are in continuous time: the simulation differs from the theorem's loop by the "
            "integration error only."
        )
    return (
        f"The theorem holds in continuous time; this controller runs every {plain(clock, 's')} and holds its commands "
        "in between (zero-order hold). The sampled loop is not proved. The figures below are measured on one "
        "simulation of it, from one start, along one path."
    )


def _judged(found: StorageTrace, clock: float | None) -> str:
    if not found.largest_increase:
        return "Along the run $V$ never rose from one sample to the next."
    ratio = found.largest_increase / found.V[0] if found.V[0] else float("inf")
    rose = (
        f"Along the run $V$ rose from one sample to the next in {found.rises} of {found.steps.size} cases, by at most "
        f"{found.largest_increase:.3g}, which is {100 * ratio:.2g} % of $V$ at the start. {_climbed(found)}"
    )
    if clock is not None:
        return rose + "The theorem holds in continuous time; in a sampled loop $V$ may rise."
    if ratio <= ROUNDING:
        return rose + "An increase of this size is within the integration error."
    return rose + (
        "**Warning**: if all assumptions of the theorem hold, $V$ does not rise. Either this run violates an "
        "assumption, or the integration step is too long: repeat the run with a smaller step."
    )


def _judged_over_samples(found: StorageTrace) -> str:
    """Rises of V against what the claim over samples allows."""
    which = f"$V$ is evaluated {found.about}. " if found.about else ""
    rose = f"Along the run $V$ rose from one sample to the next in {found.rises} of {found.steps.size} cases. "
    rose = f"{which}{rose}{_climbed(found)}" if found.rises else f"{which}Along the run $V$ never rose. "
    if not found.residual.size:
        return rose
    if not found.beyond:
        return rose + "At no sample did it rise by more than its theorem allows."
    return rose + (
        f"**Warning**: at {found.beyond} samples it rose by more than its theorem allows, so this run violates an "
        "assumption."
    )


def _climbed(found: StorageTrace) -> str:
    """Largest rise of V above an earlier value, as a fraction of its fall."""
    climb = found.climb
    if climb.since is None or climb.until is None:
        return "That is within rounding. "
    fraction = "" if climb.fraction is None else f", which is {100 * climb.fraction:.3g} % of its fall"
    between = f"between {plain(climb.since, 's')} and {plain(climb.until, 's')}"
    jumps = f"; its {len(found.jumps)} jumps at the steps of a source are excluded" if found.jumps else ""
    return f"It rose by {climb.rise:.3g} {between}{fraction}{jumps}. "


def _run_facts(run: Recording) -> tuple[list[tuple[str, str]], dict[str, Any]]:
    end, error, turn = "reached its end", tracking_error(run), turn_error(run)
    if run.divergence is not None:
        end = f"diverged: `{run.divergence.block}.{run.divergence.state}` {run.divergence.how}"
    facts = [("simulated time", f"{plain(float(run.time[-1]), 's')} of {plain(run.duration, 's')}; the run {end}")]
    numbers: dict[str, Any] = {"simulated": float(run.time[-1]), "diverged": run.divergence is not None}
    if error is not None:
        rms = [f"{value:.3g}" if value is not None else "-" for value in error.rms_by_eighth]
        facts.append((f"RMS of $|{error.signal.latex}|$ over each eighth of the run, {error.unit}", ", ".join(rms)))
        numbers["rms_by_eighth"] = list(error.rms_by_eighth)
        if (prismatic := error.prismatic) is not None:
            rms = [f"{value:.3g}" if value is not None else "-" for value in prismatic.rms_by_eighth]
            facts.append((f"the same of the prismatic joints, {prismatic.unit}", ", ".join(rms)))
            numbers["prismatic_rms_by_eighth"] = list(prismatic.rms_by_eighth)
    if turn is not None:
        rms = [f"{value:.3g}" if value is not None else "-" for value in turn.rms_by_eighth]
        about = f"RMS of the angle between $R$ and $R_d$ over each eighth of the run, {turn.unit}"
        facts.append((about, ", ".join(rms)))
        numbers["turn_rms_by_eighth"] = list(turn.rms_by_eighth)
    facts += [("notice", notice) for notice in run.notices]
    return facts, numbers


def _along(verdict: Verdict, run: Recording) -> tuple[StorageTrace | None, str]:
    claim = verdict.claim
    if claim is None:
        return None, "A graph without a certificate has no $V$."
    if verdict.outcome == "refuted":
        return None, "$V$ is not shown, since its certificate is refuted."
    if claim.cascaded and verdict.kappa is None:
        return (
            None,
            "$V$ is not shown, since no weight $\\kappa$ makes its derivative negative at these parameter values.",
        )
    try:
        return along(claim, run, as_float(verdict.kappa.chosen) if verdict.kappa else 1.0), ""
    except DmframeError as error:
        return None, f"$V$ is not shown: {error.text}."


def _v_facts(found: StorageTrace, clock: float | None) -> tuple[list[tuple[str, str]], dict[str, Any]]:
    every, climb = "sample" if clock is not None else "recorded instant", found.climb
    facts = [
        ("$V$ at the start and at the end", f"{found.V[0]:.6g} and {found.V[-1]:.6g}"),
        (f"largest increase of $V$ from one {every} to the next", _increase(found)),
        (f"steps in which $V$ rose, of {found.steps.size}", str(found.rises)),
        ("largest rise of $V$ above an earlier value, and its fall", f"{climb.rise:.3g} and {climb.fall:.3g}"),
    ]
    if found.residual.size:
        facts.append(("samples at which $V$ rose by more than its theorem allows", str(found.beyond)))
    kept = np.unique(np.linspace(0, found.time.size - 1, 201).astype(int))
    numbers = {
        "V_start": float(found.V[0]),
        "V_end": float(found.V[-1]),
        "largest_increase": found.largest_increase,
        "largest_increase_at": found.increase_at,
        "rises": found.rises,
        "steps": int(found.steps.size),
        "rise": climb.rise,
        "rise_share": climb.fraction,
        "rise_from": climb.since,
        "rise_until": climb.until,
        "fall": climb.fall if np.isfinite(climb.fall) else None,
        "jumps": [[jump.time, jump.change] for jump in found.jumps],
        "beyond": found.beyond if found.residual.size else None,
        "constants": {label: list(values) for label, values in found.constants.items()},
        "kappa": found.kappa,
        "time": [float(t) for t in found.time[kept]],
        "V": [float(v) if np.isfinite(v) else None for v in found.V[kept]],
    }
    return facts, numbers


def _increase(found: StorageTrace) -> str:
    if found.increase_at is None:
        return "none"
    return f"{found.largest_increase:.3g}, at t = {plain(found.increase_at, 's')}"
