"""Pages and figures that compare a model with records: of an identification, and of a prediction."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import TwoSlopeNorm
from matplotlib.figure import Figure

from compensator.hysteresis.functions import Array
from rig.analysis.error import (
    OF_MODEL,
    in_brackets,
    judgement,
    percent,
    residual,
    residual_label,
    split_unit,
    value_and_half,
)
from rig.analysis.identification import MISFIT, FitOptions, Identified, identified
from rig.analysis.prediction import ChannelError
from rig.analysis.trend import of_identification
from rig.batch import given
from rig.config.model_file import write_model
from rig.core.faults import Faults
from rig.core.file_writing import write_text
from rig.records.film_output import in_decades, unit_of
from rig.records.record_file import Record
from rig.records.run_folder import plain_json
from rig.report import page
from rig.report.batch import MODEL, RecordReport, Task, files_in
from sim.inference.transition.forc import Forc

SENSE_COLOURS = {"heating": page.COLOURS["model"], "cooling": page.COLOURS["measured"]}
DEGREE = "\N{DEGREE SIGN}C"
LOOP = "The record, and the model over it."
MODEL_LINE = (0, (4, 2))  # dashes, through which the readings are seen


def shown_output(values: Array, output: str) -> Array:
    """Return the output as people read it: ohms, or the quantity with its own sign."""
    if in_decades(output):
        return np.asarray(10.0 ** (-values if output == "minus_log10_ohm" else values), dtype=np.float64)
    return -values if output.startswith("minus_") else values


def label_of(output: str) -> str:
    if in_decades(output):
        return "resistance / ohm"
    name = output.removeprefix("minus_")
    return f"{name.partition('_')[0]} / {unit_of(output)}"


def plate_figure(folder: Path, record: Record, simulated_degC: Array, suffix: str = "") -> str:
    """Draw measured and simulated temperature over time, the residual, and the drive; return the page's figure."""
    time, degC = record["time_s"], record["temperature_degC"]
    fig, axes = page.new_figure(3, 6.4, [3.0, 1.6, 1.4])
    draw_measured_and_model(axes[0], time, degC, simulated_degC)
    draw_residual(axes[1], time, residual(degC, simulated_degC))
    page.draw_line(axes[2], time, record["current_A"], held=True, color=page.COLOURS["current"], linewidth=0.9)
    axes[0].set_ylabel(f"temperature / {DEGREE}")
    axes[1].set_ylabel("measured - model\n/ K")
    axes[2].set(xlabel="time / s", ylabel="current / A" if record.drive is None else "drive\n/ of full drive")
    return page.saved(fig, folder, f"plate{suffix}", "The plate's temperature, simulated from its drive alone.")


def draw_measured_and_model(axes: Axes, time_s: Array, measured: Array, model: Array) -> None:
    """Draw both over time, with a legend."""
    page.draw_line(axes, time_s, measured, color=page.COLOURS["measured"], label="measured")
    page.draw_line(axes, time_s, model, color=page.COLOURS["model"], linestyle=MODEL_LINE, linewidth=1.1, label="model")
    page.legend_above(axes)


def draw_residual(axes: Axes, over: Array, left: Array) -> None:
    axes.axhline(0.0, color=page.EDGE, linewidth=0.6)
    axes.plot(*page.thinned(over, left), ".", markersize=2, color=page.COLOURS["model"])


def drawn_over_time(time_s: Array, errors: Sequence[ChannelError]) -> Figure:
    """Draw measured and predicted over time, a panel for each channel."""
    fig, axes = page.new_figure(max(1, len(errors)), 3.4 * max(1, len(errors)))
    for axis, error in zip(axes, errors, strict=False):
        shown, label = [error.measured, error.predicted], f"temperature / {DEGREE}"
        if error.name != "temperature_degC":
            shown, label = [shown_output(values, error.name) for values in shown], label_of(error.name)
        draw_measured_and_model(axis, time_s, *shown)
        axis.set_ylabel(label)
        if in_decades(error.name):
            page.log_scale(axis)
    axes[-1].set_xlabel("time / s")
    return fig


