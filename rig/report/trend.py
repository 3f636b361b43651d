"""The report of many runs: which rig shows which effect, how large, since when; a figure and tables with links."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.dates import date2num

from rig.analysis.trend import Series
from rig.report.figures import COLOURS, both_widths, draw_line, new_figure, svg_text, write_svg
from rig.report.page import figure, link, paragraph, section, table, write_page

MOST_PANELS = 10  # one above the other, each still tall enough to be read
SEEN_OFTEN = 0.2  # of the runs: an effect that was named more seldom gets a line of the table and no panel


def write_trend_report(out: Path, series: Sequence[Series], rows: Sequence[Mapping[str, Any]]) -> None:
    """out/report.html and out/trend.svg. rows: of the runs, with "link", where its report is."""
    changed = [one for one in series if one.change is not None]
    lead = f"{len(changed)} of {len(series)} effects changed." if changed else "No effect changed."
    shown = [one for one in series if one.change is not None or one.seen >= SEEN_OFTEN * len(one.at)][:MOST_PANELS]
    parts = []
    if shown:
        fig = drawn(shown)
        text = svg_text(fig)
        write_svg(out / "trend.svg", text)
        caption = (
            "Sizes over time with their 95 % intervals; a vertical line where one changed, its means before and after."
        )
        parts.append(figure(both_widths(fig, "trend", text), caption))
    parts.append(section("Effects", _effects(series)))
    parts.append(section("Runs", _runs(rows)))
    write_page(out / "report.html", "Trend", lead, parts)


def drawn(series: Sequence[Series]) -> Any:
    """A panel a series over the days."""
    figure, panels = new_figure(len(series), 1.0 + 1.9 * len(series))
    for axes, one in zip(panels, series, strict=True):
        days: Any = date2num(np.array([at[:19] for at in one.at], dtype="datetime64[s]"))  # type: ignore[no-untyped-call]
        middle = one.value
        below, above = (abs(middle - one.low), abs(one.high - middle))
        axes.errorbar(days, middle, (below, above), fmt="o", ms=3, lw=1, color=COLOURS["measured"])
        if one.change is not None:
            axes.axvline(days[one.change.since], color=COLOURS["model"])
            spans = ((one.change.before[0], days[: one.change.since]), (one.change.after[0], days[one.change.since :]))
            for mean, span in spans:
                draw_line(axes, span, np.full(span.size, mean), color=COLOURS["model"], lw=1)
        axes.set_title(f"{one.rig}: {one.effect}", loc="left", fontsize=9)
        axes.set_ylabel(one.parameter)
        axes.xaxis_date()
    figure.autofmt_xdate()
    return figure


def _effects(series: Sequence[Series]) -> str:
    head = ("rig", "effect", "since", "before", "after", "latest", "named in")
    cells = []
    for one in series:
        row = one.row()
        latest = f"{row['latest']:.4g} ({row['low']:.4g} to {row['high']:.4g})" if "latest" in row else ""
        values = [f"{row[key]:.4g}" if key in row else "" for key in ("before", "after")]
        since = f"{row['since'][:16].replace('T', ' ')} {row['change']}" if row["since"] else "no change"
        cells.append((one.rig, f"{one.effect} {one.parameter}", since, *values, latest, f"{one.seen} of {len(one.at)}"))
    return table(head, cells) if cells else paragraph("No effect was named in any run.")


def _runs(rows: Sequence[Mapping[str, Any]]) -> str:
    cells = []
    for row in rows:
        name = link(str(row["run"]), str(row["link"])) if row.get("link") else str(row["run"])
        verdict = str(row.get("verdict", row.get("text", "")))
        cells.append((name, str(row["at"])[:16].replace("T", " "), str(row["rig"]), verdict, str(row.get("named", ""))))
    return table(("run", "began, UTC", "rig", "verdict", "named"), cells, kind="words")
