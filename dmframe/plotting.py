"""How figures look and how they are saved: readable at a journal's column width, in grey, and small as SVG."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise
from typing import Any, Final

import numpy as np

from dmframe.errors import UnknownNameError
from dmframe.version import version

COLUMN, PAGE = 3.5, 7.16
"""Widths of one column and of a page of two [inch]."""

COLORS = ("#00467f", "#e69f00", "#c8503c", "#56b4e9", "#1a1a1a", "#009e73")
"""Told apart by those who see no red or green; neighbours differ in lightness, for grey printing."""

DASHES: tuple[Any, ...] = ("-", (0, (4, 1.5)), (0, (5, 1.2, 1, 1.2)), (0, (1, 1)), (0, (7, 2)), (0, (3, 1, 1, 1, 1, 1)))

GREY = "#9a9a9a"
FLAT = 1e-3
"""Relative change below which a curve is drawn as nearly flat."""

VANISHING = 1e-9
"""Of an error or an effort in the unit in which it is drawn, so less than a picometre: rounding, which has no scale."""

POINTS = 30_000
"""Points of all the curves in a figure; an SVG spends about 25 bytes on one."""

_STYLE: dict[str, Any] = {
    "axes.axisbelow": True,
    "axes.formatter.limits": (-3, 4),
    "axes.formatter.useoffset": False,
    "axes.grid": True,
    "axes.labelsize": 8,
    "axes.linewidth": 0.6,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlesize": 8,
    "figure.constrained_layout.h_pad": 0.03,
    "figure.constrained_layout.w_pad": 0.03,
    "figure.facecolor": "white",
    "font.family": "DejaVu Sans",
    "font.size": 8,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.4,
    "legend.fontsize": 7.5,
    "legend.frameon": False,
    "legend.handlelength": 2.4,
    "lines.dash_capstyle": "butt",
    "lines.linewidth": 1.0,
    "lines.scale_dashes": True,
    "path.simplify": True,
    "savefig.dpi": 200,
    "svg.fonttype": "path",
    "svg.hashsalt": "dmframe",
    "xtick.labelsize": 7.5,
    "xtick.major.width": 0.6,
    "ytick.labelsize": 7.5,
    "ytick.major.width": 0.6,
}


@contextmanager
def styled() -> Iterator[None]:
    """Within, matplotlib draws in this style; outside, the user's settings are as they were."""
    import matplotlib as mpl

    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_STYLE)
        yield


