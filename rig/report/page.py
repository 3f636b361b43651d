"""Figures as SVG and the HTML page of every report: one style, one file a page, no script, offline.

Each figure is in the page twice, for a wide and a narrow window, and the page shows the one that fits;
figures/NAME.svg in the run's folder is the wide one. Colours of lines can be read on white and on black, all others
change with the reader's colour scheme.
"""

from __future__ import annotations

import io
import itertools
import re
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path
from typing import Any, cast
from urllib.parse import quote

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec
from matplotlib.ticker import EngFormatter, LogFormatter
from numpy.typing import NDArray

from compensator.hysteresis.functions import Array
from rig.core.file_writing import write_text
from sim.model.gaps import rows_after_gaps

INK, SOFT, EDGE, GRID, SHADE, PAPER = "#1c2330", "#5b6472", "#8b94a3", "#e6e9ef", "#eef2f8", "#ffffff"
DARK = {INK: "#e4e8ee", "#000000": "#e4e8ee", SOFT: "#a3adbb", GRID: "#2b323e", SHADE: "#202836", PAPER: "#14181f"}
BLUE, RED, GOLD, GREEN, PURPLE = "#3b7dd8", "#d6603f", "#b8860b", "#6a8d3f", "#8f6fd0"  # 3 to 1 on white and on dark
COLOURS = {
    "measured": BLUE,
    "target": INK,
    "full": BLUE,
    "pid": RED,
    "feedforward": GOLD,
    "instrument_pid": GREEN,
    "temperature": RED,
    "current": GREEN,
    "model": RED,
}
WIDE_INCH, NARROW_INCH = 10.0, 4.6  # the narrow one's letters are 10 pixels high in 350
STYLE = Path(__file__).with_name("page.css")
MOST_POINTS = 2500  # twice the pixels of a figure's width
SETTINGS: dict[str, Any] = {
    "font.size": 10.0,
    "text.color": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": EDGE,
    "axes.labelcolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": GRID,
    "legend.frameon": False,
    "lines.linewidth": 1.3,
    "svg.fonttype": "none",
    "svg.hashsalt": "peltier-rig",
    "path.simplify": True,
}


def grid(rows: int, columns: int, height: float, **options: Any) -> tuple[Figure, NDArray[Any]]:
    """Return a figure 10 inches wide with its axes, shape (rows, columns)."""
    with mpl.rc_context(cast(Any, SETTINGS)):
        figure = Figure(figsize=(WIDE_INCH, height), layout="constrained", dpi=110)
        axes = figure.subplots(rows, columns, squeeze=False, **options)
    return figure, axes


def new_figure(
    rows: int, height: float, heights: list[float] | None = None, share: bool = True
) -> tuple[Figure, list[Axes]]:
    """Return a figure 10 inches wide with axes below one another."""
    figure, axes = grid(rows, 1, height, sharex=share, height_ratios=heights)
    return figure, list(axes[:, 0])


def draw_line(
    axes: Axes,
    time_s: Any,
    values: Any,
    *,
    over: Any = None,
    held: bool = False,
    breaks: Iterable[int] = (),
    **style: Any,
) -> None:
    """Draw readings over time, or over another column, joined where they follow one another.

    time_s, values, over: shape (rows,). The line breaks at a gap of the times of the finite readings (the rule is that
    of records, `sim.model.gaps`), where times go back, and before the rows `breaks`; a reading alone
    between two breaks is a dot. held: each value holds until the next reading (a current).
    """
    time, y = np.asarray(time_s, dtype=np.float64), np.asarray(values, dtype=np.float64)
    x = time if over is None else np.asarray(over, dtype=np.float64)
    piece = np.zeros(time.size, dtype=np.int64)
    piece[[row for row in breaks if 0 < row < time.size]] = 1
    read = np.isfinite(time) & np.isfinite(x) & np.isfinite(y)
    time, x, y, piece = time[read], x[read], y[read], np.cumsum(piece)[read]
    apart = np.concatenate([rows_after_gaps(time), np.flatnonzero((np.diff(time) < 0.0) | (np.diff(piece) > 0)) + 1])
    starts = np.unique(np.concatenate([[0], apart])).astype(np.int64)
    alone = starts[np.diff(np.append(starts, time.size)) == 1] if time.size > 1 else starts[:0]
    *_, rows = thinned(x, y, np.arange(time.size))
    rows = np.unique(np.concatenate([rows, starts[1:] - 1, starts[: time.size]]))
    cuts = np.searchsorted(rows, starts[1:])
    how: dict[str, Any] = {"drawstyle": "steps-post"} if held else {}
    (line,) = axes.plot(np.insert(x[rows], cuts, np.nan), np.insert(y[rows], cuts, np.nan), **how, **style)
    if alone.size:
        size = 2.0 * line.get_linewidth()
        axes.plot(x[alone], y[alone], "o", color=line.get_color(), markersize=size, markeredgewidth=0.0)


