"""peltier predict MODEL.toml RECORD... [--out F]: the model against records that it was not fitted to, each by itself.

temperature_degC drives the film from `initial` at the first row, as it was read; with current_A and a [plate] the
temperature is simulated from the current too, never one step ahead. With --drive current, by default where the model
says so or has [[effects]], the film follows the simulated plate. With --initial fitted what belongs to the record
(room, first temperatures, memory) is fitted to its first rows, which are not scored.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rig.command.record_arguments import (
    add_json_argument,
    add_record_arguments,
    read_records,
    writable_file,
    writable_parent,
)
from rig.command.say import Voice
from rig.core.faults import fault
from rig.files.film_output import column_of, in_decades, sign_of
from rig.files.record_file import Record, unit_of, write_columns

if TYPE_CHECKING:
    from rig.analysis.predicted import Prediction
    from rig.files.model_file import Model


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("model", type=Path, metavar="MODEL.toml")
    parser.add_argument("records", type=Path, nargs="+", metavar="RECORD")
    add_record_arguments(parser)
    parser.add_argument(
        "--initial",
        choices=["cooled", "heated", "fitted"],
        help="the film's memory; default: the model's own. fitted: with room and first temperatures, to the first rows",
    )
    parser.add_argument(
        "--first", type=float, metavar="SECONDS", help="of first rows that are fitted (30 s or 20 rows, the longer)"
    )
    parser.add_argument(
        "--drive",
        choices=["current", "temperature"],
        help="what the film follows: the simulated plate or the thermometer; default: as the model says",
    )
    parser.add_argument(
        "--effect-file",
        action="append",
        default=[],
        type=Path,
        metavar="FILE",
        help="a Python file with an effect of one's own that the model has (repeatable)",
    )
    parser.add_argument("--out", type=Path, metavar="F", help="the record's columns with the predictions, CSV")
    parser.add_argument("--report", type=Path, metavar="DIR", help="report.html, figures and prediction.json there")
    add_json_argument(parser)


def main(options: argparse.Namespace) -> int:
    from rig.experiment.feasible import order_warning
    from rig.files.model_file import read_model

    several = len(options.records) > 1
    if options.out is not None:
        if several:
            raise fault("--out", str(options.out), "expected a single RECORD; --report DIR writes a page for each")
        writable_file(options.out)
    if options.report is not None:
        writable_parent(options.report)
    voice = Voice(options.json)
    if options.effect_file:
        from rig.files.effect_tables import add_effect_files

        add_effect_files(options.effect_file)
    model = read_model(options.model)
    records = read_records(options.records, options)
    for record in records:
        if model.film is None and not (model.plate is not None and record.has("current_A")):
            text = f"missing; expected a [film], or a [plate] and current_A in {record.source}"
            raise fault(options.model, "film", text)
    warning = order_warning(model.film, options.model) if model.film is not None else None
    if warning is not None:
        print(warning, file=sys.stderr)
    results = []
    for path, record in zip(options.records, records, strict=True):
        folder = options.report
        if several:
            voice.say(f"{record.source}:")
            folder = options.report / path.stem if options.report is not None else None
        results.append(_predicted(model, record, folder, options, voice))
    voice.report(results if several else results[0])
    return 0


def _predicted(
    model: Model, record: Record, folder: Path | None, options: argparse.Namespace, voice: Voice
) -> dict[str, Any]:
    """One record beside the model: lines, files, and the JSON."""
    from rig.analysis.predicted import needs_test_current, predicted

    columns: dict[str, Any] = {**record.columns, **record.text_columns}
    result: dict[str, Any] = {"format": "peltier-prediction/1", "model": options.model, "record": record.source}
    channels = {}
    if model.film is not None and needs_test_current(model.switched()) and not record.has("meter_current_A"):
        print(f"{record.source}: no meter_current_A: the model's self-heating is left out", file=sys.stderr)
    how = {"initial": options.initial, "drive": options.drive, "first_s": options.first}
    found = predicted(model, record, options.model, **how)
    if found.driven_by is not None:
        result["film_driven_by"] = found.driven_by
    if found.own is not None:
        result["fitted"] = _fitted(model, found, voice)
    scored = ~found.told
    if model.film is not None and found.output is not None:
        name = model.film.output
        quantity = sign_of(name) * found.output
        columns[_predicted_column(name)] = 10.0**quantity if in_decades(name) else quantity
        if record.has_output(name):
            what = "log R" if in_decades(name) else column_of(name)
            _report(result, (found.output - record.output(name))[scored], unit_of(name), what, voice)
            channels[name] = record.output(name), found.output
    if found.temperature_degC is not None:
        columns["predicted_degC"] = found.temperature_degC
        _report(result, (found.temperature_degC - record["temperature_degC"])[scored], "K", "temperature", voice)
        channels["temperature_degC"] = record["temperature_degC"], found.temperature_degC
    if not any(key.startswith("rmse") for key in result):
        voice.say(f"{record.source}: nothing to compare: neither readings of the film nor temperature with current")
    if options.out is not None:
        write_columns(options.out, columns)
        voice.say(f"predictions: {options.out}")
    if folder is not None:
        from rig.report.prediction import write_prediction_report

        folder.mkdir(parents=True, exist_ok=True)
        write_prediction_report(folder, result, record["time_s"], record["temperature_degC"], channels)
        voice.say(f"report: {folder / 'report.html'}")
    return result


def _fitted(model: Model, found: Prediction, voice: Voice) -> dict[str, Any]:
    """What belongs to the record, as it was fitted."""
    assert found.own is not None
    film = found.own.film
    fitted: dict[str, Any] = {"rows": int(np.sum(found.told))}
    if model.plate is not None and found.temperature_degC is not None:
        fitted["ambient_degC"] = found.own.ambient_degC
        fitted["first_degC"] = float(found.own.plate_degC[0])
    if model.film is not None:
        fitted |= {"memory": film.initial, "turned_at_degC": film.previous_degC}
    said = ", ".join(f"{name} {_short(value)}" for name, value in fitted.items() if name != "rows")
    voice.say(f"fitted to the first {fitted['rows']} rows: {said}")
    return fitted


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else "none" if value is None else str(value)


def _predicted_column(output: str) -> str:
    """What the prediction of an output is called in a file."""
    ohm = in_decades(output) or column_of(output) == "resistance_ohm"
    return "predicted_ohm" if ohm else f"predicted_{column_of(output)}"


def _report(result: dict[str, Any], error: np.ndarray, unit: str, what: str, voice: Voice) -> None:
    error = error[np.isfinite(error)]
    if error.size == 0:
        return
    rmse, largest = float(np.sqrt(np.mean(error**2))), float(np.max(np.abs(error)))
    result |= {f"rmse_{unit}": rmse, f"max_abs_{unit}": largest, f"rows_{unit}": int(error.size)}
    voice.say(f"{what}: RMSE {rmse:.4f} {unit}, largest {largest:.4f} {unit}, {error.size} rows")
