"""Film and plate models of records, with what is reported of them and the files of a report, as values."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rig.analysis.earlier_records import seen_degC
from rig.analysis.fit_notes import finding_documents, finding_notes, plate_notes
from rig.analysis.identified import AskedFit, Identified, identified, modelled
from rig.analysis.one_row import of_identification
from rig.core.faults import Faults
from rig.many.engine import given
from rig.records.record_file import Record, unit_of
from rig.records.run_folder import plain_json
from rig.report.many_records import Task
from rig.report.told import MODEL, Told, files_in
from sim.inference.covariance import NORMAL_95
from sim.model.inputs import logged_inputs

if TYPE_CHECKING:
    from compensator.inverse.check import Finding
    from rig.analysis.film_numbers import FilmNumbers
    from rig.report.identification import Compared
    from rig.report.model_figures import ComparedPlate
    from sim.inference.film.compression import Compression
    from sim.inference.film.fit import FilmFit
    from sim.inference.plate.fit import PlateFit

Say = Callable[[str], None]


def identified_and_told(
    records: list[Record], asked: AskedFit, models: Sequence[Path], report: Path | None, say: Say
) -> dict[str, Any]:
    """One film and one plate of all records: the JSON of `peltier identify`. models: files to write the model to;
    report: folder, which is there. Raises Faults."""
    from rig.config.model_file import write_model

    found = identified(records, asked, say)
    result = in_words(found, say)
    for path in models:
        write_model(path, found.model, model_comment(found, result))
    if models:
        result["model"] = models[0]
    if report is not None:
        from rig.report.identification import write_identification_report

        write_identification_report(
            report, result, compared(found), found.numbers, found.output, compared_plates(found)
        )
    return result


def in_words(found: Identified, say: Say) -> dict[str, Any]:
    """Say what was fitted, a line after the other; the JSON of `peltier identify`."""
    result: dict[str, Any] = {"format": "peltier-identification/1", "records": [r.source for r in found.records]}
    result["left_out"] = [one for record in found.records for one in record.left_out_document()]
    for record in found.records:
        for line in record.left_out_lines():
            say(line if len(found.records) == 1 else f"{record.source}: {line}")
    if found.film is not None:
        unit = unit_of(found.output)
        result["film"] = _tell_film(found.film, unit, say)
        result["film"]["check"] = _tell_findings(found.findings, say)
        if found.compression is not None:
            result["film"]["compression"] = _tell_compression(found, found.compression, unit, say)
        for one in found.numbers:
            for line in one.lines():
                say(f"film: {line}" if len(found.numbers) == 1 else f"film: {one.source}: {line}")
        result["transition"] = [one.document() for one in found.numbers]
    if found.plate is not None:
        told = found.film.identifiability if found.film is not None else ()
        result["plate"] = _tell_plate(found.plate, found.drive, told, say)
        _tell_other_inputs(found, say)
        _tell_lag(found.lag_s, found.numbers, result, say)
    return result


def told(record: Any, asked: AskedFit, model: str | None = None) -> Told:
    """One record: a `Record`, or what an engine shares of it. model: where its model will stand; None: nowhere, and no
    report is made."""
    said: list[str] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        try:
            models = [folder / MODEL] if model is not None else []
            result = identified_and_told([given(record)], asked, models, folder if models else None, said.append)
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


def compared(found: Identified) -> list[Compared]:
    """Each film record beside the model that was fitted."""
    from rig.report.identification import Compared

    if found.film is None:
        return []
    beside = []
    for number, record in enumerate(found.film_records):
        shown, course_degC = modelled(found.film, number, record), found.film.course_degC[number]
        beside.append(Compared(record.source, record["time_s"], course_degC, record.output(found.output), shown))
    return beside


def compared_plates(found: Identified) -> list[ComparedPlate]:
    """Each record with a current beside the plate that was fitted: simulated from it, stretch by stretch."""
    from rig.report.model_figures import ComparedPlate

    if found.plate is None:
        return []
    beside = []
    for k, record in enumerate(found.plate_records):
        time, current = record["time_s"], record["current_A"]
        simulated = np.full(time.size, np.nan)
        for (number, first, last), first_degC in zip(found.plate.stretches, found.plate.first_degC, strict=True):
            if number == k:
                rows = slice(first, last)
                held = np.nan_to_num(current[rows])
                simulated[rows] = found.plate.model.simulate(first_degC, time[rows], held)
        beside.append(ComparedPlate(record.source, time, record["temperature_degC"], simulated, current, found.drive))
    return beside


def model_comment(found: Identified, result: dict[str, Any]) -> str:
    """What a reader of the model file has to know of where it came from."""
    low, high = seen_degC(found.records)
    lines = ["identified from " + ", ".join(Path(record.source).name for record in found.records)]
    lines.append(f"temperatures seen: {low:.1f} to {high:.1f} degC; outside them the model is a guess")
    for name in ("film", "plate"):
        lines += [f"{name}: {note}" for note in result.get(name, {}).get("identifiability", [])]
    return "\n".join(lines)


def _tell_film(fit: FilmFit, unit: str, say: Say) -> dict[str, Any]:
    d = fit.model.memoryless.function
    say(
        f"film: {fit.model.kind}, operators with weight: {fit.active_operators}, D(T) {d}: "
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


def _tell_lag(lag_s: float, numbers: Sequence[FilmNumbers], result: dict[str, Any], say: Say) -> None:
    """What a thermometer that lags behind the plate, as the current shows it, does to the transition's numbers."""
    for one, entry in zip(numbers, result.get("transition", []), strict=True):
        shift = one.transition.shift_K(lag_s)
        if lag_s > 0.0 and shift > 0.0 and one.timed:
            entry["sensor_lag"] = {"tau_s": lag_s, "shift_K": shift, "taken_out": False}
            say(
                f"film: {one.source}: the current says that the thermometer lags behind the plate by {lag_s:.2g} s: at "
                f"these ramps the loop looks {shift:.2g} K narrower than it is; this is not taken out"
            )


