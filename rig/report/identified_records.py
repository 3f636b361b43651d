"""Film and plate models of records, with what is told of them and the files of a report, as values."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from rig.analysis.film_sense import rising
from rig.analysis.identified import film_fit, plate_fit
from rig.analysis.one_row import of_identification
from rig.core.faults import Faults, fault
from rig.files.film_output import FALLING_RESISTANCE, column_of
from rig.files.record_file import Record, unit_of
from rig.files.run_folder import plain_json
from rig.many.engine import given
from rig.report.many_records import Task
from rig.report.told import MODEL, Told, files_in

if TYPE_CHECKING:
    from compensator.hysteresis.film import FilmModel
    from compensator.identification.film import FilmFit
    from compensator.identification.plate import PlateFit
    from rig.analysis.film_numbers import FilmNumbers
    from rig.report.identification import Compared

MISFIT = 2.0  # times the noise: beyond it a model does not describe its record
Say = Callable[[str], None]


@dataclass(frozen=True)
class AskedFit:
    """How to fit, as the arguments of `peltier identify` say it."""

    output: str = FALLING_RESISTANCE
    kind: Any = None
    form: str | None = None
    operators: int = 30
    initial: Literal["cooled", "heated", "fitted"] = "fitted"
    violate_order: bool = False
    compress: int | None = None
    plate: Literal["peltier", "heater"] = "peltier"
    seed: int = 0

    @property
    def of_the_film(self) -> dict[str, Any]:
        """As `identify_film_records` takes it."""
        how = {"kind": self.kind, "form": self.form, "operators": self.operators, "initial": self.initial}
        return {**how, "ordered": not self.violate_order, "seed": self.seed}


def identified(
    records: list[Record], asked: AskedFit, models: Sequence[Path], report: Path | None, say: Say
) -> dict[str, Any]:
    """One film and one plate of all records: the JSON of `peltier identify`. models: files to write the model to;
    report: folder, which is there. Raises Faults."""
    with_film = [r for r in records if r.has_output(asked.output)]
    with_plate = [r for r in records if r.has("current_A")]
    if not with_film and not with_plate:
        raise _nothing_to_fit(records, asked.output)
    asked = replace(asked, output=rising(records, asked.output, say))
    film = film_fit(with_film, asked.output, **asked.of_the_film) if with_film else None
    film_model = film.model if film is not None else None
    plate = plate_fit(with_plate, asked.plate) if with_plate else None
    from rig.analysis.film_numbers import numbers_of_record
    from rig.files.model_file import Model, write_model

    numbers: list[FilmNumbers] = []
    result: dict[str, Any] = {"format": "peltier-identification/1", "records": [r.source for r in records]}
    if film is not None:
        result["film"] = _tell_film(film, unit_of(asked.output), say)
        result["film"]["check"] = _checked(film.model, with_film, say)
        film_model = _compressed(film.model, with_film, asked, result["film"], say)
        numbers = [numbers_of_record(record, asked.output) for record in with_film]
        for one in numbers:
            for line in one.lines():
                say(f"film: {line}" if len(numbers) == 1 else f"film: {one.source}: {line}")
        result["transition"] = [one.document() for one in numbers]
    if plate is not None:
        result["plate"] = _tell_plate(plate, with_plate[0].drive, say)
        lag_s = plate_fit(with_plate, asked.plate, lag=True).lag_s if numbers else 0.0
        _tell_lag(lag_s, numbers, result, say)
    for path in models:
        write_model(path, Model(film_model, plate.model if plate else None), _comment(records, result))
    if models:
        result["model"] = models[0]
    if report is not None:
        from rig.report.identification import write_identification_report

        compared = _compared(film, with_film, asked.output) if film is not None else []
        write_identification_report(report, result, compared, numbers, asked.output)
    return result


def told(record: Any, asked: AskedFit, model: str | None = None) -> Told:
    """One record: a `Record`, or what an engine shares of it. model: where its model will stand; None: nowhere, and no
    report is made."""
    said: list[str] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        try:
            models = [folder / MODEL] if model is not None else []
            result = identified([given(record)], asked, models, folder if models else None, said.append)
        except Faults as faults:
            return Told(faults=tuple(faults.lines))
        files = files_in(folder)
    if model is not None:
        result["model"] = model
        files["identification.json"] = (plain_json(result) + "\n").encode()
    return Told(result, tuple(said), files)


def identifications(asked: AskedFit) -> Task:
    """Of many records."""
    return Task(
        work=told,
        asked=asked,
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


def _comment(records: list[Record], result: dict[str, Any]) -> str:
    """What a reader of the model file has to know of where it came from."""
    low, high = _temperatures(records)
    lines = ["identified from " + ", ".join(Path(record.source).name for record in records)]
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


def _tell_film(fit: FilmFit, unit: str, say: Say) -> dict[str, Any]:
    d = fit.model.memoryless.function
    say(
        f"film: {fit.model.kind}, {fit.active_operators} operators with weight, D(T) {d}: "
        f"RMSE {fit.rmse:.4g} {unit}, largest {fit.max_abs:.3g} {unit}, held-out {fit.held_out_rmse:.4g} {unit}"
    )
    for note in fit.identifiability:
        say(f"film: {note}")
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


def _tell_lag(lag_s: float, numbers: list[FilmNumbers], result: dict[str, Any], say: Say) -> None:
    """What a thermometer that lags behind the plate, as the current shows it, does to the transition's numbers."""
    for one, entry in zip(numbers, result.get("transition", []), strict=True):
        shift = one.transition.shift_K(lag_s)
        if lag_s > 0.0 and shift > 0.0:
            entry["sensor_lag"] = {"tau_s": lag_s, "shift_K": shift, "taken_out": False}
            say(
                f"film: {one.source}: the current says that the thermometer lags behind the plate by {lag_s:.2g} s: at "
                f"these ramps the loop looks {shift:.2g} K narrower than it is; this is not taken out"
            )


