"""Caches of text extents and ticks of matplotlib, which recomputes them at each step of a layout.

A layout computes the ticks of each axis up to twelve times, and measures each label as often, which takes a third of
the time of a figure. In this context ticks are computed again only if the limits or the size of an axis have changed.
The figures are the same to the byte.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

MOST: Final = 4096
"""Cached layouts of texts."""

_layouts: dict[Any, Any] = {}


@contextmanager
def measured_once() -> Iterator[None]:
    """Context for a figure that is complete, in the style of `dmframe.common.plotting`."""
    from matplotlib.axis import Axis
    from matplotlib.text import Text

    ticks, layout = Axis._update_ticks, Text._get_layout
    known = dict[int, tuple[Any, Any, Any]]()

    def update_ticks(axis: Any) -> Any:
        state = (*axis.get_view_interval(), *axis.axes.bbox.bounds, axis.axes.figure.dpi, axis.get_scale())
        if id(axis) not in known or known[id(axis)][1] != state:
            known[id(axis)] = (axis, state, ticks(axis))  # with the axis, so that its id is not reused
        return known[id(axis)][2]

    def get_layout(text: Any, renderer: Any) -> Any:
        if text.get_wrap():  # at the edge of the figure
            return layout(text, renderer)
        how = (text.get_horizontalalignment(), text.get_verticalalignment(), text.get_rotation_mode())
        font = (hash(text.get_fontproperties()), text._multialignment, text._linespacing, text._usetex)
        where = (text.get_rotation(), text.figure.dpi, type(renderer), getattr(renderer, "dpi", 0))
        key = (text.get_text(), text.get_parse_math(), *how, *font, *where)
        if key not in _layouts:
            if len(_layouts) >= MOST:
                _layouts.clear()
            _layouts[key] = layout(text, renderer)
        return _layouts[key]

    Axis._update_ticks, Text._get_layout = update_ticks, get_layout
    try:
        yield
    finally:
        Axis._update_ticks, Text._get_layout = ticks, layout
