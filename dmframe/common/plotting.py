"""Style and output of figures: readable at a journal's column width and in grey, and small as SVG."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from typing import Any, Final

import numpy as np

from dmframe.common.errors import UnknownNameError
from dmframe.common.measuring import measured_once
from dmframe.common.version import version

COLUMN, PAGE = 3.5, 7.16
"""Widths of one column and of a page of two [inch]."""

COLORS = ("#00467f", "#e69f00", "#c8503c", "#56b4e9", "#1a1a1a", "#009e73")
"""Distinguishable with red-green colour blindness; neighbours differ in lightness, for grey printing."""

DASHES: tuple[Any, ...] = ("-", (0, (4, 1.5)), (0, (5, 1.2, 1, 1.2)), (0, (1, 1)), (0, (7, 2)), (0, (3, 1, 1, 1, 1, 1)))

GREY = "#9a9a9a"
FLAT = 1e-3
"""Relative change below which a curve is drawn as nearly flat."""

VANISHING = 1e-9
"""Range below which a curve is drawn as zero, since it is rounding [unit of the axis]."""

POINTS = 30_000
"""Points of all curves in a figure; each takes about 25 bytes of an SVG."""

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
    """Context with this style of matplotlib, which restores the user's settings."""
    import matplotlib as mpl

    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_STYLE)
        yield


def loaded(*, documented: bool = True) -> None:
    """Import matplotlib's figures; a failure shows when a figure is drawn.

    If not `documented`, for a process that draws and ends, the classes have no docstrings: matplotlib writes them by
    inspection of each class, which takes a third of its import.
    """
    with suppress(Exception), nullcontext() if documented else _undocumented():
        import matplotlib.backends.backend_agg
        import matplotlib.backends.backend_svg
        import matplotlib.figure  # noqa: F401 - imported so that drawing finds it


@contextmanager
def _undocumented() -> Iterator[None]:
    """Context in which matplotlib's classes are made without their docstrings."""
    from matplotlib.artist import Artist

    written = vars(Artist)["_update_set_signature_and_docstring"]
    Artist._update_set_signature_and_docstring = classmethod(lambda cls: None)
    try:
        yield
    finally:
        Artist._update_set_signature_and_docstring = written