def _checked(model: FilmModel, records: list[Record], say: Say) -> list[dict[str, Any]]:
    """What to know of the model before it is used, between the temperatures seen; all of it is in the JSON."""
    from compensator.inverse.check import check_model

    low, high = _temperatures(records)
    findings = check_model(model, low, high).findings
    for finding in findings:
        if not finding.kind.startswith("iteration"):  # the paper's method, which nothing here relies on
            say(f"film: {finding.what}: {finding.advice}")
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
    model: FilmModel, records: list[Record], asked: AskedFit, result: dict[str, Any], say: Say
) -> FilmModel:
    """The model with fewer operators, where that is asked for; its loss is told."""
    if asked.compress is None:
        return model
    from compensator.identification.compression import compress

    low, high = _temperatures(records)
    try:
        small = compress(model, asked.compress, low, high)
    except ValueError as error:
        raise fault("--compress", repr(asked.compress), str(error)) from None
    unit = unit_of(asked.output)
    say(
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


def _tell_plate(fit: PlateFit, drive: str | None, say: Say) -> dict[str, Any]:
    per = "full drive" if drive else "A"
    say(f"plate: RMSE {fit.rmse_K * 1e3:.1f} mK, noise {fit.noise_K * 1e3:.1f} mK; per {per}:")
    for name, value, error in zip(fit.names, fit.values, fit.standard_errors, strict=True):
        say(f"  {name} = {value:.6g} +- {1.96 * error:.2g} (95 %)")
    notes = list(fit.identifiability)
    if fit.rmse_K > MISFIT * fit.noise_K:
        times = fit.rmse_K / max(fit.noise_K, 1e-9)  # no thermometer resolves a nanokelvin
        notes.insert(
            0,
            f"The model leaves {times:.0f} times the thermometer's noise: something is missing, "
            "such as a heat sink that warms up or a thermometer that lags, and the intervals above are too narrow.",
        )
    for note in notes:
        say(f"plate: {note}")
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
