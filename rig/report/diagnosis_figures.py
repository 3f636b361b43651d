"""Figures of a diagnosis: errors, residuals of the base and of the extended model, temperature over time, loop."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from compensator.hysteresis.functions import Array
from rig.analysis.error import residual, residual_label
from rig.report.diagnosis_words import channels_of, judged_channels
from rig.report.figures import COLOURS, EDGE, GREEN, draw_line, grid, legend_above, log_scale, new_figure, saved
from rig.report.page import figure

if TYPE_CHECKING:
    from sim.diagnosis.result import Diagnosis
    from sim.inference.joint.likelihood import Fit
    from sim.inference.record.record import Record

BASE, EXTENDED, NOISE = EDGE, COLOURS["model"], GREEN
MOST_DOTS = 4000  # more hide each other, and make the page slow
MILLI = 0.3  # K: below it a figure is in mK


def gain_figure(folder: Path, diagnosis: Diagnosis) -> str:
    """Draw the errors of both models on held-out rows, and the noise, a panel for each channel."""
    caption = "RMS error of a simulation over the whole record, counted on held-out rows, and the instrument's noise."
    return figure(saved(drawn_gain(diagnosis), folder, "gain"), caption)


def drawn_gain(diagnosis: Diagnosis) -> Figure:
    """Return the same as a matplotlib figure."""
    channels = judged_channels(diagnosis)
    extends = _extends(diagnosis)
    fig, axes = grid(1, len(channels), 1.7)
    for axis, (what, unit, channel) in zip(axes[0], channels, strict=True):
        scale, prefix = scaled(channel.rmse_base, unit)
        bars = [("noise", channel.noise, NOISE), ("extended model", channel.rmse_extended, EXTENDED)]
        bars = [*bars, ("base model", channel.rmse_base, BASE)] if extends else [bars[0], ("model", *bars[1][1:])]
        values = [scale * value for _, value, _ in bars]
        axis.barh([name for name, _, _ in bars], values, color=[colour for _, _, colour in bars], height=0.62)
        for k, value in enumerate(values):
            axis.annotate(f" {value:.3g}", (value, k), va="center", fontsize=9.5)
        axis.set_xlim(0.0, 1.14 * max(values))
        axis.set_title(f"{what}: error on held-out rows / {prefix}{unit}", fontsize=10, loc="left")
        axis.grid(visible=False, axis="y")
        axis.tick_params(axis="y", length=0)
    return fig


def scaled(size: float, unit: str) -> tuple[float, str]:
    """Return the factor and the prefix with which a size is shown: millikelvins below a limit."""
    return (1e3, "m") if size < MILLI and unit == "K" else (1.0, "")


def residuals(diagnosis: Diagnosis, fit: Fit) -> dict[str, Array]:
    """Return measured - model by channel, shape (rows,), in K and in decades of R or the film's own unit; nan without a
    reading."""
    record, out = diagnosis.record, {}
    for key, values in diagnosis.shown(fit).items():
        if key == "temperature_K":
            out[key] = np.where(record.temperature_used, residual(record.temperature_degC, values), np.nan)
        elif record.output is not None:
            left = record.quantity.size * residual(record.output, values, record.quantity.name)
            out[key] = np.where(record.output_used, left, np.nan)
    return out


def course_figure(folder: Path, diagnosis: Diagnosis) -> str:
    """Draw the temperature over time, measured and simulated by both models, and the current."""
    caption = "The temperature as measured, and as the models simulate it from the current alone."
    return figure(saved(drawn_course(diagnosis), folder, "course"), caption)


def drawn_course(diagnosis: Diagnosis) -> Figure:
    """Return the same as a matplotlib figure."""
    record = diagnosis.record
    fig, axes = new_figure(2, 5.0, [2.6, 1.0])
    degC = np.where(record.temperature_used, record.temperature_degC, np.nan)
    courses: list[tuple[Array, str, str, Any]] = [(degC, COLOURS["measured"], "measured", "-")]
    for group, colour, name in _models(diagnosis):
        courses.append((diagnosis.shown(group)["temperature_K"], colour, name, (0, (4, 2))))
    for values, colour, name, style in courses:
        draw_line(axes[0], record.time_s, values, breaks=_breaks(record), color=colour, label=name, linestyle=style)
    axes[0].set_ylabel("temperature / \N{DEGREE SIGN}C")
    legend_above(axes[0])
    if record.current_A is not None:
        breaks, colour = _breaks(record), COLOURS["current"]
        draw_line(axes[1], record.time_s, record.current_A, held=True, breaks=breaks, color=colour, linewidth=0.9)
    axes[1].set_ylabel(_drive(diagnosis).replace(" / of", "\n/ of"))
    axes[1].set_xlabel(_time(record)[0])
    if record.joined.size:
        _times_of_each(axes[1], record)
    return fig


def _models(diagnosis: Diagnosis) -> list[tuple[Fit, str, str]]:
    """The fit, colour and name of each model that is shown: the base model only if the extended one differs from it."""
    models = [(diagnosis.base, BASE, "base model"), (diagnosis.fit, EXTENDED, "extended model")]
    return models if _extends(diagnosis) else [(diagnosis.fit, EXTENDED, "model")]


def _extends(diagnosis: Diagnosis) -> bool:
    """Whether the extended model has other effects than the base model, or another film."""
    fit, base = diagnosis.fit, diagnosis.base
    return fit.effects != base.effects or type(fit.joint.film) is not type(base.joint.film)


def _breaks(record: Record) -> list[int]:
    """Return the rows at which a line is interrupted: after gaps, and at the first row of each record."""
    return sorted({*record.after_gaps.tolist(), *record.joined.tolist()})


def residual_figures(folder: Path, diagnosis: Diagnosis) -> list[str]:
    """Draw residuals against time, temperature, rate and drive, a figure for each channel."""
    before, after = residuals(diagnosis, diagnosis.base), residuals(diagnosis, diagnosis.fit)
    against = _against(diagnosis)
    return [_residual(folder, diagnosis, against, key, before[key], after[key]) for key in after]


def _against(diagnosis: Diagnosis) -> list[tuple[str, Array]]:
    """Return the (label, values) against which residuals are drawn."""
    record = diagnosis.record
    temperature = np.where(record.temperature_used, record.temperature_degC, np.nan)
    rate = np.concatenate([_rate(temperature[part], record.file_s[part]) for part in record.parts])
    found = [_time(record), ("temperature / \N{DEGREE SIGN}C", temperature), ("rate / K/s", rate)]
    if record.current_A is not None:
        found.append((_drive(diagnosis), record.current_A))
    elif record.test_current_A is not None:
        found.append(("test current / A", record.test_current_A))
    return found


def _time(record: Record) -> tuple[str, Array]:
    if record.joined.size:
        return "time / s, record after record", record.time_s
    return "time / s", record.file_s


def _drive(diagnosis: Diagnosis) -> str:
    share = diagnosis.drive is not None or (diagnosis.plate is not None and diagnosis.plate.kind == "heater")
    return "drive / of full drive" if share else "current / A"


def _rate(temperature_degC: Array, time_s: Array) -> Array:
    """Return the rate of one record, K/s, smoothed over a few rows; nan if it has fewer than two readings."""
    good = np.isfinite(temperature_degC)
    if np.sum(good) < 2:
        return np.full(time_s.size, np.nan)
    even = np.interp(time_s, time_s[good], temperature_degC[good])
    width = 9 if time_s.size > 200 else 3
    smooth = np.convolve(np.pad(even, width // 2, mode="edge"), np.ones(width) / width, "valid")
    return np.asarray(np.gradient(smooth, time_s), dtype=np.float64)


def _times_of_each(axis: Axes, record: Record) -> None:
    """Label an axis of joined records with the times of each record's file, and draw a line where each begins."""
    places, labels = [], []
    for part in record.parts:
        time, begin_s = record.file_s[part], float(record.time_s[part.start])
        ticks = [t for t in MaxNLocator(3).tick_values(time[0], time[-1]) if time[0] <= t <= time[-1]]
        places += [begin_s + t - time[0] for t in ticks]
        labels += [f"{t:.12g}" for t in ticks]
        if part.start:
            axis.axvline(begin_s, color=BASE, linewidth=0.8)
    axis.set_xticks(places, labels)