def new_figure(width: float, height: float) -> Any:
    """An empty figure outside of pyplot's registry; sizes in inches."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=_STYLE["savefig.dpi"], layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def settle(figure: Any) -> None:
    """Compute the layout of a figure once, with aligned labels of the panels of a column.

    Matplotlib would repeat both each time it draws, which takes most of its time.
    """
    figure.get_layout_engine().execute(figure)  # `draw_without_rendering` would draw, too
    columns = dict[int, list[Any]]()
    for axes in figure.axes:
        spec = axes.get_subplotspec()
        if spec is not None and axes.yaxis.label.get_text():
            columns.setdefault(spec.colspan.start, []).append(axes)
    for panels in columns.values():
        labels = [axes.yaxis.label for axes in panels]
        for axes in panels:
            axes.apply_aspect()
            axes.yaxis.get_tightbbox()  # moves the label to the present axes
        ends = [label.get_position()[0] for label in labels]  # pixels
        room = min(ends) - max(end - label.get_window_extent().x0 for end, label in zip(ends, labels, strict=True))
        for axes, end in zip(panels, ends, strict=True):
            # without room for a label of two lines at the common position, labels keep theirs
            left = min(ends) if room >= 0 else end
            axes.yaxis.set_label_coords(axes.transAxes.inverted().transform((left, 0.0))[0], 0.5)
    figure.set_layout_engine("none")


@contextmanager
def page(width: float, height: float) -> Iterator[Any]:
    """An empty figure in this style, whose layout is computed at the end."""
    with styled():
        figure = new_figure(width, height)
        yield figure
        with measured_once():
            settle(figure)


def figure_svg(figure: Any) -> str:
    """A matplotlib figure as SVG text."""
    text = io.StringIO()
    with styled():
        figure.savefig(text, format="svg", metadata={"Date": None})
    return text.getvalue()


FORMATS: Final = ("svg", "png", "pdf")
"""File formats of figures."""


def checked_formats(where: str, formats: Sequence[str]) -> tuple[str, ...]:
    """Unique formats. Raises `UnknownNameError` for an unknown one."""
    formats = (formats,) if isinstance(formats, str) else formats
    for each in formats:
        if each not in FORMATS:
            raise UnknownNameError(where, "format of figures", each, FORMATS)
    return tuple(dict.fromkeys(formats))


def files_of(figure: Any, name: str, about: str, formats: Sequence[str] = FORMATS[:1]) -> dict[str, bytes]:
    """The figure as ``name.svg`` and in other `FORMATS`; the same figure gives the same bytes."""
    canvas = figure.canvas
    with styled(), measured_once():
        files = {f"{name}.{ending}": _printed(figure, ending, name, about) for ending in formats}
    figure.set_canvas(canvas)
    return files


def _printed(figure: Any, ending: str, name: str, about: str) -> bytes:
    """Print on a canvas of the format; `savefig` would draw twice to compute the layout."""
    file, source = io.BytesIO(), f"dmframe {version()}"
    meta = {"Title": name, "Description": about}
    if ending == "png":
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        FigureCanvasAgg(figure).print_png(file, metadata={"Software": source, **meta})
    elif ending == "pdf":
        from matplotlib.backends.backend_pdf import FigureCanvasPdf

        data = {"Title": name, "Subject": about, "Creator": source, "CreationDate": None}
        FigureCanvasPdf(figure).print_pdf(file, metadata=data)
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
    """Indices of about `most` points of a curve, including the minimum and the maximum of each interval."""
    size = len(values)
    if size <= most:
        return np.arange(size)
    edges = np.linspace(0, size, max(most // 2, 1) + 1).astype(int)
    stretch = np.repeat(np.arange(edges.size - 1), np.diff(edges))
    kept = [np.array([0, size - 1])]
    for end in (np.minimum, np.maximum):
        there = np.flatnonzero(values == end.reduceat(values, edges[:-1])[stretch])
        kept.append(there[np.diff(stretch[there], prepend=-1) > 0])  # the first of each interval
    return np.unique(np.concatenate(kept))


def tame(values: np.ndarray) -> np.ndarray:
    """Values clipped so that they can be drawn without overflow."""
    return np.asarray(np.clip(values, -1e30, 1e30))


def draw_curve(axes: Any, times: np.ndarray, values: np.ndarray, most: int = 2000, **kind: Any) -> None:
    """Draw a decimated curve without NaN."""
    known = ~np.isnan(values)
    times, values = times[known], tame(values[known])
    kept = thin(values, most)
    if kept.size < 8:
        kind["marker"] = "o"  # a line of a few points is hardly visible
        kind["markersize"] = 3
    axes.plot(times[kept], values[kept], **kind)


def frame(axes: Any, curves: Sequence[tuple[np.ndarray, bool]], *, zero: bool = False) -> None:
    """Set limits that show every curve, and a diverged one without its end; NaN is ignored.

    With `zero` the limits include zero, and a vanishing curve is drawn as zero.
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
    # a nearly constant curve is drawn as flat, to avoid ticks with many digits
    room = max(0.06 * (high - low), FLAT * max(abs(low), abs(high)) - (high - low) / 2, 1e-12)
    axes.set_ylim(low - room, high + room)


def span(values: np.ndarray, diverged: bool) -> tuple[float, float]:
    """Minimum and maximum; for a diverged run, without the last tenth."""
    shown = values[: max(1, int(0.9 * len(values)))] if diverged else values
    return float(np.min(shown)), float(np.max(shown))


def unit_text(unit: str) -> str:
    """Typeset unit: ``1/s^2`` with a superscript 2."""
    return unit.replace("^2", "²").replace("^3", "³")


def verbatim(text: str) -> str:
    """A name with dollar signs escaped, between which matplotlib would set mathematics."""
    return text.replace("$", r"\$")


NAME_LINE = 0.16
"""Height of a legend's line [inch]; figures have room for two."""


def names_above(figure: Any, axes: Any, width: float, extra: Sequence[Any] = ()) -> None:
    """Add a legend above all panels, with as many columns as fit."""
    handles, labels = axes.get_legend_handles_labels() if axes is not None else ([], [])
    handles, labels = [*handles, *extra], [*labels, *(str(handle.get_label()) for handle in extra)]
    if not labels:
        return
    room = 0.45 + 0.062 * max(map(len, labels))  # handle and letters [inch]
    columns = max(1, min(len(labels), int(width / room)))
    figure.set_figheight(figure.get_figheight() + NAME_LINE * max(0, -(-len(labels) // columns) - 2))
    figure.legend(handles, labels, loc="outside upper center", ncols=columns)
