"""peltier identify RECORD... [--out MODEL.toml]: film and plate models from records, with error bars.

A record with temperature and resistance gives a film, one with temperature and current a plate, one with all both.
"""

from __future__ import annotations

import argparse
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
from rig.core.faults import Faults, fault
from rig.files.film_output import column_of, other_sense
from rig.files.record_file import Record, unit_of

if TYPE_CHECKING:
    from compensator.hysteresis.film import FilmModel
    from compensator.identification.film import FilmFit, FilmRecord
    from compensator.identification.plate import PlateFit
    from rig.analysis.film_numbers import FilmNumbers
    from rig.report.identification import Compared

FALLS = -0.5  # correlation with temperature, below which the output's other sign is taken: a model's output rises
MISFIT = 2.0  # times the noise: beyond it a model does not describe its record


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("records", type=Path, nargs="+", metavar="RECORD")
    add_record_arguments(parser)
    parser.add_argument("--out", type=Path, metavar="MODEL.toml")
    parser.add_argument(
        "--report", type=Path, metavar="DIR", help="report.html, figures, identification.json and model.toml there"
    )
    add_json_argument(parser)
    parser.add_argument(
        "--kind",
        choices=["extended_generalized_pi", "generalized_pi", "mixed_envelopes"],
        help="of the film model; default: chosen by held-out rows",
    )
    parser.add_argument("--form", help="of the memoryless function D(T); default: chosen by held-out rows")
    parser.add_argument("--operators", type=int, default=30, help="play operators (30)")
    parser.add_argument("--initial", choices=["cooled", "heated", "fitted"], default="fitted")
    parser.add_argument(
        "--violate-order",
        action="store_true",
        help="allow radii that break the order condition (the output then jumps)",
    )
    parser.add_argument(
        "--compress", type=int, metavar="N", help="keep at most N operators in the model, and tell what that loses"
    )
    parser.add_argument(
        "--output",
        default="minus_log10_ohm",
        metavar="COLUMN",
        help="the film's output where it is not a resistance on a log scale: a column with its unit, as "
        "curvature_per_m or resistance_ohm",
    )
    parser.add_argument("--plate", choices=["peltier", "heater"], default="peltier", help="kind of the plate model")
    parser.add_argument("--seed", type=int, default=0)


def main(options: argparse.Namespace) -> int:
    if options.out is not None:
        writable_file(options.out)
    if options.report is not None:
        writable_parent(options.report)
    voice = Voice(options.json)
    records = read_records(options.records, options)
    with_film = [r for r in records if r.has_output(options.output)]
    with_plate = [r for r in records if r.has("current_A")]
    if not with_film and not with_plate:
        raise _nothing_to_fit(records, options.output)
    options.output = _rising(with_film, options.output, voice)
    film = _film(with_film, options) if with_film else None
    film_model = film.model if film is not None else None
    plate = _plate(with_plate, options) if with_plate else None
    from rig.analysis.film_numbers import numbers_of_record
    from rig.files.model_file import Model, write_model

    numbers: list[FilmNumbers] = []
    result: dict[str, Any] = {"format": "peltier-identification/1", "records": [r.source for r in records]}
    if film is not None:
        result["film"] = _tell_film(film, unit_of(options.output), voice)
        result["film"]["check"] = _checked(film.model, with_film, voice)
        film_model = _compressed(film.model, with_film, options, result["film"], voice)
        numbers = [numbers_of_record(record, options.output) for record in with_film]
        for one in numbers:
            for line in one.lines():
                voice.say(f"film: {line}" if len(numbers) == 1 else f"film: {one.source}: {line}")
        result["transition"] = [one.document() for one in numbers]
    if plate is not None:
        result["plate"] = _tell_plate(plate, with_plate[0].drive, voice)
        _tell_lag(_plate(with_plate, options, lag=True).lag_s if numbers else 0.0, numbers, result, voice)
    if options.report is not None:
        options.report.mkdir(exist_ok=True)
    paths = [path for path in (options.out, options.report / "model.toml" if options.report else None) if path]
    for path in paths:
        write_model(path, Model(film_model, plate.model if plate else None), _comment(options, records, result))
    if paths:
        voice.say(f"model: {paths[0]}")
        result["model"] = paths[0]
    if options.report is not None:
        from rig.report.identification import write_identification_report

        compared = _compared(film, with_film, options.output) if film is not None else []
        write_identification_report(options.report, result, compared, numbers, options.output)
        voice.say(f"report: {options.report / 'report.html'}")
    voice.report(result)
    return 0