def drawn_loop(time_s: Array, degC: Array, measured: Array, model: Array, output: str) -> Figure:
    """Draw output over temperature, measured and modelled, arrays of shape (rows,)."""
    fig, (axes,) = page.new_figure(1, 4.6)
    dots = page.thinned(degC, shown_output(measured, output))
    axes.plot(*dots, ".", markersize=3, color=page.COLOURS["measured"], label="measured")
    line: dict[str, Any] = {"color": page.COLOURS["model"], "linewidth": 1.1, "label": "model"}
    page.draw_line(axes, time_s, shown_output(model, output), over=degC, **line)
    axes.set(xlabel=f"temperature / {DEGREE}", ylabel=label_of(output))
    if in_decades(output):
        page.log_scale(axes)
    axes.legend(loc="best")
    return fig


def residual_figure(folder: Path, time_s: Array, degC: Array, left: Array, unit: str, suffix: str = "") -> str:
    """Draw the residual over time and over temperature, arrays of shape (rows,); return the page's figure."""
    fig, ((over_time, over_degC),) = page.grid(1, 2, 2.9, sharey=True)
    draw_residual(over_time, time_s, left)
    draw_residual(over_degC, degC, left)
    over_time.set(xlabel="time / s", ylabel=residual_label(unit))
    over_degC.set_xlabel(f"temperature / {DEGREE}")
    caption = f"The residual{' of log10 R' * (unit == 'dec')} over time and over temperature."
    return page.saved(fig, folder, f"residual{suffix}", caption)


def derivative_figure(folder: Path, curves: Mapping[str, Mapping[str, Any]], name: str, ylabel: str) -> str:
    """Draw the derivative of both branches with their bands, and mark the transition temperatures. curves: as of
    `FilmNumbers.shown`."""
    fig, (axes,) = page.new_figure(1, 3.8)
    for sense, curve in curves.items():
        degC, slope, half = (np.asarray(curve[key]) for key in ("degC", "slope", "half_width"))
        colour, place = SENSE_COLOURS[sense], curve["steepest_degC"]
        axes.plot(degC, slope, color=colour, label=sense)
        axes.fill_between(degC, slope - half, slope + half, color=colour, alpha=0.2, linewidth=0)
        if place is not None:
            axes.axvline(place, color=colour, linestyle="--", linewidth=1.0)
            above: dict[str, Any] = {
                "xy": (place, 1.01),
                "xycoords": ("data", "axes fraction"),
            }  # the axes, where no curve is
            side = "left" if sense == "heating" else "right"
            axes.annotate(f" {place:.1f} {DEGREE} ", ha=side, color=colour, **above)
    axes.set(xlabel=f"temperature / {DEGREE}", ylabel=ylabel)
    axes.legend(loc="best")
    caption = "The derivative of each major branch with its 95 % band, and the transition temperatures."
    return page.saved(fig, folder, name, caption)


def forc_figure(folder: Path, forc: Forc, name: str) -> str:
    """Draw the distribution of the first-order reversal curves."""
    fig, (axes,) = page.new_figure(1, 4.8)
    most = float(np.nanquantile(np.abs(forc.density), 0.995))
    density = np.ma.masked_invalid(forc.density)
    style: dict[str, Any] = {"cmap": "RdBu_r", "norm": TwoSlopeNorm(0.0, -most, most), "rasterized": True}
    mesh = axes.pcolormesh(forc.grid_degC, forc.grid_reversal_degC, density, shading="nearest", **style)
    fig.colorbar(mesh, ax=axes).set_label("rho / (1/K\N{SUPERSCRIPT TWO})")
    axes.plot(forc.reversal_degC, forc.reversal_degC, ".", color=page.GREEN, markersize=4)
    axes.set(xlabel=f"temperature T / {DEGREE}", ylabel=f"reversal T_r / {DEGREE}")
    axes.grid(visible=False)
    caption = (
        f"FORC diagram of the readings, {forc.reversal_degC.size} curves of {forc.sense}; dots: where they turn round. "
        f"Windows {2 * forc.window_K[0]:.1f} K along T_r, {2 * forc.window_K[1]:.1f} K along T."
    )
    return page.saved(fig, folder, name, caption)


NOT_DETERMINED = "Warnings, and what this record cannot determine"