def new_figure(width: float, height: float) -> Any:
    """An empty figure that no global registry knows; sizes in inches."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=_STYLE["savefig.dpi"], layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def settle(figure: Any) -> None:
    """Lay a figure out once and for all, the labels of a column of panels in line.

    Matplotlib would do both again each time it draws, and takes most of its time for it.
    """
    figure.get_layout_engine().execute(figure)  # `draw_without_rendering` would also draw
    columns = dict[int, list[Any]]()
    for axes in figure.axes:
        spec = axes.get_subplotspec()
        if spec is not None and axes.yaxis.label.get_text():
            columns.setdefault(spec.colspan.start, []).append(axes)
    for panels in columns.values():
        labels = [axes.yaxis.label for axes in panels]
        for axes in panels:
            axes.apply_aspect()
            axes.yaxis.get_tightbbox()  # puts the label beside the axes where they now are
        ends = [label.get_position()[0] for label in labels]  # pixels
        room = min(ends) - max(end - label.get_window_extent().x0 for end, label in zip(ends, labels, strict=True))
        for axes, end in zip(panels, ends, strict=True):
            # one of two lines may have no room where the others stand: then each stays where it is
            left = min(ends) if room >= 0 else end
            axes.yaxis.set_label_coords(axes.transAxes.inverted().transform((left, 0.0))[0], 0.5)
    figure.set_layout_engine("none")


@contextmanager
def page(width: float, height: float) -> Iterator[Any]:
    """An empty figure to draw on, in our style, which is settled at the end."""
    with styled():
        figure = new_figure(width, height)
        yield figure
        settle(figure)


def figure_svg(figure: Any) -> str:
    """A matplotlib figure as SVG text."""
    text = io.StringIO()
    with styled():
        figure.savefig(text, format="svg", metadata={"Date": None})
    return text.getvalue()


FORMATS: Final = ("svg", "png", "pdf")
"""In which a figure can be written."""


def checked_formats(where: str, formats: Sequence[str]) -> tuple[str, ...]:
    """The formats, each once. Raises `UnknownNameError` for one that there is not."""
    formats = (formats,) if isinstance(formats, str) else formats
    for each in formats:
        if each not in FORMATS:
            raise UnknownNameError(where, "format of figures", each, FORMATS)
    return tuple(dict.fromkeys(formats))


def files_of(figure: Any, name: str, about: str, formats: Sequence[str] = FORMATS[:1]) -> dict[str, bytes]:
    """The figure as ``name.svg`` and in other `FORMATS`; the same figure gives the same bytes."""
    canvas = figure.canvas
    with styled():
        files = {f"{name}.{ending}": _printed(figure, ending, name, about) for ending in formats}
    figure.set_canvas(canvas)
    return files


def _printed(figure: Any, ending: str, name: str, about: str) -> bytes:
    """By a canvas of its own: `savefig` would draw twice, to settle what is settled."""
    file, source = io.BytesIO(), f"dmframe {version()}"
    meta = {"Title": name, "Description": about}
    if ending == "png":
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        FigureCanvasAgg(figure).print_png(file, metadata={"Software": source, **meta})
    elif ending == "pdf":
        from matplotlib.backends.backend_pdf import FigureCanvasPdf

        told = {"Title": name, "Subject": about, "Creator": source, "CreationDate": None}
        FigureCanvasPdf(figure).print_pdf(file, metadata=told)
    else:
        from matplotlib.backends.backend_svg import FigureCanvasSVG

        FigureCanvasSVG(figure).print_svg(file, metadata={"Date": None, "Creator": source, **meta})
    return file.getvalue()


def look(index: int) -> dict[str, Any]:
    """Colour and dashes of the index-th curve; no two of the first 36 are alike."""
    return {
        "color": COLORS[index % len(COLORS)],
        "linestyle": DASHES[(index + index // len(COLORS)) % len(DASHES)],
    }


def thin(values: np.ndarray, most: int) -> np.ndarray:
    """Indices that draw a curve with about `most` points and keep each stretch's lowest and highest value."""
    size = len(values)
    if size <= most:
        return np.arange(size)
    edges = np.linspace(0, size, max(most // 2, 1) + 1).astype(int)
    kept = {0, size - 1}
    for first, last in pairwise(edges.tolist()):
        part = values[first:last]
        kept |= {first + int(np.argmin(part)), first + int(np.argmax(part))}
    return np.array(sorted(kept))


def tame(values: np.ndarray) -> np.ndarray:
    """Values that can be scaled and drawn without overflow; no panel shows what a diverged run reaches at last."""
    return np.asarray(np.clip(values, -1e30, 1e30))


def draw_curve(axes: Any, times: np.ndarray, values: np.ndarray, most: int = 2000, **kind: Any) -> None:
    """A thinned curve; it leaves out what is no number."""
    known = ~np.isnan(values)
    times, values = times[known], tame(values[known])
    kept = thin(values, most)
    if kept.size < 8:
        kind["marker"] = "o"  # a line of one point is nothing that one sees, and of a few nothing sure
        kind["markersize"] = 3
    axes.plot(times[kept], values[kept], **kind)


def frame(axes: Any, curves: Sequence[tuple[np.ndarray, bool]], *, zero: bool = False) -> None:
    """Limits that show every curve in full, and a diverged one up to its last stretch, which would dwarf the rest.

    With `zero` they hold zero, and what vanishes is drawn as zero. What is no number counts for nothing.
    """
    known = [(values[~np.isnan(values)], diverged) for values, diverged in curves]
    ends = [span(values, diverged) for values, diverged in known if len(values)]
    if not ends:
        return
    low, high = min(end[0] for end in ends), max(end[1] for end in ends)
    if zero:
        low, high = min(low, 0.0), max(high, 0.0)
        if high - low < VANISHING:
            axes.set_ylim(-1.0, 1.0)
            axes.set_yticks([0.0])
            return
    # what hardly changes is drawn as flat: ticks of many digits would say more than they mean
    room = max(0.06 * (high - low), FLAT * max(abs(low), abs(high)) - (high - low) / 2, 1e-12)
    axes.set_ylim(low - room, high + room)


def span(values: np.ndarray, diverged: bool) -> tuple[float, float]:
    """Lowest and highest value; of a diverged run, before its last tenth."""
    shown = values[: max(1, int(0.9 * len(values)))] if diverged else values
    return float(np.min(shown)), float(np.max(shown))


def unit_text(unit: str) -> str:
    """A unit as print has it: ``1/s^2`` with a raised 2."""
    return unit.replace("^2", "²").replace("^3", "³")


def verbatim(text: str) -> str:
    """A name of others as it is, which matplotlib would read as mathematics between dollar signs."""
    return text.replace("$", r"\$")


NAME_LINE = 0.16
"""Height of a legend's line [inch]; figures have room for two."""


def names_above(figure: Any, axes: Any, width: float, extra: Sequence[Any] = ()) -> None:
    """A legend above all panels, where it covers nothing; as many columns as the width carries."""
    handles, labels = axes.get_legend_handles_labels() if axes is not None else ([], [])
    handles, labels = [*handles, *extra], [*labels, *(str(handle.get_label()) for handle in extra)]
    if not labels:
        return
    room = 0.45 + 0.062 * max(map(len, labels))  # handle and letters [inch]
    columns = max(1, min(len(labels), int(width / room)))
    figure.set_figheight(figure.get_figheight() + NAME_LINE * max(0, -(-len(labels) // columns) - 2))
    figure.legend(handles, labels, loc="outside upper center", ncols=columns)
