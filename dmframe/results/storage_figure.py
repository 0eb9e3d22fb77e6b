"""Figure of V along a run and its largest terms."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, final

import numpy as np

from dmframe.common.errors import DmframeError
from dmframe.common.plotting import draw_curve, frame, look, page, span, tame, verbatim
from dmframe.results.plotting import note_below, run_label
from dmframe.results.run import Run
from dmframe.simulate import Recording

if TYPE_CHECKING:
    from dmframe.results.along import StorageTrace

CURVES = 6
"""Number of terms of V shown."""

NOTE_WIDTH = 115
"""Line length below the panels [characters]."""

FAINT = 1e-9
"""Lower limit of the axis relative to the largest value of a term."""


def storage_figure(name: str, run: Run) -> Any:
    """V of the certificates and its largest terms over time; None without a certificate."""
    try:
        return storage_picture(StoragePicture.of(name, run), run.recording)
    except DmframeError:
        return None


@final
@dataclass(frozen=True)
class StoragePicture:
    """What the figure of V shows.

    Parameters
    ----------
    found
        V and its terms along the run.
    names
        The terms' names.
    title, note
        The texts above and below.
    unit
        Of V; may be empty.
    """

    found: StorageTrace
    names: Sequence[str]
    title: str = ""
    note: str = ""
    unit: str = ""

    @classmethod
    def of(cls, name: str, run: Run) -> StoragePicture:
        """That of a run by the name of its curve; raises `DmframeError` without a certificate."""
        storage = run.storage
        return cls(storage.along, storage.names, run_label(name, run.recording), storage.notice, storage.unit.unit)


def storage_picture(shown: StoragePicture, run: Recording) -> Any:
    """Draw V above and its largest terms below on a logarithmic axis; the largest rise of V is shaded.

    For a discrete-time certificate, the lower panel also shows the residual: the allowed increase of V per sample.
    """
    found, names, unit = shown.found, shown.names, shown.unit
    diverged = run.divergence is not None
    tops = [span(tame(term.values), diverged)[1] for term in found.terms]
    largest = sorted(range(len(tops)), key=lambda k: -tops[k])[:CURVES]
    with page(6.6, 3.9) as figure:
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=[1.0, 1.3])
        draw_curve(above, found.time, found.V, 800, color="#1a1a1a")
        frame(above, [(tame(found.V), diverged)])
        above.set_ylabel(f"$V$ [{verbatim(unit)}]" if unit not in ("", "1") else "$V$")
        above.set_title(shown.title, loc="left")
        climb = found.climb
        if climb.since is not None and climb.until is not None:
            above.axvspan(climb.since, climb.until, color="#c46a00", alpha=0.12, linewidth=0)
        for place, k in enumerate(largest):
            values = np.maximum(tame(found.terms[k].values), 1e-300)
            draw_curve(below, found.time, values, 600, label=names[k], **look(place))
        if found.residual.size:
            allowed = np.maximum(tame(found.residual), 1e-300)
            draw_curve(
                below, found.time, allowed, 600, label="gain allowed, per sample", color="#8a8a8a", linewidth=0.6
            )
        below.set_yscale("log")
        top = max(tops, default=0.0)
        if top > 0:
            below.set_ylim(top * FAINT, top * 3)
        below.set_ylabel("terms of $V$" if len(tops) <= CURVES else f"{CURVES} largest of {len(tops)}\nterms of $V$")
        below.set_xlabel("time [s]")
        above.set_xlim(0, float(found.time[-1]))
        below.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0)
        note_below(figure, *wrapped_note(shown.note))
    return figure


def wrapped_note(note: str) -> list[str]:
    """Wrap a note to the width of the figure."""
    return textwrap.wrap(note, NOTE_WIDTH)