def _residual(
    folder: Path, diagnosis: Diagnosis, against: list[tuple[str, Array]], key: str, before: Array, after: Array
) -> str:
    """Draw the residuals of one channel, a row of panels for each model, each row on its own scale."""
    what, unit = channels_of(diagnosis)[key]
    models = [(before, BASE, "base model"), (after, EXTENDED, "extended model")]
    models = models if _extends(diagnosis) else [(after, EXTENDED, "model")]
    fig, axes = grid(len(models), len(against), 2.6 * len(models), sharey="row")
    good = np.flatnonzero(np.isfinite(before) & np.isfinite(after))
    index = good[np.unique(np.linspace(0, good.size - 1, min(MOST_DOTS, good.size)).astype(np.int64))]
    beyond = False
    for row, (residuals_of_model, colour, name) in zip(axes, models, strict=True):
        spread = float(np.nanpercentile(np.abs(residuals_of_model), 99.5))
        scale, prefix = scaled(spread, unit)
        limit, values = 1.3 * scale * spread, scale * residuals_of_model
        far = good[np.abs(values[good]) > limit]
        beyond = beyond or far.size > 0
        for axis, (label, x) in zip(row, against, strict=True):
            axis.plot(x[index], values[index], ".", color=colour, markersize=2, rasterized=True)
            for sign, mark in ((1.0, "^"), (-1.0, "v")):
                there = far[sign * values[far] > 0.0]
                axis.plot(x[there], np.full(there.size, 0.97 * sign * limit), mark, color=colour, markersize=4)
            axis.set_ylim(-limit, limit)
            axis.set_xlabel(label)
        row[0].set_ylabel(f"{name}\n{residual_label(f'{prefix}{unit}')}")
    if diagnosis.record.joined.size:
        for axis in axes[:, 0]:
            _times_of_each(axis, diagnosis.record)
    *others, last = [label.split(" / ")[0] for label, _ in against]
    caption = f"Residual of {what} against {', '.join(others)} and {last}."
    caption += " Each row has its own scale." * (len(models) > 1)
    caption += " Triangles at the edge: readings beyond it." * beyond
    return figure(saved(fig, folder, f"residual_{key}"), caption)


