"""Pages that compare a model with records: of an identification, and of a prediction."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from compensator.hysteresis.functions import Array
from rig.analysis.error import residual, value_and_half
from rig.analysis.identification import FitOptions, Identified, PlateComparison, identified
from rig.analysis.prediction import ChannelError
from rig.analysis.table_row import of_identification
from rig.batch.engine import given
from rig.config.model_file import write_model
from rig.core.faults import Faults
from rig.core.file_writing import write_text
from rig.records.film_output import unit_of
from rig.records.record_file import Record
from rig.records.run_folder import plain_json
from rig.report.batch import MODEL, RecordReport, Task, files_in
from rig.report.figures import saved
from rig.report.model_figures import (
    derivative_figure,
    drawn_over_time,
    forc_figure,
    histogram_figure,
    loop_figure,
    plate_figure,
    residual_figure,
)
from rig.report.page import bullets, figure, paragraph, section, table, tiles, write_page
from sim.inference.transition.forc import Forc

Say = Callable[[str], None]
NOT_DETERMINED = "Warnings, and what this record cannot determine"
PLATE_HEAD = ("value", "95 %", "unit")
PLATE_PARAMETERS = {
    "seebeck_over_capacity_per_A_s": ("Seebeck coefficient / heat capacity, S/C", "1/(A s)"),
    "resistance_over_capacity_K_per_A2_s": ("resistance / heat capacity, R_e/C", "K/(A\N{SUPERSCRIPT TWO} s)"),
    "conductance_over_capacity_per_s": ("thermal conductance / heat capacity, G/C", "1/s"),
    "seebeck_slope_per_K": ("relative slope of S with temperature", "1/K"),
    "resistance_slope_per_K": ("relative slope of R_e with temperature", "1/K"),
    "drive_over_capacity_K_per_s": ("heating rate at full drive", "K/s"),
    "ambient_degC": ("room temperature", "\N{DEGREE SIGN}C"),
}


def report_identification(
    records: list[Record], options: FitOptions, models: Sequence[Path], report: Path | None, say: Say
) -> dict[str, Any]:
    """Fit one film and one plate to all records, and return the JSON of `peltier identify`. Raises Faults.

    models: files to write the model to; report: folder, which is there; say: called with each line for the terminal.
    """
    found = identified(records, options, say)
    for line in found.lines():
        say(line)
    result = found.document()
    for path in models:
        write_model(path, found.model, found.model_comment())
    if models:
        result["model"] = models[0]
    if report is not None:
        write_text(report / "identification.json", plain_json(result) + "\n")
        _write_identification_page(report, found, result)
    return result


def _report_one(record: Any, options: FitOptions, model: str | None = None) -> RecordReport:
    """Identify one record: a `Record`, or what an engine shares of it. model: path where its model will stand; None:
    nowhere, and no report is made."""
    lines: list[str] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        try:
            models, report = ([folder / MODEL], folder) if model is not None else ([], None)
            result = report_identification([given(record)], options, models, report, lines.append)
        except Faults as faults:
            return RecordReport(faults=tuple(faults.lines))
        files = files_in(folder)
    if model is not None:
        result["model"] = model
        files["identification.json"] = (plain_json(result) + "\n").encode()
    return RecordReport(result, tuple(lines), files)


def identifications(options: FitOptions) -> Task:
    """Return the task of identifying many records, each by itself."""
    return Task(
        work=_report_one,
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
    """Write report.html and figures/ in a folder that is there."""
    film, unit = result.get("film"), unit_of(found.output)
    parts: list[str] = []
    lead = f"From {', '.join(Path(source).name for source in result['records'])}."
    if film is not None:
        lead = f"The film model fits the record to {film[f'rmse_{unit}']:.3g} {unit} RMS. {lead}"
        numbers = [
            (f"{film[f'rmse_{unit}']:.3g} {unit}", "RMSE of the fit"),
            (f"{film[f'held_out_rmse_{unit}']:.3g} {unit}", "RMSE on held-out rows"),
            (f"{film[f'max_abs_{unit}']:.3g} {unit}", "largest error"),
            (f"{film['active_operators']}", f"operators with weight, {film['kind'].replace('_', ' ')}"),
            (film["memoryless"], "form of D(T)"),
        ]
        parts.append(tiles(numbers))
    if result["left_out"]:
        gone = [
            f"{Path(out['record']).name}: rows {out['rows'][0]} to {out['rows'][1]} ({out['from_s']:.12g} to "
            f"{out['to_s']:.12g} s) read {out['reads_degC']:.6g} degC: {out['rule']}"
            for out in result["left_out"]
        ]
        parts.append(section("Temperatures that were left out", bullets(gone)))
    compared = found.film_comparisons()
    for k, (one, own) in enumerate(zip(compared, found.numbers, strict=True)):
        suffix = f"_{k + 1}" if len(compared) > 1 else ""
        name = f" of {Path(one.source).name}" if suffix else ""
        parts.append(transition_section(folder, own.shown(), suffix, f"The transition{name}", own.forc))
        left = residual(one.measured, one.modelled, found.output)
        parts.append(
            section(
                f"The model over the record{name}",
                loop_figure(folder, one.time_s, one.degC, one.measured, one.modelled, found.output, suffix),
                residual_figure(folder, one.time_s, one.degC, left, unit, suffix),
            )
        )
    if film is not None:
        notes = film["identifiability"]
        parts.append(section(NOT_DETERMINED, bullets(notes) if notes else paragraph("Nothing of the film.")))
    if "plate" in result:
        parts.append(_plate(folder, result["plate"], found.plate_comparisons()))
    write_page(folder / "report.html", "Film and plate from a record", lead, parts)


def plate_row(name: str, value: float, half: float | None) -> list[str]:
    """Return a row of a plate's table. half: of the 95 % interval; None if the record does not determine it."""
    what, unit = PLATE_PARAMETERS.get(name, (name, ""))
    if half is None or not math.isfinite(half):
        return [what, f"{value:.3g}", "\N{EN DASH}", unit]
    shown, width = value_and_half(value, half)
    return [what, shown, f"\N{PLUS-MINUS SIGN} {width}", unit]


