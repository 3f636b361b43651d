"""The figure of a table of cases: the error over what was varied, or how often which effect was named."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from rig.report.figures import COLOURS, new_figure, svg_text, write_svg

ERRORS = (("rms_dec", "RMS error, decades"), ("rms_K", "RMS error, K"), ("film_rmse_dec", "RMSE of the film, decades"))
MOST_PANELS = 6  # that a page shows side by side
Row = dict[str, Any]


def draw_many(rows: Sequence[Row], path: Path) -> Path | None:
    """Write the figure; None where the table has nothing that one could show."""
    if any("verdict" in row for row in rows):
        figure = named_figure(rows)
    else:
        found = next(((name, label) for name, label in ERRORS if any(name in row for row in rows)), None)
        figure = _over_what_varied(rows, *found) if found is not None else None
    if figure is None:
        return None
    write_svg(path, svg_text(figure))
    return path


def _varied(rows: Sequence[Row]) -> list[str]:
    """The columns of numbers before the results that take more than one value."""
    names = list(rows[0])[: list(rows[0]).index("status")]
    return [
        name
        for name in names
        if name not in ("number", "seed", "of")
        and all(isinstance(row.get(name), (int, float)) for row in rows)
        and len({row[name] for row in rows}) > 1
    ][:MOST_PANELS]


def _over_what_varied(rows: Sequence[Row], error: str, label: str) -> Any:
    done = [row for row in rows if error in row]
    names = _varied(done) or ["number"]
    kinds = list(dict.fromkeys(row.get("effects", "") for row in done))
    figure, panels = new_figure(len(names), 1.2 + 2.6 * len(names), share=False)
    colours = list(dict.fromkeys(COLOURS.values()))
    for axes, name in zip(panels, names, strict=True):
        for k, kind in enumerate(kinds):
            x = np.array([row[name] for row in done if row.get("effects", "") == kind], float)
            y = np.array([row[error] for row in done if row.get("effects", "") == kind], float)
            colour = colours[k % len(colours)]
            axes.plot(x, y, ".", color=colour, alpha=0.6, label=kind or "no effect")
            values = np.unique(x)
            if 1 < values.size <= max(12, x.size // 3):
                axes.plot(values, [np.median(y[x == v]) for v in values], color=colour)
        axes.set_xlabel(name)
        axes.set_ylabel(label)
        axes.set_ylim(bottom=0.0)
    if len(kinds) > 1:
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=4, fontsize=8)
    return figure


def named_figure(rows: Sequence[Row]) -> Any:
    """How many cases have which effect, and which verdict."""
    judged = [row for row in rows if "verdict" in row]
    effects = Counter(word.partition(":")[0] for row in judged for word in str(row["named"]).split())
    verdicts = Counter(str(row["verdict"]) for row in judged)
    bars = [(name, count, COLOURS["measured"]) for name, count in effects.most_common()]
    bars += [(f"verdict: {name}", count, COLOURS["instrument_pid"]) for name, count in verdicts.most_common()]
    figure, (axes,) = new_figure(1, 1.2 + 0.35 * len(bars))
    labels = [name for name, _, _ in bars][::-1]
    axes.barh(labels, [count for _, count, _ in bars][::-1], color=[colour for _, _, colour in bars][::-1])
    axes.set_xlabel(f"cases of {len(judged)}")
    axes.locator_params(axis="x", integer=True)  # nobody has a quarter of a case
    return figure