def _rising(records: list[Record], output: str, voice: Voice) -> str:
    """The output, or its negative where it falls as temperature rises: a film model's output rises."""
    pairs = [(r["temperature_degC"], r.output(output)) for r in records]
    v, y = (np.concatenate(columns) for columns in zip(*pairs, strict=True)) if pairs else (np.empty(0), np.empty(0))
    good = np.isfinite(v) & np.isfinite(y)
    if int(np.sum(good)) < 3 or np.ptp(v[good]) == 0.0 or np.ptp(y[good]) == 0.0:
        return output
    if float(np.corrcoef(v[good], y[good])[0, 1]) >= FALLS:
        return output
    other = other_sense(output)
    voice.say(f"film: {output} falls as temperature rises: the model's output is {other}")
    return other


def _compared(film: FilmFit, records: list[Record], output: str) -> list[Compared]:
    """Each record beside the model that was fitted."""
    from compensator.identification.temperature_smoother import temperature_path
    from rig.report.identification import Compared

    found = []
    for record, memory in zip(records, film.memories, strict=True):
        time, path = record["time_s"], temperature_path(record["time_s"], record["temperature_degC"])
        modelled, _ = film.model.simulate(path.temperature_degC, memory)
        measured = record.output(output)
        if record.has("resistance_time_s"):
            read = np.where(np.isfinite(record["resistance_time_s"]), record["resistance_time_s"], time)
            modelled = np.interp(read, time, modelled)
        found.append(Compared(record.source, time, path.temperature_degC, measured, modelled))
    return found


def _comment(options: argparse.Namespace, records: list[Record], result: dict[str, Any]) -> str:
    """What a reader of the model file has to know of where it came from."""
    low, high = _temperatures(records)
    lines = ["identified from " + ", ".join(path.name for path in options.records)]
    lines.append(f"temperatures seen: {low:.1f} to {high:.1f} degC; outside them the model is a guess")
    for name in ("film", "plate"):
        lines += [f"{name}: {note}" for note in result.get(name, {}).get("identifiability", [])]
    return "\n".join(lines)


def _nothing_to_fit(records: list[Record], output: str) -> Faults:
    """Why there is neither a film nor a plate in the records."""
    name = column_of(output)
    lines = []
    for record in records:
        there = [column for column in (name, "current_A") if column in record.columns]
        what = f"{' and '.join(there)}: no finite number in {record.rows} rows" if there else "no such column"
        lines.append(f"{record.source}: {name}, current_A: {what}; expected one of them at least (--column maps names)")
    return Faults(lines)


def _said_of(records: list[Record], error: ValueError) -> Faults:
    """The fault with the record that it is about."""
    text = str(error)
    if any(text.startswith(record.source) for record in records):
        return Faults([text])
    return Faults([f"{', '.join(record.source for record in records)}: {text}"])


def _film(records: list[Record], options: argparse.Namespace) -> FilmFit:
    from compensator.identification.film import identify_film_records

    inputs = [_film_record(r, options.output) for r in records]
    try:
        return identify_film_records(
            inputs,
            kind=options.kind,
            form=options.form,
            operators=options.operators,
            initial=options.initial,
            ordered=not options.violate_order,
            output_name=options.output,
            seed=options.seed,
        )
    except ValueError as error:
        raise _said_of(records, error) from None


def _film_record(record: Record, output: str) -> FilmRecord:
    """Readings of the resistance with their own times, where the record has them."""
    from compensator.identification.film import FilmRecord

    own_times = record["resistance_time_s"] if record.has("resistance_time_s") else None
    return FilmRecord(record["time_s"], record["temperature_degC"], record.output(output), record.source, own_times)


def _plate(records: list[Record], options: argparse.Namespace, lag: bool = False) -> PlateFit:
    from compensator.identification.plate import PlateRecord, identify_plate_records

    inputs = [PlateRecord(r["time_s"], r["temperature_degC"], r["current_A"], r.source) for r in records]
    try:
        return identify_plate_records(inputs, kind=options.plate, lag=lag)
    except ValueError as error:
        raise _said_of(records, error) from None


def _tell_film(fit: FilmFit, unit: str, voice: Voice) -> dict[str, Any]:
    d = fit.model.memoryless.function
    voice.say(
        f"film: {fit.model.kind}, {fit.active_operators} operators with weight, D(T) {d}: "
        f"RMSE {fit.rmse:.4g} {unit}, largest {fit.max_abs:.3g} {unit}, held-out {fit.held_out_rmse:.4g} {unit}"
    )
    for note in fit.identifiability:
        voice.say(f"film: {note}")
    return {
        "kind": fit.model.kind,
        "memoryless": d,
        "operators": fit.model.operators,
        "active_operators": fit.active_operators,
        f"rmse_{unit}": fit.rmse,
        f"max_abs_{unit}": fit.max_abs,
        f"held_out_rmse_{unit}": fit.held_out_rmse,
        "temperature_noise_K": list(fit.temperature_noise_K),
        "outliers": [list(map(int, rows)) for rows in fit.outliers],
        "candidates": [dict(c.__dict__) for c in fit.candidates],
        "identifiability": list(fit.identifiability),
    }


