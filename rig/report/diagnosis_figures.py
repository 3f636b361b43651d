"""Figures of a diagnosis: what is gained, residuals of the base and of the extended model, the loop."""

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
MILLI = 0.3  # below it a figure is in thousandths


def gain_figure(folder: Path, diagnosis: Diagnosis) -> str:
    """Held-out error before, after, and the noise, a panel for each channel."""
    caption = "Root mean square error of a simulation over the whole record, on held-out rows, beside the noise."
    return figure(saved(drawn_gain(diagnosis), folder, "gain"), caption)


def drawn_gain(diagnosis: Diagnosis) -> Figure:
    """The same, not yet in a file."""
    channels = judged_channels(diagnosis)
    fig, axes = grid(1, len(channels), 1.7)
    for axis, (what, unit, channel) in zip(axes[0], channels, strict=True):
        scale, prefix = _scale(channel.rmse_base)
        values = [scale * v for v in (channel.noise, channel.rmse_extended, channel.rmse_base)]
        names = ["noise", "extended model", "base model"]
        axis.barh(names, values, color=[NOISE, EXTENDED, BASE], height=0.62)
        for k, value in enumerate(values):
            axis.annotate(f" {value:.3g}", (value, k), va="center", fontsize=9.5)
        axis.set_xlim(0.0, 1.14 * max(values))
        axis.set_title(f"{what}: error on held-out rows / {prefix}{unit}", fontsize=10, loc="left")
        axis.grid(visible=False, axis="y")
        axis.tick_params(axis="y", length=0)
    return fig


def _scale(size: float) -> tuple[float, str]:
    return (1e3, "m") if size < MILLI else (1.0, "")


def residuals(diagnosis: Diagnosis, fit: Fit) -> dict[str, Array]:
    """Measured - model, in K and in decades of R or the film's own unit, nan where there is no reading; shape (rows,)
    each."""
    record, out = diagnosis.record, {}
    for key, values in diagnosis.shown(fit).items():
        if key == "temperature_K":
            out[key] = np.where(record.temperature_used, residual(record.temperature_degC, values), np.nan)
        elif record.output is not None:
            left = record.quantity.size * residual(record.output, values, record.quantity.name)
            out[key] = np.where(record.output_used, left, np.nan)
    return out


def course_figure(folder: Path, diagnosis: Diagnosis) -> str:
    """The thermometer's readings and both models' over time, and the current that drove the plate."""
    caption = "The temperature as measured, and as the models simulate it from the current alone."
    return figure(saved(drawn_course(diagnosis), folder, "course"), caption)


def drawn_course(diagnosis: Diagnosis) -> Figure:
    """The same, not yet in a file."""
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
    """The fit, colour and name of the models that are shown: the extended one, where it is another, too."""
    models = [(diagnosis.base, BASE, "base model"), (diagnosis.fit, EXTENDED, "extended model")]
    return models if _extends(diagnosis) else [(diagnosis.fit, EXTENDED, "model")]


def _extends(diagnosis: Diagnosis) -> bool:
    return diagnosis.fit.effects != diagnosis.base.effects


def _breaks(record: Record) -> list[int]:
    """The rows before which no line goes on: after gaps, and where another record begins."""
    return sorted({*record.after_gaps.tolist(), *record.joined.tolist()})


def residual_figures(folder: Path, diagnosis: Diagnosis) -> list[str]:
    """Residuals against time, temperature, rate and what drove, a figure for each channel."""
    before, after = residuals(diagnosis, diagnosis.base), residuals(diagnosis, diagnosis.fit)
    against = _against(diagnosis)
    return [_residual(folder, diagnosis, against, key, before[key], after[key]) for key in after]


def _against(diagnosis: Diagnosis) -> list[tuple[str, Array]]:
    """What residuals are shown against."""
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
        return "time / s, one record after the other, each with its own times", record.time_s
    return "time / s", record.file_s


def _drive(diagnosis: Diagnosis) -> str:
    share = diagnosis.drive is not None or (diagnosis.plate is not None and diagnosis.plate.kind == "heater")
    return "drive / of full drive" if share else "current / A"


def _rate(temperature_degC: Array, time_s: Array) -> Array:
    """Of one record, K/s, smoothed over a few rows; nan where too few were read."""
    good = np.isfinite(temperature_degC)
    if np.sum(good) < 2:
        return np.full(time_s.size, np.nan)
    even = np.interp(time_s, time_s[good], temperature_degC[good])
    width = 9 if time_s.size > 200 else 3
    smooth = np.convolve(np.pad(even, width // 2, mode="edge"), np.ones(width) / width, "valid")
    return np.asarray(np.gradient(smooth, time_s), dtype=np.float64)


def _times_of_each(axis: Axes, record: Record) -> None:
    """Records one after the other along an axis: a line where each begins, and the times of its own file."""
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
    what, unit = channels_of(diagnosis)[key]
    fig, axes = grid(2, 2, 4.6, sharey=True)
    spread = float(np.nanpercentile(np.abs(before), 99.5))
    scale, prefix = _scale(spread)
    good = np.flatnonzero(np.isfinite(before) & np.isfinite(after))
    index = good[np.unique(np.linspace(0, good.size - 1, min(MOST_DOTS, good.size)).astype(np.int64))]
    same = not _extends(diagnosis)
    sets = [(before, BASE, 2.2, "base model")] + ([] if same else [(after, EXTENDED, 1.6, "extended")])
    limit = 1.3 * scale * spread
    beyond = 0
    for axis, (label, x) in zip(axes.flat, against, strict=False):
        for left, colour, size, name in sets:
            axis.plot(x[index], scale * left[index], ".", color=colour, markersize=size, rasterized=True, label=name)
            far = good[np.abs(scale * left[good]) > limit]
            beyond = max(beyond, far.size)
            for sign, mark in ((1.0, "^"), (-1.0, "v")):
                there = far[sign * left[far] > 0.0]
                axis.plot(x[there], np.full(there.size, 0.97 * sign * limit), mark, color=colour, markersize=4)
        axis.set_xlabel(label)
        axis.set_ylim(-limit, limit)
    if diagnosis.record.joined.size:
        _times_of_each(axes[0, 0], diagnosis.record)
    for axis in list(axes.flat)[len(against) :]:
        axis.set_visible(False)
    for axis in axes[:, 0]:
        axis.set_ylabel(residual_label(f"{prefix}{unit}"))
    axes[0, 0].legend(loc="upper right", markerscale=4, fontsize=9, ncols=2)
    *others, last = [label.split(" / ")[0] for label, _ in against]
    caption = f"What is left in {what}: against {', '.join(others)} and {last}. Grey: base model"
    caption += "." if same else "; red: with the effects named."
    caption += " Triangles at the edge: readings beyond it." if beyond else ""
    return figure(saved(fig, folder, f"residual_{key}"), caption)


def loop_figure(folder: Path, diagnosis: Diagnosis) -> str:
    """Resistance, or what else was read, over temperature, measured and as the extended model shows it."""
    caption = "The loop as measured, and as base and extended model show it."
    return figure(saved(drawn_loop(diagnosis), folder, "loop"), caption)


def drawn_loop(diagnosis: Diagnosis) -> Figure:
    """The same, not yet in a file."""
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
