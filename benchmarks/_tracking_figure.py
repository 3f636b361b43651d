"""The table of `benchmark tracking` as a figure: every film over what is asked, row by row."""

from __future__ import annotations

from pathlib import Path
from typing import Any


def draw(table: list[dict[str, Any]], path: Path) -> None:
    """Rows that something is asked of, each value over it; the others in n, below."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib.figure import Figure

    asked = [row for row in table if row["asked"] is not None]
    beside = [row for row in table if row["asked"] is None]
    figure = Figure(figsize=(9.0, 1.6 + 0.32 * len(table)), layout="constrained")
    heights = [max(len(part), 1) for part in (asked, beside)]
    axes = figure.subplots(2, 1, height_ratios=heights)
    for part, axis, scale in ((asked, axes[0], True), (beside, axes[1], False)):
        for k, row in enumerate(part):
            over = row["asked"] if scale else 1.0
            axis.plot([value / over for value in row["values"]], [k] * len(row["values"]), "o", color="0.7", ms=4)
            axis.plot([row["measured"] / over], [k], "D", color="C0" if row["measured"] <= over or not scale else "C3")
        axis.set_yticks(range(len(part)), [row["what"] for row in part])
        axis.invert_yaxis()
        axis.set_xscale("log")
        axis.grid(axis="x", which="both", alpha=0.3)
    axes[0].axvline(1.0, color="k", lw=1)
    axes[0].set_xlabel("measured / asked (diamond: the figure of the row; dots: each film)")
    axes[1].set_xlabel("RMS error of the film, n = 0.002 decades")
    figure.savefig(path)
