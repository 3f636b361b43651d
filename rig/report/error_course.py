"""The error over time, in every report of a run: of a resistance in decades, of all else in its unit."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from compensator.hysteresis.functions import Array
from rig.analysis.score import profile_error, tracked, tracking_error
from rig.report.figures import COLOURS, new_figure, saved, thinned
from rig.report.page import figure
from rig.report.run_rows import RunRows

BAND_DEC = 0.05  # 12 % of the resistance: what the eye takes for nothing beside a transition of decades


def tracking_figure(out: Path, runs: Mapping[str, RunRows]) -> str:
    """A panel for each law, by its name."""
    what = tracked(next(iter(runs.values())))
    fig, axes = new_figure(len(runs), 1.6 + 1.5 * len(runs))
    for axis, (law, run) in zip(axes, runs.items(), strict=True):
        if what.in_ohm:
            axis.axhspan(-BAND_DEC, BAND_DEC, color="#eef2f8", zorder=0)
        time, error = tracking_error(run)
        _course(axis, time, error, COLOURS.get(law, COLOURS["measured"]))
        axis.set_ylabel(f"{law}\nerror / {what.unit}")
    axes[-1].set_xlabel("time of the target / s")
    scales = " Each law has its own scale." if len(runs) > 1 else ""
    text = f"Error over time: measured less wanted {what.name}.{scales}"
    if what.in_ohm:
        text = f"Error over time: log10 of measured over wanted resistance.{scales} Shaded: +-{BAND_DEC:g} decades."
    return figure(saved(fig, out, "errors"), text)


def kelvin_figure(out: Path, run: RunRows) -> str:
    """Of a run that followed a temperature."""
    fig, axes = new_figure(1, 2.6)
    time, error = profile_error(run)
    _course(axes[0], time, error, COLOURS["temperature"])
    axes[0].set_ylabel("error / K")
    axes[0].set_xlabel("time of the target / s")
    return figure(saved(fig, out, "errors"), "Error over time: measured less wanted temperature.")


def _course(axis: Axes, time: Array, error: Array, colour: str) -> None:
    """The course, and a dot where it is largest."""
    axis.axhline(0.0, color="#8b94a3", linewidth=0.6)
    axis.plot(*thinned(time, error), color=colour, linewidth=1.0)
    if np.any(np.isfinite(error)):
        k = int(np.nanargmax(np.abs(error)))
        axis.plot(time[k : k + 1], error[k : k + 1], "o", color=colour, markersize=4)
