"""Summary of a run, as in ``run --json`` and ``summary.json``."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from dmframe.common.errors import DmframeError
from dmframe.common.units import plain
from dmframe.results.metrics import Deviation, TrackingError, tracking_error, turn_error
from dmframe.results.reported import reported_estimates
from dmframe.results.storage import no_storage
from dmframe.simulate import Recording

if TYPE_CHECKING:
    from dmframe.results.run import Run


def summary_of(run: Run, out: str | None = None) -> dict[str, Any]:
    """`summary` with V and its warning."""
    try:
        storage = run.storage.summary
    except DmframeError as error:
        storage = no_storage(error)
    data = summary(run.graph.name, run.recording, out)
    out = data.pop("out")
    bounds = {"bounds": run.bounds, "bounds_missing": run.bounds_missing}
    return {**data, "storage": storage, **bounds, "notices": list(run.notices), "out": out}


def summary(name: str, run: Recording, out: str | None = None) -> dict[str, Any]:
    """Metrics of a run as JSON data; non-finite numbers become None.

    Parameters
    ----------
    name
        Name of the graph.
    out
        Results folder, if any.
    """
    error, turn = tracking_error(run), turn_error(run)
    return {
        "graph": name,
        "duration": _number(run.duration),
        "clock": "continuous" if run.clock is None else _number(run.clock),
        "diverged": run.divergence is not None,
        "divergence": None if run.divergence is None else str(run.divergence),
        "interrupted": run.interrupted,
        "error": _error(error),
        "turn": _error(turn),
        "rank": [
            {"signal": rank.signal, "unit": rank.unit}
            | {key: _number(getattr(rank, key)) for key in ("smallest", "time", "share", "since")}
            for rank in run.ranks
        ],
        "shown": [
            {"signal": item.label, "says": item.words, "unit": item.unit}
            | {
                "values": list(map(_number, item.values)),
                "felt": item.excitation and list(map(_number, item.excitation)),
            }
            for item in reported_estimates(run)
        ],
        "engine": run.engine,
        "solver": _solver(run),
        "wall_time": _number(run.wall_time),
        "real_time_factor": _number(run.real_time_factor),
        "notices": list(run.notices),
        "out": out,
    }


def integrated(run: Recording) -> list[str]:
    """Method, step and estimated error of the joints; empty without an estimate."""
    method, step, estimate = run.solver.method, run.step, run.estimate
    if estimate is None or step is None or not math.isfinite(estimate.error):
        return []
    error = f"{estimate.error:.1g} {estimate.unit}"
    return [f"{method} in steps of {plain(step, 's')}, estimated error of the joints {error}"]


def _solver(run: Recording) -> dict[str, Any]:
    """Method, step [s] of a fixed-step method, and estimated error of the joints by integration."""
    estimate, found = run.estimate, {"method": run.solver.method, "step": _number(run.step)}
    if estimate is None:
        return found | {"error": None, "unit": None, "share": None}
    return found | {"error": _number(estimate.error), "unit": estimate.unit, "share": _number(estimate.share)}


def _error(error: Deviation | None) -> dict[str, Any] | None:
    if error is None:
        return None
    rms = [_number(value) for value in error.rms_by_eighth]
    found = {"signal": error.signal, "unit": error.unit, "rms_by_eighth": rms, "rms_final": rms[-1]}
    prismatic = error.prismatic if isinstance(error, TrackingError) else None
    return found if prismatic is None else found | {"prismatic": _error(prismatic)}


def _number(value: float | None) -> float | None:
    return float(value) if value is not None and math.isfinite(value) else None