def _tell_lag(lag_s: float, numbers: list[FilmNumbers], result: dict[str, Any], voice: Voice) -> None:
    """What a thermometer that lags behind the plate, as the current shows it, does to the transition's numbers."""
    for one, entry in zip(numbers, result.get("transition", []), strict=True):
        shift = one.transition.shift_K(lag_s)
        if lag_s > 0.0 and shift > 0.0:
            entry["sensor_lag"] = {"tau_s": lag_s, "shift_K": shift, "taken_out": False}
            voice.say(
                f"film: {one.source}: the current says that the thermometer lags behind the plate by {lag_s:.2g} s: at "
                f"these ramps the loop looks {shift:.2g} K narrower than it is; this is not taken out"
            )


def _checked(model: FilmModel, records: list[Record], voice: Voice) -> list[dict[str, Any]]:
    """What to know of the model before it is used, between the temperatures seen; all of it is in the JSON."""
    from compensator.inverse.check import check_model

    low, high = _temperatures(records)
    findings = check_model(model, low, high).findings
    for finding in findings:
        if not finding.kind.startswith("iteration"):  # the paper's method, which nothing here relies on
            voice.say(f"film: {finding.what}: {finding.advice}")
    return [
        {
            "kind": finding.kind,
            "what": finding.what,
            "where_degC": list(finding.where_degC) if finding.where_degC else None,
            "operators": list(finding.operators),
            "advice": finding.advice,
        }
        for finding in findings
    ]


def _temperatures(records: list[Record]) -> tuple[float, float]:
    """The least and the largest temperature seen, degC."""
    finite = [r["temperature_degC"][np.isfinite(r["temperature_degC"])] for r in records]
    return min(float(t.min()) for t in finite), max(float(t.max()) for t in finite)


def _compressed(
    model: FilmModel, records: list[Record], options: argparse.Namespace, result: dict[str, Any], voice: Voice
) -> FilmModel:
    """The model with fewer operators, where that is asked for; its loss is told."""
    if options.compress is None:
        return model
    from compensator.identification.compression import compress

    low, high = _temperatures(records)
    try:
        small = compress(model, options.compress, low, high)
    except ValueError as error:
        raise fault("--compress", repr(options.compress), str(error)) from None
    unit = unit_of(options.output)
    voice.say(
        f"film: {small.model.operators} operators instead of {model.operators}: loses {small.rms:.3g} {unit} RMS, "
        f"{small.largest:.3g} {unit} at most, over minor loops between {low:.1f} and {high:.1f} degC"
    )
    result["compression"] = {
        "operators": small.model.operators,
        f"rms_{unit}": small.rms,
        f"max_abs_{unit}": small.largest,
        "course": [list(step) for step in small.course],
    }
    return small.model


def _tell_plate(fit: PlateFit, drive: str | None, voice: Voice) -> dict[str, Any]:
    per = "full drive" if drive else "A"
    voice.say(f"plate: RMSE {fit.rmse_K * 1e3:.1f} mK, noise {fit.noise_K * 1e3:.1f} mK; per {per}:")
    for name, value, error in zip(fit.names, fit.values, fit.standard_errors, strict=True):
        voice.say(f"  {name} = {value:.6g} +- {1.96 * error:.2g} (95 %)")
    notes = list(fit.identifiability)
    if fit.rmse_K > MISFIT * fit.noise_K:
        times = fit.rmse_K / max(fit.noise_K, 1e-9)  # no thermometer resolves a nanokelvin
        notes.insert(
            0,
            f"The model leaves {times:.0f} times the thermometer's noise: something is missing, "
            "such as a heat sink that warms up or a thermometer that lags, and the intervals above are too narrow.",
        )
    for note in notes:
        voice.say(f"plate: {note}")
    return {
        "kind": fit.model.kind,
        "drive": drive,
        "parameters": {
            name: {"value": float(value), "ci95": [float(value - 1.96 * error), float(value + 1.96 * error)]}
            for name, value, error in zip(fit.names, fit.values, fit.standard_errors, strict=True)
        },
        "rmse_K": fit.rmse_K,
        "max_abs_K": fit.max_abs_K,
        "noise_K": fit.noise_K,
        "identifiability": notes,
    }
