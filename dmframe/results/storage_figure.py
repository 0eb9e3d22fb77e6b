"""V of a run, and what it is the sum of."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np

from dmframe.certify.along import Along
from dmframe.errors import DmframeError
from dmframe.plotting import draw_curve, frame, look, page, span, tame, verbatim
from dmframe.results.drawn_runs import note_below, told
from dmframe.results.ran import Ran
from dmframe.simulate import Recording

CURVES = 6
"""Terms of V that are shown, the largest ones."""

NOTE_WIDTH = 115
"""Characters of a line below the panels."""

FAINT = 1e-9
"""Of the largest value of a term: what is smaller lies below the panel."""


def storage_figure(name: str, run: Ran) -> Any:
    """V and its largest terms over time, as the blocks' certificates claim it; None where they claim nothing.

    That dV/dt is what they claim is for `verify` to prove: the figure only shows V.
    """
    try:
        storage = run.storage
    except DmframeError:
        return None
    found = storage.along
    names = [f"{term.drawn} ({verbatim(term.block)})" for term in found.terms]
    return storage_picture(found, names, run.recording, title=told(name, run.recording), note=storage.notice)


def storage_picture(found: Along, names: Sequence[str], run: Recording, title: str = "", note: str = "") -> Any:
    """V above, its largest terms below on a logarithmic axis, each under its name; where V rises, that is shaded."""
    diverged = run.divergence is not None
    tops = [span(tame(term.values), diverged)[1] for term in found.terms]
    largest = sorted(range(len(tops)), key=lambda k: -tops[k])[:CURVES]
    with page(6.6, 3.9) as figure:
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=[1.0, 1.3])
        draw_curve(above, found.time, found.V, 800, color="#1a1a1a")
        frame(above, [(tame(found.V), diverged)])
        above.set_ylabel("$V$")
        above.set_title(title, loc="left")
        climb = found.climb
        if climb.since is not None and climb.until is not None:
            above.axvspan(climb.since, climb.until, color="#c46a00", alpha=0.12, linewidth=0)
        for place, k in enumerate(largest):
            values = np.maximum(tame(found.terms[k].values), 1e-300)
            draw_curve(below, found.time, values, 600, label=names[k], **look(place))
        below.set_yscale("log")
        top = max(tops, default=0.0)
        if top > 0:
            below.set_ylim(top * FAINT, top * 3)
        below.set_ylabel("terms of $V$" if len(tops) <= CURVES else f"{CURVES} largest of {len(tops)}\nterms of $V$")
        below.set_xlabel("time [s]")
        above.set_xlim(0, float(found.time[-1]))
        below.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0)
        note_below(figure, *wrapped_note(note))
    return figure


def wrapped_note(note: str) -> list[str]:
    """A notice as lines that fit below the panels."""
    return textwrap.wrap(note, NOTE_WIDTH)