def report_identification(
    record: Any,
    options: FitOptions,
    model: str | None = None,
    *,
    report: bool | None = None,
    further: Sequence[Record] = (),
    say: Callable[[str], None] | None = None,
) -> RecordReport:
    """Fit one film and one plate to a record, or to it and `further` ones together.

    record: a `Record`, or what an engine shares of it. model: where its model will stand; None: nowhere. report: True
    if its files are wanted; None: where the model is. say: takes each decision on the way; None: they are lines.
    """
    lines: list[str] = []
    try:
        found = identified([given(record), *further], options, say or lines.append)
    except Faults as faults:
        return RecordReport(faults=tuple(faults.lines))
    result = found.document() | ({} if model is None else {"model": model})
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if model is not None:
            write_model(folder / MODEL, found.model, found.model_comment())
        if report if report is not None else model is not None:
            write_text(folder / "identification.json", plain_json(result) + "\n")
            _write_identification_page(folder, found, result)
        return RecordReport(result, (*lines, *found.lines()), files_in(folder))


def identifications(options: FitOptions) -> Task:
    """Return the task of identifying many records, each by itself."""
    return Task(
        work=report_identification,
        options=options,
        document="identification.json",
        table="identifications",
        title="Identifications",
        row=of_identification,
        rank=lambda row: (row["status"] == "done", int(row["number"])),
        columns={
            "film": "film",
            "film_rmse": "RMSE of the film",
            "heating_degC": "on heating, degC",
            "cooling_degC": "on cooling, degC",
            "plate": "plate",
            "plate_rmse_K": "RMSE of the plate, K",
        },
    )


def _write_identification_page(folder: Path, found: Identified, result: Mapping[str, Any]) -> None:
    film, unit = result.get("film"), unit_of(found.output)
    parts: list[str] = []
    lead = f"From {', '.join(Path(source).name for source in result['records'])}."
    if film is not None:
        error = film[f"held_out_rmse_{unit}"]
        share, judged = percent(error) if unit == "dec" else "", judgement(error, unit, OF_MODEL)
        lead = f"The film model has an RMS error of {error:.3g} {unit}{in_brackets(share, judged)}. {lead}"
        numbers = [
            (f"{error:.3g} {unit}", f"RMS error on held-out rows{in_brackets(judged)}"),
            (f"{film[f'rmse_{unit}']:.3g} {unit}", "RMS error on fitted rows"),
            (f"{film[f'max_abs_{unit}']:.3g} {unit}", "largest error"),
        ]
        form = [[film["kind"].replace("_", " "), "kind"], [str(film["active_operators"]), "operators"]]
        form.append([film["memoryless"], "form of D(T), the part without hysteresis"])
        parts += [page.tiles(numbers), page.details("The film model's form", page.table(["value", "of"], form))]
    if result["left_out"]:
        gone = [
            f"{Path(out['record']).name}: rows {out['rows'][0]} to {out['rows'][1]} ({out['from_s']:.12g} to "
            f"{out['to_s']:.12g} s) read {out['reads_degC']:.6g} degC: {out['rule']}"
            for out in result["left_out"]
        ]
        parts.append(page.section("Temperatures that were left out", page.bullets(gone)))
    for k, (course, own) in enumerate(zip(found.courses(), found.numbers, strict=True)):
        several = len(found.numbers) > 1
        suffix, name = (f"_{k + 1}", f" of {Path(found.film_records[k].source).name}") if several else ("", "")
        parts.append(transition_section(folder, own.shown(), suffix, f"The transition{name}", own.forc))
        time, degC, measured, modelled = course
        loop = page.saved(drawn_loop(*course, found.output), folder, f"loop{suffix}", LOOP)
        left = residual_figure(folder, time, degC, residual(measured, modelled, found.output), unit, suffix)
        parts.append(page.section(f"The model over the record{name}", loop, left))
    if film is not None:
        notes = found.doubts()
        none = page.paragraph("No warning: the record determines the film.")
        parts.append(page.section(NOT_DETERMINED, page.bullets(notes) if notes else none))
    if "plate" in result:
        assert found.plate is not None
        simulated = list(zip(found.plate_records, found.plate.simulated_degC, strict=True))
        parts.append(_plate(folder, result["plate"], simulated))
    page.write_page(folder / "report.html", "Film and plate from a record", lead, parts)