def loop_figure(folder: Path, diagnosis: Diagnosis) -> str:
    """Draw the film's output over temperature, measured and simulated."""
    caption = "The loop as measured, and as the models simulate it."
    return figure(saved(drawn_loop(diagnosis), folder, "loop"), caption)


def drawn_loop(diagnosis: Diagnosis) -> Figure:
    """Return the same as a matplotlib figure."""
    record = diagnosis.record
    assert record.output is not None
    fig, axes = grid(1, 2, 3.6)
    temperature = diagnosis.fit.at.run.path.at(record.time_s)
    good = np.flatnonzero(record.output_used)
    index = good[np.unique(np.linspace(0, good.size - 1, min(MOST_DOTS, good.size)).astype(np.int64))]
    read = record.output_used & np.isfinite(temperature)
    panels = _models(diagnosis)
    for axis, (group, colour, name) in zip(axes[0], panels, strict=False):
        modelled = diagnosis.shown(group)[record.quantity.channel]
        measured, model = (record.quantity.values(v) for v in (record.output, modelled))
        dots = {"markersize": 2, "color": COLOURS["measured"], "rasterized": True, "label": "measured"}
        axis.plot(temperature[index], measured[index], ".", **dots)
        line: dict[str, Any] = {"color": colour, "linewidth": 0.9, "rasterized": True, "label": name}
        model = np.where(read, model, np.nan)
        draw_line(axis, record.time_s, model, over=temperature, breaks=record.first_rows, **line)
        if record.quantity.is_resistance:
            log_scale(axis)
        axis.legend(loc="upper right", markerscale=4, fontsize=9)
        axis.set_xlabel("plate's temperature / \N{DEGREE SIGN}C")
    axes[0, 0].set_ylabel("resistance / ohm" if record.quantity.is_resistance else record.quantity.column)
    if len(panels) == 1:
        axes[0, 1].remove()
    return fig
