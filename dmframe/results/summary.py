"""A run in a few numbers: what ``run --json`` prints and ``summary.json`` holds."""

from __future__ import annotations

import math
from typing import Any

from dmframe.errors import DmframeError
from dmframe.results.metrics import tracking_error, turn_error
from dmframe.results.ran import Ran
from dmframe.results.shown import shown_by
from dmframe.results.storage import no_storage
from dmframe.simulate import Recording


def summary_of(run: Ran, out: str | None = None) -> dict[str, Any]:
    """`summary` with V: by how much it rose, and the notice of it."""
    try:
        storage = run.storage.summary
    except DmframeError as error:
        storage = no_storage(error)
    told = summary(run.experiment.name, run.recording, out)
    out = told.pop("out")
    return {**told, "storage": storage, "notices": list(run.notices), "out": out}


def summary(name: str, run: Recording, out: str | None = None) -> dict[str, Any]:
    """Plain data that JSON can hold: what is not a finite number is None.

    Parameters
    ----------
    name
        The graph's name.
    out
        The folder that holds the run's files, where there is one.
    """
    error, turn = tracking_error(run), turn_error(run)
    return {
        "graph": name,
        "duration": _number(run.duration),
        "clock": "continuous" if run.clock is None else _number(run.clock),
        "diverged": run.divergence is not None,
        "divergence": None if run.divergence is None else str(run.divergence),
        "interrupted": run.interrupted,
        "error": None
        if error is None
        else {
            "signal": error.signal,
            "unit": error.unit,
            "rms_by_eighth": [_number(value) for value in error.rms_by_eighth],
            "rms_final": _number(error.rms_final),
        },
        "turn": None
        if turn is None
        else {
            "signal": turn.signal,
            "unit": turn.unit,
            "rms_by_eighth": [_number(value) for value in turn.rms_by_eighth],
            "rms_final": _number(turn.rms_final),
        },
        "rank": [
            {"signal": rank.signal, "unit": rank.unit}
            | {key: _number(getattr(rank, key)) for key in ("smallest", "time", "share", "since")}
            for rank in run.ranks
        ],
        "shown": [
            {"signal": item.label, "says": item.words, "unit": item.unit}
            | {"values": list(map(_number, item.values)), "felt": item.felt and list(map(_number, item.felt))}
            for item in shown_by(run)
        ],
        "engine": run.engine,
        "wall_time": _number(run.wall_time),
        "real_time_factor": _number(run.real_time_factor),
        "notices": list(run.notices),
        "out": out,
    }


def _number(value: float | None) -> float | None:
    return float(value) if value is not None and math.isfinite(value) else None