def plate_table(parameters: Iterable[tuple[str, float, float | None]], head: str = "parameter") -> str:
    """Return the table of a plate. parameters: name, value, and half of the 95 % interval, None if the record does not
    determine it."""
    rows = []
    for name, value, half in parameters:
        what, unit = split_unit(name)
        if half is None or not math.isfinite(half):
            rows.append([what, f"{value:.3g}", "\N{EN DASH}", unit])
        elif half > abs(value) and "slope" in name:
            rows.append([what, "not determined", f"within \N{PLUS-MINUS SIGN} {abs(value) + half:.2g}", unit])
        else:
            shown, width = value_and_half(value, half)
            rows.append([what, shown, f"\N{PLUS-MINUS SIGN} {width}", unit])
    return page.table([head, "value", "95 %", "unit"], rows)


def _plate(folder: Path, plate: Mapping[str, Any], simulated: Sequence[tuple[Record, Array]]) -> str:
    off = plate["rmse_K"] > MISFIT * plate["noise_K"]  # so that its intervals are too narrow to be shown
    found = [
        (name, one["value"], None if off else 0.5 * float(np.ptp(one["ci95"])))
        for name, one in plate["parameters"].items()
    ]
    suffixes = [f"_{k + 1}" for k in range(len(simulated))] if len(simulated) > 1 else [""]
    figures = [plate_figure(folder, *one, suffix) for one, suffix in zip(simulated, suffixes, strict=True)]
    kind = "Peltier plate" if plate["kind"] == "peltier" else "heater"
    fitted = (
        f"Residual of the {kind} model: {plate['rmse_K']:.3g} K RMS"
        f"{in_brackets(judgement(plate['rmse_K'], 'K', OF_MODEL))}, {plate['max_abs_K']:.3g} K at most; "
        f"the thermometer's noise is {plate['noise_K']:.2g} K."
    )
    drive = " (per full drive in the place of A)" if plate["drive"] is not None else ""
    numbers = plate_table(found, f"parameter{drive}")
    return page.section("The plate", page.paragraph(fitted), *figures, numbers, page.bullets(plate["identifiability"]))


def transition_section(
    folder: Path, shown: Mapping[str, Any], suffix: str = "", title: str = "The transition", curves: Forc | None = None
) -> str:
    """Return the section on one record's transition, as `FilmNumbers.shown`. suffix: of the figures' names if a page
    shows several records; curves: its reversal curves, if their diagram is drawn."""
    rows = shown["rows"]
    parts = [page.table(["quantity", "value and 95 % interval"], rows)] if rows else []
    parts.append(page.bullets(shown["notes"]))
    if shown["derivative"]:
        parts.append(derivative_figure(folder, shown["derivative"], f"derivative{suffix}", shown["ylabel"]))
    if curves is None or curves.reason or not np.any(np.isfinite(curves.density)):
        parts.append(page.details("No FORC diagram", page.paragraph(shown["forc"], "note")))
    else:
        parts.append(forc_figure(folder, curves, f"forc{suffix}"))
    return page.section(title, *parts)


def write_prediction_report(
    folder: Path, result: Mapping[str, Any], time_s: Array, degC: Array, errors: Sequence[ChannelError]
) -> None:
    """Write report.html, prediction.json and figures/ in a folder that is there."""
    write_text(folder / "prediction.json", plain_json(result) + "\n")
    parts, numbers = [], []
    for one in errors:
        plate = one.name == "temperature_degC"
        numbers += [
            (
                f"{one.rmse:.3g} {one.unit}",
                f"RMS error of the {'temperature' if plate else 'film'}"
                f"{in_brackets(judgement(one.rmse, one.unit, OF_MODEL))}",
            ),
            (f"{one.max_abs:.3g} {one.unit}", "largest error"),
        ]
        suffix = "_plate" if plate else ""
        caption = "Measured and predicted, over time."
        shown = [page.saved(drawn_over_time(time_s, [one]), folder, f"over_time{suffix}", caption)]
        if not plate:
            loop = drawn_loop(time_s, degC, one.measured, one.predicted, one.name)
            shown.append(page.saved(loop, folder, "loop", LOOP))
        shown.append(residual_figure(folder, time_s, degC, one.residual, one.unit, suffix))
        parts.append(page.section("The plate's temperature" if plate else "The film", *shown))
    lead = f"{Path(str(result['model'])).name} against {Path(str(result['record'])).name}."
    if not parts:
        parts.append(page.paragraph("Nothing to compare: the record has no film and no temperature with a current."))
    page.write_page(folder / "report.html", "A prediction and its record", lead, [page.tiles(numbers), *parts])