def _tell_findings(findings: Sequence[Finding], say: Say) -> list[dict[str, Any]]:
    """What to know of the model before it is used, between the temperatures seen; all of it is in the JSON."""
    for note in finding_notes(findings):
        say(f"film: {note}")
    return finding_documents(findings)


def _tell_compression(found: Identified, small: Compression, unit: str, say: Say) -> dict[str, Any]:
    """What the smaller film loses."""
    assert found.film is not None
    low, high = seen_degC(found.film_records)
    say(
        f"film: {small.model.operators} operators instead of {found.film.model.operators}: loses {small.rms:.3g} "
        f"{unit} RMS, {small.largest:.3g} {unit} at most, over minor loops between {low:.1f} and {high:.1f} degC"
    )
    return {
        "operators": small.model.operators,
        f"rms_{unit}": small.rms,
        f"max_abs_{unit}": small.largest,
        "course": [list(step) for step in small.course],
    }


def _tell_other_inputs(found: Identified, say: Say) -> None:
    """What else heats the plate, as far as the records have it."""
    inputs = sorted({name for record in found.plate_records for name in logged_inputs(record.columns, [0]).names})
    if inputs:
        say(f"plate: {', '.join(inputs)}: in the record, and not in this fit; `peltier diagnose` has it in its own")


def _tell_plate(fit: PlateFit, drive: str | None, told: Sequence[str], say: Say) -> dict[str, Any]:
    per = "full drive" if drive else "A"
    say(f"plate: RMSE {fit.rmse_K * 1e3:.1f} mK, noise {fit.noise_K * 1e3:.1f} mK; per {per}:")
    for name, value, error in zip(fit.names, fit.values, fit.standard_errors, strict=True):
        say(f"  {name} = {value:.6g} +- {NORMAL_95 * error:.2g} (95 %)")
    notes = plate_notes(fit, told)
    for note in notes:
        say(f"plate: {note}")
    return {
        "kind": fit.model.kind,
        "drive": drive,
        "parameters": {
            name: {"value": float(value), "ci95": [float(value - NORMAL_95 * error), float(value + NORMAL_95 * error)]}
            for name, value, error in zip(fit.names, fit.values, fit.standard_errors, strict=True)
        },
        "rmse_K": fit.rmse_K,
        "max_abs_K": fit.max_abs_K,
        "noise_K": fit.noise_K,
        "identifiability": notes,
    }
