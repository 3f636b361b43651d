"""Figures as SVG, each also kept in the run's folder figures/."""

from __future__ import annotations

import io
import itertools
from pathlib import Path
from typing import Any, cast

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, LogFormatter
from numpy.typing import NDArray

from compensator.hysteresis.functions import Array
from rig.files.written import write_text

COLOURS = {
    "measured": "#1f5fbf",
    "target": "#1c2330",
    "full": "#1f5fbf",
    "pid": "#c8553d",
    "feedforward": "#d9a021",
    "instrument_pid": "#6a8d3f",
    "temperature": "#c8553d",
    "current": "#6a8d3f",
    "model": "#c8553d",
}
MOST_POINTS = 2500  # twice the pixels of a figure's width
SETTINGS: dict[str, Any] = {
    "font.size": 10.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#8b94a3",
    "axes.labelcolor": "#1c2330",
    "axes.grid": True,
    "grid.color": "#e6e9ef",
    "legend.frameon": False,
    "lines.linewidth": 1.3,
    "svg.fonttype": "none",
    "svg.hashsalt": "peltier-rig",
    "path.simplify": True,
}


def new_figure(
    rows: int, height: float, heights: list[float] | None = None, share: bool = True
) -> tuple[Figure, list[Axes]]:
    """A figure 10 inches wide with axes below one another."""
    with mpl.rc_context(cast(Any, SETTINGS)):
        figure = Figure(figsize=(10.0, height), layout="constrained")
        axes = figure.subplots(rows, 1, sharex=share, squeeze=False, height_ratios=heights)
    return figure, list(axes[:, 0])


class _Prefixed(LogFormatter):
    """Labels such as 80 k where a log scale wants one. Plain text: mathematical text, each time that it is set, leaves
    its glyphs in the font (FT2Font.load_char), 25 kB a figure, and a daemon draws for weeks."""

    _with_prefix = EngFormatter(sep="\N{THIN SPACE}")

    def __call__(self, x: float, pos: int | None = None) -> str:
        return self._with_prefix(x) if super().__call__(x, pos) else ""


def log_scale(axes: Axes) -> None:
    """The ordinate on a log scale, its labels with SI prefixes."""
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter(_Prefixed())
    axes.yaxis.set_minor_formatter(_Prefixed())


def thinned(*columns: Array) -> list[Array]:
    """Columns with at most MOST_POINTS rows: half of them evenly taken, half where a column is lowest or highest in its
    part of the rows, so that no peak is lost."""
    size = columns[0].size
    if size <= MOST_POINTS:
        return list(columns)
    even = np.linspace(0, size - 1, MOST_POINTS // 2).astype(np.int64)
    edges = np.linspace(0, size, MOST_POINTS // (4 * len(columns)) + 1).astype(np.int64)
    extremes = [_extremes(column, edges) for column in columns]
    index = np.unique(np.concatenate([even, *extremes]))
    return [column[index] for column in columns]


def _extremes(column: Array, edges: NDArray[np.int64]) -> NDArray[np.int64]:
    """The rows of the lowest and the highest number between each two edges."""
    finite = np.isfinite(column)
    low, high = np.where(finite, column, np.inf), np.where(finite, column, -np.inf)
    pairs = [
        (begin + int(np.argmin(low[begin:end])), begin + int(np.argmax(high[begin:end])))
        for begin, end in itertools.pairwise(edges.tolist())
    ]
    return np.array(pairs, dtype=np.int64).ravel()


def svg_text(figure: Figure) -> str:
    """The figure as an SVG file's text, the same bits for the same figure."""
    with mpl.rc_context(cast(Any, SETTINGS)):
        FigureCanvasSVG(figure)
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    return buffer.getvalue()


def saved(figure: Figure, folder: Path, name: str) -> str:
    """Write folder/figures/NAME.svg; returns the SVG element for a page."""
    text = svg_text(figure)
    (folder / "figures").mkdir(exist_ok=True)
    write_text(folder / "figures" / f"{name}.svg", text)
    start = text.index("<svg")
    unique = text[start:].replace('id="', f'id="{name}-').replace('href="#', f'href="#{name}-')
    return unique.replace("url(#", f"url(#{name}-")
