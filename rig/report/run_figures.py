"""Figures of a run, in every report of one: its courses, and the error over time (of a resistance in decades)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from compensator.hysteresis.functions import Array
from rig.analysis.score import profile_error, tracked, tracking_error
from rig.core.columns import OF_A_RUN
from rig.report.figures import COLOURS, EDGE, SHADE, draw_line, legend_above, log_scale, new_figure, saved
from rig.report.page import figure
from rig.report.run_rows import RunRows, drive_label

BAND_DEC = 0.05  # 12 % of the resistance: what the eye takes for nothing beside a transition of decades


def tracking_figure(out: Path, runs: Mapping[str, RunRows]) -> str:
    """A panel for each law, by its name."""
    what = tracked(next(iter(runs.values())))
    fig, axes = new_figure(len(runs), 1.6 + 1.5 * len(runs))
    for axis, (law, run) in zip(axes, runs.items(), strict=True):
        if what.in_ohm:
            axis.axhspan(-BAND_DEC, BAND_DEC, color=SHADE, zorder=0)
        time, error = tracking_error(run)
        _course(axis, time, error, COLOURS.get(law, COLOURS["measured"]))
        axis.set_ylabel(f"{law}: measured\n- wanted / {what.unit}")
    axes[-1].set_xlabel("time of the target / s")
    scales = " Each law has its own scale." if len(runs) > 1 else ""
    text = f"The error over time, measured - wanted {what.name}.{scales}"
    if what.in_ohm:
        text = f"The error over time, measured - wanted log10 R.{scales} Shaded: ± {BAND_DEC:g} decades."
    return figure(saved(fig, out, "errors"), text)


def kelvin_figure(out: Path, run: RunRows) -> str:
    """Of a run that followed a temperature."""
    fig, axes = new_figure(1, 2.6)
    time, error = profile_error(run)
    _course(axes[0], time, error, COLOURS["temperature"])
    axes[0].set_ylabel("measured - wanted / K")
    axes[0].set_xlabel("time of the target / s")
    return figure(saved(fig, out, "errors"), "The error over time, measured - wanted temperature.")


def _course(axis: Axes, time: Array, error: Array, colour: str) -> None:
    """The course, and a dot where it is largest."""
    axis.axhline(0.0, color=EDGE, linewidth=0.6)
    draw_line(axis, time, error, color=colour, linewidth=1.0)
    if np.any(np.isfinite(error)):
        k = int(np.nanargmax(np.abs(error)))
        axis.plot(time[k : k + 1], error[k : k + 1], "o", color=colour, markersize=4)


def courses(run: RunRows, out: Path) -> str:
    """Temperature, drive and, where it was read, the film over the whole run, wanted beside measured."""
    time, temperature, current = (run.column(n) for n in ("time_s", "temperature_degC", "current_A"))
    own = [name for name in run.columns if name not in OF_A_RUN and not name.startswith(("target_", "predicted_"))]
    film = ["resistance_ohm", *own][-1]  # or another quantity that the meter's voltage stands for
    readings, wanted = run.column(film), run.column("setpoint_degC")
    measured = bool(np.any(np.isfinite(readings)))
    quantity, _, unit = film.partition("_")
    fig, axes = new_figure(3 if measured else 2, 7.0 if measured else 5.0)
    draw_measured_and_wanted(axes[0], time, temperature, wanted, COLOURS["temperature"])
    axes[0].set_ylabel("temperature / \N{DEGREE SIGN}C")
    draw_drive(axes[1], run, time, current)
    if measured:
        wanted = run.column("target_ohm" if film == "resistance_ohm" else f"target_{film}")
        draw_measured_and_wanted(axes[2], time, readings, wanted, COLOURS["measured"])
        if film == "resistance_ohm":
            log_scale(axes[2])
        axes[2].set_ylabel(f"{quantity} / {unit}")
    axes[-1].set_xlabel("time / s")
    caption = f"Temperature, {drive_label(run)[0]}" + (f" and {quantity}." if measured else ".")
    return figure(saved(fig, out, "courses"), caption)


def draw_measured_and_wanted(axes: Axes, time_s: Array, measured: Array, wanted: Array, colour: str) -> None:
    """Draw a reading over time and, where there is one, what it was to be."""
    draw_line(axes, time_s, measured, color=colour, label="measured", linewidth=1.5)
    if np.any(np.isfinite(wanted)):
        style = (0, (4, 2))
        draw_line(axes, time_s, wanted, color=COLOURS["target"], linestyle=style, linewidth=1.1, label="wanted")
        legend_above(axes)


def draw_drive(axes: Axes, run: RunRows, time_s: Array, current: Array) -> None:
    """Draw what drove the plate."""
    axes.axhline(0.0, color=EDGE, linewidth=0.6)
    draw_line(axes, time_s, current, held=True, color=COLOURS["current"], linewidth=0.9)
    axes.set_ylabel(" / ".join(drive_label(run)))