def legend_above(axes: Axes) -> None:
    """Put the legend above the axes at the right, where no line is."""
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, borderaxespad=0.2, frameon=False)


class _Prefixed(LogFormatter):
    """Labels such as 80 k where a log scale wants one. Plain text: mathematical text, each time that it is set, leaves
    its glyphs in the font (FT2Font.load_char), 25 kB a figure, and a daemon draws for weeks."""

    _with_prefix = EngFormatter(sep="\N{THIN SPACE}")

    def __call__(self, x: float, pos: int | None = None) -> str:
        return self._with_prefix(x) if super().__call__(x, pos) else ""


def log_scale(axes: Axes) -> None:
    """Put the ordinate on a log scale, its labels with SI prefixes."""
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter(_Prefixed())
    axes.yaxis.set_minor_formatter(_Prefixed())


def thinned(*columns: Any) -> list[Any]:
    """Return columns with at most MOST_POINTS rows: half of them evenly taken, half where a column is lowest or highest
    in its part of the rows, so that no peak is lost."""
    size = columns[0].size
    if size <= MOST_POINTS:
        return list(columns)
    even = np.linspace(0, size - 1, MOST_POINTS // 2).astype(np.int64)
    edges = np.linspace(0, size, MOST_POINTS // (4 * len(columns)) + 1).astype(np.int64)
    extremes = [_extremes(column, edges) for column in columns]
    index = np.unique(np.concatenate([even, *extremes]))
    return [column[index] for column in columns]


def _extremes(column: Array, edges: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the rows of the lowest and the highest number between each two edges."""
    finite = np.isfinite(column)
    low, high = np.where(finite, column, np.inf), np.where(finite, column, -np.inf)
    pairs = [
        (begin + int(np.argmin(low[begin:end])), begin + int(np.argmax(high[begin:end])))
        for begin, end in itertools.pairwise(edges.tolist())
    ]
    return np.array(pairs, dtype=np.int64).ravel()


def dark_style(within: str = "") -> str:
    """Return the CSS rules that make a figure dark where the reader's colour scheme is."""
    rules = [f"{within} text {{ fill: {DARK[INK]} }}"]
    for light, dark in DARK.items():
        for what in ("fill", "stroke"):
            rules.append(f'{within} [style*="{what}: {light}"] {{ {what}: {dark} !important }}')
    return f"@media (prefers-color-scheme: dark) {{ {' '.join(rules)} }}"


def svg_text(figure: Figure) -> str:
    """Return the figure as the text of an SVG file, the same bits for the same figure."""
    with mpl.rc_context(cast(Any, SETTINGS)):
        FigureCanvasSVG(figure)
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    return buffer.getvalue()


def write_svg(path: Path, text: str) -> None:
    """Write an SVG file that a viewer shows in the reader's colour scheme."""
    write_text(path, text.replace("<defs>", f"<defs><style>{dark_style('svg')}</style>", 1))


def saved(drawn: Figure, folder: Path, name: str, caption: str) -> str:
    """Write folder/figures/NAME.svg; return the figure for a page, wide and narrow, with its caption."""
    wide = svg_text(drawn)
    (folder / "figures").mkdir(exist_ok=True)
    write_svg(folder / "figures" / f"{name}.svg", wide)
    return figure(both_widths(drawn, name, wide), caption)


def both_widths(figure: Figure, name: str, wide: str) -> str:
    """Return a page's elements of a figure, whose wide SVG text is known; the figure is a narrow one then."""
    _make_narrow(figure)
    return _element(wide, f"{name}-", "in-wide") + _element(svg_text(figure), f"{name}-narrow-", "in-narrow")


def _element(text: str, prefix: str, kind: str) -> str:
    """Return the SVG element alone, its ids unlike those of other figures of a page."""
    unique = text[text.index("<svg") :].replace('id="', f'id="{prefix}').replace('href="#', f'href="#{prefix}')
    return f'<div class="{kind}">{unique.replace("url(#", f"url(#{prefix}")}</div>'


def _make_narrow(figure: Figure) -> None:
    """Lay a figure out anew for a narrow window: panels beside one another go below one another."""
    height = float(figure.get_figheight())
    beside = [a for a in figure.axes if (s := a.get_subplotspec()) is not None and s.get_gridspec().ncols > 1]
    if beside:
        spec = beside[0].get_subplotspec()
        assert spec is not None
        height = len(beside) * max(height / spec.get_gridspec().nrows, 2.0)
        below = GridSpec(len(beside), 1, figure=figure)
        label = ""
        for k, axes in enumerate(beside):
            label = axes.get_ylabel() or label
            axes.set_subplotspec(below[k])
            axes.set_ylabel(label)
            axes.tick_params(labelleft=True)
    figure.set_size_inches(NARROW_INCH, height)


def shown(text: str) -> str:
    """Return a text, written for a terminal, as HTML."""
    signs = re.sub(r"(?<=\d )degC\b", "\N{DEGREE SIGN}C", text.replace("+-", "\N{PLUS-MINUS SIGN}"))
    return re.sub(r"`([^`]+)`", r"<code>\1</code>", escape(signs))


class Html(str):
    """Text that is HTML already, such as a cell with a link."""


def link(text: str, address: str) -> Html:
    return Html(f'<a href="{escape(quote(address))}">{escape(text)}</a>')


def links(items: Iterable[tuple[str, str]]) -> str:
    """Return a paragraph of links to other reports: (text, address)."""
    return f"<p>{', '.join(link(*one) for one in items)}</p>"


def tiles(items: Iterable[tuple[str, str]]) -> str:
    inner = "".join(f'<div class="tile"><b>{escape(n)}</b><span>{escape(what)}</span></div>' for n, what in items)
    return f'<div class="tiles">{inner}</div>'


def table(head: Sequence[str], rows: Iterable[Sequence[str]], best: int | None = None, kind: str = "") -> str:
    """Return a table; the row `best` is set in bold. One that is wider than the window scrolls by itself, not the page.

    kind: "words" of a table of words, which stand at the left; "words many" of one with wide columns."""
    top = "".join(f"<th>{escape(cell)}</th>" for cell in head)
    body = "".join(
        f"<tr{' class=best' if k == best else ''}>" + "".join(f"<td>{_cell(cell)}</td>" for cell in row) + "</tr>"
        for k, row in enumerate(rows)
    )
    inner = f"<table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table>"
    return f'<div class="{f"wide {kind}".strip()}">{inner}</div>'


def _cell(cell: str) -> str:
    return cell if isinstance(cell, Html) else shown(cell)


def figure(svg: str, caption: str) -> str:
    """Return a figure with its caption, which is also its text for a screen reader."""
    return f'<figure role="img" aria-label="{escape(caption)}">{svg}<figcaption>{escape(caption)}</figcaption></figure>'


def section(title: str, *parts: str) -> str:
    return f"<section><h2>{escape(title)}</h2>{''.join(parts)}</section>"


def details(title: str, *parts: str) -> str:
    """Return parts that are closed until the reader opens them."""
    return f"<details><summary>{escape(title)}</summary>{''.join(parts)}</details>"


def paragraph(text: str, kind: str = "") -> str:
    return f'<p class="{kind}">{shown(text)}</p>' if kind else f"<p>{shown(text)}</p>"


def bullets(items: Iterable[str]) -> str:
    return "<ul>" + "".join(f"<li>{shown(item)}</li>" for item in items) + "</ul>"


def write_page(path: Path, title: str, lead: str, parts: Iterable[str]) -> None:
    """Write a page of parts, which are HTML."""
    style = STYLE.read_text(encoding="utf-8") + dark_style("figure")
    write_text(
        path,
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(title)}</title><style>\n{style}</style></head><body>"
        f'<h1>{escape(title)}</h1><p class="lead">{shown(lead)}</p>{"".join(parts)}</body></html>\n',
    )
