"""peltier predict MODEL.toml RECORD [--out F]: the model against a record that it was not fitted to.

temperature_degC drives the film from `initial` at the first row, as it was read; with current_A and a [plate] the
temperature is simulated from the current too, never one step ahead. A model with [[effects]] is simulated with them:
from the current, where record and model allow it, so that the film follows the simulated plate; else film and ohmmeter
alone, from the temperature as it was read.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path
from typing import Any

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


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("model", type=Path, metavar="MODEL.toml")
    parser.add_argument("record", type=Path, metavar="RECORD")
    add_record_arguments(parser)
    parser.add_argument("--initial", choices=["cooled", "heated", "fitted"], help="default: the model's own")
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
    from rig.analysis.predicted import needs_test_current, plate_temperatures, with_effects
    from rig.experiment.feasible import order_warning
    from rig.files.model_file import read_model

    if options.out is not None:
        writable_file(options.out)
    if options.report is not None:
        writable_parent(options.report)
    voice = Voice(options.json)
    if options.effect_file:
        from rig.files.effect_tables import add_effect_files

        add_effect_files(options.effect_file)
    model = read_model(options.model)
    (record,) = read_records([options.record], options)
    if model.film is None and not (model.plate is not None and record.has("current_A")):
        raise fault(options.model, "film", "missing; expected a [film], or a [plate] and a record with current_A")
    columns: dict[str, Any] = {**record.columns, **record.text_columns}
    result: dict[str, Any] = {"format": "peltier-prediction/1", "model": options.model, "record": record.source}
    simulated, channels = None, {}
    if model.film is not None:
        warning = order_warning(model.film, options.model)
        if warning is not None:
            print(warning, file=sys.stderr)
        if model.effects:
            if needs_test_current(model.switched()) and not record.has("meter_current_A"):
                print(f"{record.source}: no meter_current_A: the model's self-heating is left out", file=sys.stderr)
            memory = _memory(model.film, record, options.initial, options.record)
            predicted, simulated, result["film_driven_by"] = with_effects(model, record, memory, options.model)
        else:
            predicted = _film(model.film, record, options.initial, options.record)
        name = model.film.output
        if in_decades(name):
            columns["predicted_ohm"] = 10.0 ** (sign_of(name) * predicted)
        else:
            shown = "ohm" if column_of(name) == "resistance_ohm" else column_of(name)
            columns[f"predicted_{shown}"] = sign_of(name) * predicted
        if record.has_output(name):
            what = "log R" if in_decades(name) else column_of(name)
            _report(result, predicted - record.output(name), unit_of(name), what, voice)
            channels[name] = record.output(name), predicted
    if model.plate is not None and record.has("current_A"):
        if simulated is None:
            simulated = plate_temperatures(model, record)
        columns["predicted_degC"] = simulated
        _report(result, simulated - record["temperature_degC"], "K", "temperature", voice)
        channels["temperature_degC"] = record["temperature_degC"], simulated
    if not any(key.startswith("rmse") for key in result):
        voice.say(f"{record.source}: nothing to compare: neither readings of the film nor temperature with current")
    if options.out is not None:
        write_columns(options.out, columns)
        voice.say(f"predictions: {options.out}")
    if options.report is not None:
        from rig.report.prediction import write_prediction_report

        options.report.mkdir(exist_ok=True)
        write_prediction_report(options.report, result, record["time_s"], record["temperature_degC"], channels)
        voice.say(f"report: {options.report / 'report.html'}")
    voice.report(result)
    return 0


def _report(result: dict[str, Any], error: np.ndarray, unit: str, what: str, voice: Voice) -> None:
    error = error[np.isfinite(error)]
    if error.size == 0:
        return
    rmse, largest = float(np.sqrt(np.mean(error**2))), float(np.max(np.abs(error)))
    result |= {f"rmse_{unit}": rmse, f"max_abs_{unit}": largest, f"rows_{unit}": int(error.size)}
    voice.say(f"{what}: RMSE {rmse:.4f} {unit}, largest {largest:.4f} {unit}, {error.size} rows")


def _film(film: Any, record: Record, initial: str | None, path: Path) -> np.ndarray:
    """The film's output at every row; rows without a temperature get nan, and the film rests there."""
    temperature = record["temperature_degC"]
    known = np.isfinite(temperature)
    outputs, _ = film.simulate(temperature[known], _memory(film, record, initial, path))
    predicted = np.full(temperature.size, math.nan)
    predicted[known] = outputs
    return predicted


def _memory(film: Any, record: Record, initial: str | None, path: Path) -> Any:
    """The film's memory at the first row with a temperature."""
    temperature = record["temperature_degC"]
    known = np.isfinite(temperature)
    if not np.any(known):
        raise fault(path, "temperature_degC", "no finite number")
    if initial != "fitted":
        return film.initial_memory(float(temperature[known][0]), initial)
    output = record.output(film.output)[known] if record.has_output(film.output) else None
    return _fitted_memory(film, temperature[known], output, path)


def _fitted_memory(film: Any, inputs: np.ndarray, output: np.ndarray | None, path: Path) -> Any:
    """The memory at the first row, of those after one earlier turning point, that suits the readings best."""
    if output is None:
        raise fault(path, film.output, "missing; --initial fitted needs readings to fit to")
    low, high = float(inputs.min()) - 40.0, float(inputs.max()) + 40.0
    candidates = []
    for initial, far in (("cooled", low), ("heated", high)):
        for turn in np.linspace(float(inputs[0]), far, 81):
            start = film.initial_memory(float(turn), initial)
            _, memory = film.simulate(np.array([inputs[0]]), start)
            error = film.simulate(inputs, memory)[0] - output
            candidates.append((float(np.nanmean(error**2)), memory))
    return min(candidates, key=lambda pair: pair[0])[1]
