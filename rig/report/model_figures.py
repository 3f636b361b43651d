"""Figures that compare a model with a record (over time, loop, residual, plate), and of a film's transition."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure

from compensator.hysteresis.functions import Array
from rig.analysis.error import residual, residual_label
from rig.analysis.identification import PlateComparison
from rig.analysis.prediction import ChannelError
from rig.records.film_output import in_decades, unit_of
from rig.report.figures import (
    COLOURS,
    EDGE,
    GREEN,
    draw_line,
    grid,
    legend_above,
    log_scale,
    new_figure,
    saved,
    thinned,
)
from rig.report.page import figure
from sim.inference.transition.forc import Forc

SENSE_COLOURS = {"heating": COLOURS["model"], "cooling": COLOURS["measured"]}
DEGREE = "\N{DEGREE SIGN}C"
MODEL_LINE = (0, (4, 2))  # dashes, through which the readings are seen


def shown_output(values: Array, output: str) -> Array:
    """Return the output as people read it: ohms, or the quantity with its own sign."""
    if in_decades(output):
        return np.asarray(10.0 ** (-values if output == "minus_log10_ohm" else values), dtype=np.float64)
    return -values if output.startswith("minus_") else values


def label_of(output: str) -> str:
    """Return the label of an axis of that output."""
    if in_decades(output):
        return "resistance / ohm"
    name = output.removeprefix("minus_")
    return f"{name.partition('_')[0]} / {unit_of(output)}"


def plate_figure(folder: Path, one: PlateComparison, suffix: str = "") -> str:
    """Draw measured and simulated temperature over time, the residual, and the drive; return the page's figure."""
    fig, axes = new_figure(3, 6.4, [3.0, 1.6, 1.4])
    draw_measured_and_model(axes[0], one.time_s, one.measured_degC, one.simulated_degC)
    axes[0].set_ylabel(f"temperature / {DEGREE}")
    draw_residual(axes[1], one.time_s, residual(one.measured_degC, one.simulated_degC))
    axes[1].set_ylabel("measured - model\n/ K")
    draw_line(axes[2], one.time_s, one.drive_A, held=True, color=COLOURS["current"], linewidth=0.9)
    axes[2].set_ylabel("current / A" if one.drive is None else "drive\n/ of full drive")
    axes[2].set_xlabel("time / s")
    return figure(saved(fig, folder, f"plate{suffix}"), "The plate's temperature, simulated from its drive alone.")


def draw_measured_and_model(axes: Axes, time_s: Array, measured: Array, model: Array) -> None:
    """Draw both over time, with a legend."""
    draw_line(axes, time_s, measured, color=COLOURS["measured"], label="measured")
    draw_line(axes, time_s, model, color=COLOURS["model"], linestyle=MODEL_LINE, linewidth=1.1, label="model")
    legend_above(axes)


def draw_residual(axes: Axes, over: Array, left: Array) -> None:
    """Draw a dot for each row's residual."""
    axes.axhline(0.0, color=EDGE, linewidth=0.6)
    x, shown = thinned(over, left)
    axes.plot(x, shown, ".", markersize=2, color=COLOURS["model"])


def drawn_over_time(time_s: Array, errors: Sequence[ChannelError]) -> Figure:
    """Draw measured and predicted over time, a panel for each channel."""
    fig, axes = new_figure(max(1, len(errors)), 3.4 * max(1, len(errors)))
    for axis, error in zip(axes, errors, strict=False):
        plate = error.name == "temperature_degC"
        measured, predicted = error.measured, error.predicted
        if not plate:
            measured, predicted = shown_output(measured, error.name), shown_output(predicted, error.name)
        draw_measured_and_model(axis, time_s, measured, predicted)
        axis.set_ylabel(f"temperature / {DEGREE}" if plate else label_of(error.name))
        if not plate and in_decades(error.name):
            log_scale(axis)
    axes[-1].set_xlabel("time / s")
    return fig


def loop_figure(
    folder: Path, time_s: Array, degC: Array, measured: Array, model: Array, output: str, suffix: str = ""
) -> str:
    """Draw output over temperature, measured and modelled, arrays of shape (rows,); return the page's figure."""
    fig = drawn_loop(time_s, degC, measured, model, output)
    return figure(saved(fig, folder, f"loop{suffix}"), "The record, and the model over it.")