def _plate(folder: Path, plate: Mapping[str, Any], compared: Sequence[PlateComparison]) -> str:
    parameters = [
        plate_row(name, one["value"], 0.5 * float(np.ptp(one["ci95"]))) for name, one in plate["parameters"].items()
    ]
    figures = [plate_figure(folder, one, f"_{k + 1}" if len(compared) > 1 else "") for k, one in enumerate(compared)]
    kind = "Peltier plate" if plate["kind"] == "peltier" else "heater"
    fitted = (
        f"Residual of the {kind} model: {plate['rmse_K']:.3g} K RMS, {plate['max_abs_K']:.3g} K at most; "
        f"the thermometer's noise is {plate['noise_K']:.2g} K."
    )
    drive = " (per full drive in the place of A)" if plate["drive"] is not None else ""
    return section(
        "The plate",
        paragraph(fitted),
        *figures,
        table([f"parameter{drive}", *PLATE_HEAD], parameters),
        bullets(plate["identifiability"]),
    )


def transition_section(
    folder: Path, shown: Mapping[str, Any], suffix: str = "", title: str = "The transition", curves: Forc | None = None
) -> str:
    """Return the section on one record's transition, as `FilmNumbers.shown`. suffix: of the figures' names if a page
    shows several records; curves: its reversal curves, if their diagram is drawn."""
    rows = [[what, value.replace("+-", "\N{PLUS-MINUS SIGN}")] for what, value in shown["rows"]]
    parts = [table(["quantity", "value and 95 % interval"], rows), bullets(shown["notes"])]
    if shown["derivative"]:
        parts.append(derivative_figure(folder, shown["derivative"], f"derivative{suffix}", shown["ylabel"]))
    if curves is None or curves.reason or not np.any(np.isfinite(curves.density)):
        parts.append(paragraph(shown["forc"], "note"))
    else:
        parts.append(forc_figure(folder, curves, f"forc{suffix}"))
    return section(title, *parts)


def write_prediction_report(
    folder: Path, result: Mapping[str, Any], time_s: Array, degC: Array, errors: Sequence[ChannelError]
) -> None:
    """Write report.html, prediction.json and figures/ in a folder that is there."""
    write_text(folder / "prediction.json", plain_json(result) + "\n")
    parts, numbers = [], []
    for one in errors:
        plate = one.name == "temperature_degC"
        numbers += [
            (f"{one.rmse:.3g} {one.unit}", "RMSE of the " + ("temperature" if plate else "film's output")),
            (f"{one.max_abs:.3g} {one.unit}", "largest error"),
        ]
        suffix = "_plate" if plate else ""
        over_time = saved(drawn_over_time(time_s, [one]), folder, f"over_time{suffix}")
        shown = [figure(over_time, "Measured and predicted, over time.")]
        if not plate:
            shown.append(loop_figure(folder, time_s, degC, one.measured, one.predicted, one.name))
        shown += [
            residual_figure(folder, time_s, degC, one.residual, one.unit, suffix),
            histogram_figure(folder, one.residual, one.unit, suffix),
        ]
        parts.append(section("The plate's temperature" if plate else "The film", *shown))
    lead = f"{Path(str(result['model'])).name} against {Path(str(result['record'])).name}."
    if not parts:
        parts.append(paragraph("Nothing to compare: the record has no film and no temperature with a current."))
    write_page(folder / "report.html", "A prediction and its record", lead, [tiles(numbers), *parts])
