"""Figures of a film's record: loop with model, what the model leaves, derivative, FORC diagram."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure

from compensator.characterization.forc import Forc
from compensator.characterization.transition import SENSES, Transition, slope_curve
from compensator.hysteresis.functions import Array
from rig.files.film_output import in_decades, unit_of
from rig.report.diagnosis_figures import grid
from rig.report.figures import COLOURS, log_scale, new_figure, saved, thinned
from rig.report.page import figure

SENSE_COLOURS = {"heating": COLOURS["model"], "cooling": COLOURS["measured"]}
DEGREE = "\N{DEGREE SIGN}C"


def shown_output(values: Array, output: str) -> Array:
    """The output as people look at it: ohms, or the quantity with its own sign."""
    if in_decades(output):
        return np.asarray(10.0 ** (-values if output == "minus_log10_ohm" else values), dtype=np.float64)
    return -values if output.startswith("minus_") else values


def label_of(output: str) -> str:
    """The axis of that output."""
    if in_decades(output):
        return "resistance / ohm"
    name = output.removeprefix("minus_")
    return f"{name.partition('_')[0]} / {unit_of(output)}"


def loop_figure(folder: Path, degC: Array, measured: Array, model: Array, output: str, suffix: str = "") -> str:
    """Output over temperature, measured and modelled; arrays of shape (rows,)."""
    fig = drawn_loop(degC, measured, model, output)
    return figure(saved(fig, folder, f"loop{suffix}"), "The record, and the model over it.")


def drawn_loop(degC: Array, measured: Array, model: Array, output: str) -> Figure:
    """The same, not yet in a file."""
    fig, axes = new_figure(1, 4.6)
    t, one, other = thinned(degC, shown_output(measured, output), shown_output(model, output))
    axes[0].plot(t, one, ".", markersize=3, color=COLOURS["measured"], label="measured")
    axes[0].plot(t, other, color=COLOURS["model"], linewidth=1.1, label="model")
    axes[0].set_xlabel(f"temperature / {DEGREE}")
    axes[0].set_ylabel(label_of(output))
    if in_decades(output):
        log_scale(axes[0])
    axes[0].legend(loc="best")
    return fig


def residual_figure(folder: Path, time_s: Array, degC: Array, error: Array, unit: str, suffix: str = "") -> str:
    """What the model gets wrong over time and over temperature; arrays of shape (rows,)."""
    fig, axes = grid(1, 2, 2.9, sharey=True)
    t, v, shown = thinned(time_s, degC, error)
    axes[0, 0].plot(t, shown, ".", markersize=2, color=COLOURS["model"])
    axes[0, 1].plot(v, shown, ".", markersize=2, color=COLOURS["model"])
    axes[0, 0].set_xlabel("time / s")
    axes[0, 1].set_xlabel(f"temperature / {DEGREE}")
    axes[0, 0].set_ylabel(f"model - measured / {unit}")
    return figure(saved(fig, folder, f"residual{suffix}"), "What the model gets wrong, over time and over temperature.")


def histogram_figure(folder: Path, error: Array, unit: str, suffix: str = "") -> str:
    """How often the model is wrong by how much."""
    fig, axes = new_figure(1, 2.6)
    finite = error[np.isfinite(error)]
    axes[0].hist(finite, bins="fd" if np.ptp(finite) > 0.0 and finite.size > 4 else 10, color=COLOURS["measured"])
    axes[0].set_xlabel(f"model - measured / {unit}")
    axes[0].set_axisbelow(True)
    axes[0].set_ylabel("rows")
    return figure(saved(fig, folder, f"histogram{suffix}"), "How often the prediction is wrong by how much.")


def derivative_figure(folder: Path, found: Transition, name: str, unit: str) -> str:
    """The derivative of both branches with their bands, the transition temperatures marked."""
    fig, axes = new_figure(1, 3.8)
    for sense in SENSES:
        if sense not in found.shapes:
            continue
        degC, slope, half = slope_curve(found.shapes[sense], found.in_decades)
        margin = 0.5 * found.shapes[sense].window_K  # nearer to an end a window is too one-sided to look at
        inside = (degC > degC[0] + margin) & (degC < degC[-1] - margin)
        degC, slope, half = degC[inside], slope[inside], half[inside]
        colour, place = SENSE_COLOURS[sense], found.quantities[f"{sense}_degC"].value
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
    axes[0].set_ylabel("d log10 R / dT / (1/K)" if found.in_decades else f"d output / dT / ({unit}/K)")
    axes[0].legend(loc="best")
    caption = "The derivative of each major branch with its 95 % band, and the transition temperatures."
    return figure(saved(fig, folder, name), caption)


def forc_figure(folder: Path, forc: Forc, name: str) -> str:
    """The distribution of the first-order reversal curves, where the record holds enough of them."""
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
    axes[0].plot(forc.reversal_degC, forc.reversal_degC, "k.", markersize=3)
    axes[0].set_xlabel(f"temperature T / {DEGREE}")
    axes[0].set_ylabel(f"reversal T_r / {DEGREE}")
    axes[0].grid(visible=False)
    caption = (
        f"FORC diagram of the readings, {forc.reversal_degC.size} curves of {forc.sense}; dots: where they turn round. "
        f"Windows {2 * forc.window_K[0]:.1f} K along T_r, {2 * forc.window_K[1]:.1f} K along T."
    )
    return figure(saved(fig, folder, name), caption)