def drawn_loop(time_s: Array, degC: Array, measured: Array, model: Array, output: str) -> Figure:
    """Draw output over temperature, measured and modelled, arrays of shape (rows,)."""
    fig, axes = new_figure(1, 4.6)
    t, one = thinned(degC, shown_output(measured, output))
    axes[0].plot(t, one, ".", markersize=3, color=COLOURS["measured"], label="measured")
    draw_line(
        axes[0],
        time_s,
        shown_output(model, output),
        over=degC,
        color=COLOURS["model"],
        linewidth=1.1,
        label="model",
    )
    axes[0].set_xlabel(f"temperature / {DEGREE}")
    axes[0].set_ylabel(label_of(output))
    if in_decades(output):
        log_scale(axes[0])
    axes[0].legend(loc="best")
    return fig


def residual_figure(folder: Path, time_s: Array, degC: Array, left: Array, unit: str, suffix: str = "") -> str:
    """Draw the residual over time and over temperature, arrays of shape (rows,); return the page's figure."""
    fig, axes = grid(1, 2, 2.9, sharey=True)
    draw_residual(axes[0, 0], time_s, left)
    draw_residual(axes[0, 1], degC, left)
    axes[0, 0].set_xlabel("time / s")
    axes[0, 1].set_xlabel(f"temperature / {DEGREE}")
    axes[0, 0].set_ylabel(residual_label(unit))
    return figure(saved(fig, folder, f"residual{suffix}"), f"The residual{_of(unit)} over time and over temperature.")


def histogram_figure(folder: Path, left: Array, unit: str, suffix: str = "") -> str:
    """Draw the residual's histogram; return the page's figure."""
    fig, axes = new_figure(1, 2.6)
    finite = left[np.isfinite(left)]
    axes[0].hist(finite, bins="fd" if np.ptp(finite) > 0.0 and finite.size > 4 else 10, color=COLOURS["measured"])
    axes[0].set_xlabel(residual_label(unit))
    axes[0].set_ylabel("rows")
    return figure(saved(fig, folder, f"histogram{suffix}"), f"Histogram of the residual{_of(unit)}.")


def _of(unit: str) -> str:
    """Return what a residual is of if its unit alone does not say it."""
    return " of log10 R" if unit == "dec" else ""


def derivative_figure(folder: Path, curves: Mapping[str, Mapping[str, Any]], name: str, ylabel: str) -> str:
    """Draw the derivative of both branches with their bands, and mark the transition temperatures. curves: as of
    `FilmNumbers.shown`."""
    fig, axes = new_figure(1, 3.8)
    for sense, curve in curves.items():
        degC, slope, half = (np.asarray(curve[key]) for key in ("degC", "slope", "half_width"))
        colour, place = SENSE_COLOURS[sense], curve["steepest_degC"]
        axes[0].plot(degC, slope, color=colour, label=sense)
        axes[0].fill_between(degC, slope - half, slope + half, color=colour, alpha=0.2, linewidth=0)
        if place is not None:
            axes[0].axvline(place, color=colour, linestyle="--", linewidth=1.0)
            axes[0].annotate(
                f" {place:.1f} {DEGREE} ",
                (place, 1.01),  # above the axes, where no curve is
                xycoords=("data", "axes fraction"),
                ha="left" if sense == "heating" else "right",
                color=colour,
            )
    axes[0].set_xlabel(f"temperature / {DEGREE}")
    axes[0].set_ylabel(ylabel)
    axes[0].legend(loc="best")
    caption = "The derivative of each major branch with its 95 % band, and the transition temperatures."
    return figure(saved(fig, folder, name), caption)


def forc_figure(folder: Path, forc: Forc, name: str) -> str:
    """Draw the distribution of the first-order reversal curves."""
    fig, axes = new_figure(1, 4.8)
    most = float(np.nanquantile(np.abs(forc.density), 0.995))
    mesh = axes[0].pcolormesh(
        forc.grid_degC,
        forc.grid_reversal_degC,
        np.ma.masked_invalid(forc.density),
        cmap="RdBu_r",
        norm=TwoSlopeNorm(0.0, -most, most),
        rasterized=True,
        shading="nearest",
    )
    bar = fig.colorbar(mesh, ax=axes[0])
    bar.set_label("rho / (1/K\N{SUPERSCRIPT TWO})")
    axes[0].plot(forc.reversal_degC, forc.reversal_degC, ".", color=GREEN, markersize=4)
    axes[0].set_xlabel(f"temperature T / {DEGREE}")
    axes[0].set_ylabel(f"reversal T_r / {DEGREE}")
    axes[0].grid(visible=False)
    caption = (
        f"FORC diagram of the readings, {forc.reversal_degC.size} curves of {forc.sense}; dots: where they turn round. "
        f"Windows {2 * forc.window_K[0]:.1f} K along T_r, {2 * forc.window_K[1]:.1f} K along T."
    )
    return figure(saved(fig, folder, name), caption)
