"""Film and plate fitted to records, with lines and JSON of the result.

A record with temperature and output gives a film, one with current a plate.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from compensator.hysteresis.functions import Array
from compensator.inverse.check import Finding, check_model
from rig.analysis.error import OF_MODEL, in_brackets, judgement, percent, split_unit, value_and_half
from rig.analysis.film_records import fitted_to, rising, seen_degC
from rig.analysis.transition import WORDS, FilmNumbers, doubted, numbers_of_record
from rig.config.model_file import Model
from rig.core.faults import Faults, fault
from rig.records.film_output import FALLING_RESISTANCE, column_of, unit_of
from rig.records.record_file import Record
from sim.inference.covariance import NORMAL_95
from sim.inference.film.compression import Compression, compress
from sim.inference.film.fit import FilmFit, identify_film_records
from sim.inference.film.rows import FilmRecord
from sim.inference.plate.fit import PlateFit, PlateRecord, identify_plate_records
from sim.model.inputs import logged_inputs

MISFIT: Final = 2.0  # times the noise: beyond it a model does not describe its record


@dataclass(frozen=True)
class FitOptions:
    """How to fit, as the arguments of `peltier identify`."""

    output: str = FALLING_RESISTANCE
    kind: Any = None
    form: str | None = None
    operators: int = 30
    initial: Literal["cooled", "heated", "fitted"] = "fitted"
    violate_order: bool = False
    compress: int | None = None
    plate: Literal["peltier", "heater"] = "peltier"


@dataclass(frozen=True, eq=False)
class Identified:
    """Film and plate fitted to records, None if the records have none.

    model: both as a model file has them, the film compressed if `FitOptions.compress` is set. output: of the film, in
    the sense in which it rises with temperature; film_records, plate_records: those with such an output, with a
    current. findings: what to know of the film within the temperatures of its records. numbers: the transition of each
    film record, without a model. lag_s: of the thermometer behind the plate, 0 if it was not fitted. drive: the unit of
    a current that is a share of full drive, else None.
    """

    records: tuple[Record, ...]
    output: str
    model: Model
    film: FilmFit | None = None
    plate: PlateFit | None = None
    film_records: tuple[Record, ...] = ()
    plate_records: tuple[Record, ...] = ()
    findings: tuple[Finding, ...] = ()
    compression: Compression | None = None
    numbers: tuple[FilmNumbers, ...] = ()
    lag_s: float = 0.0
    drive: str | None = None

    def lines(self) -> list[str]:
        several = len(self.records) > 1
        lines = [f"{r.source}: {line}" if several else line for r in self.records for line in r.left_out_lines()]
        if self.film is not None:
            lines += [f"film: {line}" for line in self._film_lines(self.film)]
        if self.plate is not None:
            lines += self._plate_lines(self.plate)
            lines += [f"film: {line}" for line, _ in self._lags() if line]
        return lines

    def document(self) -> dict[str, Any]:
        result: dict[str, Any] = {
            "format": "peltier-identification/1",
            "records": [record.source for record in self.records],
            "left_out": [one for record in self.records for one in record.left_out_document()],
        }
        if self.film is not None:
            result["film"] = self._film_document(self.film)
            result["transition"] = [one.document() for one in self.numbers]
        if self.plate is not None:
            fit, values = self.plate, zip(self.plate.names, self.plate.values, self.plate.standard_errors, strict=True)
            result["plate"] = {
                "kind": fit.model.kind,
                "drive": self.drive,
                "parameters": {
                    name: {"value": float(v), "ci95": [float(v - NORMAL_95 * error), float(v + NORMAL_95 * error)]}
                    for name, v, error in values
                },
                "rmse_K": fit.rmse_K,
                "max_abs_K": fit.max_abs_K,
                "noise_K": fit.noise_K,
                "identifiability": self._plate_notes(fit),
            }
            for entry, (_, lag) in zip(result.get("transition", []), self._lags(), strict=True):
                entry |= {"sensor_lag": lag} if lag else {}
        return result

    def model_comment(self) -> str:
        """Return the lines for the head of the model file: where the model came from, and what is not determined."""
        low, high = seen_degC(self.records)
        lines = ["identified from " + ", ".join(Path(record.source).name for record in self.records)]
        lines.append(f"temperatures seen: {low:.1f} to {high:.1f} degC; outside them the model is a guess")
        lines += [f"film: {note}" for note in (self.film.identifiability if self.film is not None else ())]
        lines += [f"plate: {note}" for note in (self._plate_notes(self.plate) if self.plate is not None else ())]
        return "\n".join(lines)

    def courses(self) -> list[tuple[Array, Array, Array, Array]]:
        """Return of each film record, shape (rows,): time (s), temperature (degC), output measured and modelled."""
        film, found = self.film, []
        for k, r in enumerate(self.film_records if film is not None else ()):
            assert film is not None
            found.append((r["time_s"], film.course_degC[k], r.output(self.output), modelled(film, k, r)))
        return found

    def _film_lines(self, fit: FilmFit) -> Iterator[str]:
        unit = unit_of(self.output)
        share = percent(fit.held_out_rmse) if unit == "dec" else ""
        yield (
            f"RMS error {fit.held_out_rmse:.3g} {unit} on held-out rows"
            f"{in_brackets(share, judgement(fit.held_out_rmse, unit, OF_MODEL))}, {fit.rmse:.3g} {unit} on fitted rows"
            f", largest {fit.max_abs:.3g} {unit}; {fit.model.kind.replace('_', ' ')} model"
        )
        yield from fit.identifiability
        yield from finding_notes(self.findings)
        if (small := self.compression) is not None:
            low, high = seen_degC(self.film_records)
            yield (
                f"{small.model.operators} operators instead of {fit.model.operators}: loses {small.rms:.3g} {unit} "
                f"RMS, {small.largest:.3g} {unit} at most, over minor loops between {low:.1f} and {high:.1f} degC"
            )
        for one in self.numbers:
            yield from one.lines() if len(self.numbers) == 1 else (f"{one.source}: {line}" for line in one.lines())

    def _film_document(self, fit: FilmFit) -> dict[str, Any]:
        unit = unit_of(self.output)
        result = {
            "kind": fit.model.kind,
            "memoryless": fit.model.memoryless.function,
            "operators": fit.model.operators,
            "active_operators": fit.active_operators,
            f"rmse_{unit}": fit.rmse,
            f"max_abs_{unit}": fit.max_abs,
            f"held_out_rmse_{unit}": fit.held_out_rmse,
            "temperature_noise_K": list(fit.temperature_noise_K),
            "outliers": [list(map(int, rows)) for rows in fit.outliers],
            "candidates": [dict(c.__dict__) for c in fit.candidates],
            "identifiability": list(fit.identifiability),
            "check": finding_documents(self.findings),
        }
        if (small := self.compression) is not None:
            errors = {f"rms_{unit}": small.rms, f"max_abs_{unit}": small.largest}
            course = [list(step) for step in small.course]
            result["compression"] = {"operators": small.model.operators, **errors, "course": course}
        return result

    def _plate_lines(self, fit: PlateFit) -> list[str]:
        per = "; A stands for full drive" if self.drive else ""
        inputs = sorted({n for record in self.plate_records for n in logged_inputs(record.columns, [0]).names})
        more = f"{', '.join(inputs)}: recorded, but not used by this fit; `peltier diagnose` uses it"
        return [
            f"plate: RMS error {fit.rmse_K:.3g} K{in_brackets(judgement(fit.rmse_K, 'K', OF_MODEL))}, noise "
            f"{fit.noise_K:.3g} K; parameters{'' if self._off(fit) else ' with 95 % intervals'}{per}:",
            *(
                self._plate_line(fit, name, value, error)
                for name, value, error in zip(fit.names, fit.values, fit.standard_errors, strict=True)
            ),
            *(f"plate: {note}" for note in self._plate_notes(fit)),
            *(["plate: `peltier diagnose` on the record looks for the cause."] if self._off(fit) else []),
            *([f"plate: {more}"] if inputs else []),
        ]

    @staticmethod
    def _off(fit: PlateFit) -> bool:
        """Return True if the model does not describe the record, so that its intervals are too narrow to be shown."""
        return fit.far_off or fit.rmse_K > MISFIT * fit.noise_K

    def _plate_line(self, fit: PlateFit, name: str, value: float, error: float) -> str:
        what, unit = split_unit(name)
        shown, half = value_and_half(value, NORMAL_95 * error)
        return f"  {what}: {shown if self._off(fit) else f'{shown} +- {half}'} {unit}".rstrip()

    def doubts(self) -> list[str]:
        """Return all that a page of the film has to warn of: a bad model, numbers that are not determined, notes."""
        if self.film is None:
            return []
        fit, unit = self.film, unit_of(self.output)
        bad = judgement(fit.held_out_rmse, unit, OF_MODEL)
        lines = [f"The film model is bad: RMS error {fit.held_out_rmse:.3g} {unit} on held-out rows ({bad})."]
        lines = lines if bad.startswith("bad") else []
        for one in self.numbers:
            missing: dict[str, list[str]] = {}
            for name, quantity in one.transition.quantities.items():
                if quantity.value is None and name in WORDS:
                    missing.setdefault(quantity.reason or "", []).append(WORDS[name][0])
            if one.doubt:
                missing = {one.doubt: ["none of the transition's numbers can be given"]}
            of = f"{Path(one.source).name}: " if len(self.numbers) > 1 else ""
            lines += [f"{of}not determined: {', '.join(names)}: {why}" for why, names in missing.items()]
        return [*lines, *fit.identifiability, *finding_notes(self.findings)]

    def _plate_notes(self, fit: PlateFit) -> list[str]:
        return plate_notes(fit, self.film.identifiability if self.film is not None else ())

    def _lags(self) -> list[tuple[str, dict[str, Any]]]:
        """Return for each film record a line and its JSON on a lag that shifts the transition, or both empty."""
        return [one.lag_left_in(self.lag_s) or ("", {}) for one in self.numbers]


def identified(records: Sequence[Record], options: FitOptions, say: Callable[[str], None]) -> Identified:
    """Fit one film and one plate to all records. Raises Faults."""
    with_film = [r for r in records if r.has_output(options.output)]
    with_plate = [r for r in records if r.has("current_A") and r.times != "rows"]
    for record in records:
        if record.has("current_A") and record.times == "rows":
            text = "it has no times, so no plate is fitted; --period SECONDS says how far apart rows are"
            say(f"{record.source}: {text}")
    if not with_film and not with_plate:
        name, lines = column_of(options.output), []
        for record in records:
            there = [column for column in (name, "current_A") if column in record.columns]
            what = f"{' and '.join(there)}: no finite number in {record.rows} rows" if there else "no such column"
            expected = "expected one of them at least (--column maps names)"
            lines.append(f"{record.source}: {name}, current_A: {what}; {expected}")
        raise Faults(lines)
    output = rising(records, options.output, say)
    plate, film, compression, lag_s = None, None, None, 0.0
    courses: dict[int, Array] = {}
    if with_plate:
        inputs = [PlateRecord(r["time_s"], r["temperature_degC"], r["current_A"], r.source) for r in with_plate]
        try:
            lagging = identify_plate_records(inputs, kind=options.plate, lag=True)
        except ValueError as error:
            raise _fault_of(with_plate, error) from None
        plate, lag_s = lagging.without_lag or lagging, lagging.lag_s
        if not plate.far_off:
            courses = {id(record): course for record, course in zip(with_plate, plate.course_degC, strict=True)}
    numbers: list[FilmNumbers] = []
    if with_film:
        film = _film_fit(with_film, output, [courses.get(id(record)) for record in with_film], options)
        try:
            if options.compress is not None:
                compression = compress(film.model, options.compress, *seen_degC(with_film))
        except ValueError as error:
            raise fault("--compress", repr(options.compress), str(error)) from None
        for k, record in enumerate(with_film):
            found = numbers_of_record(record, output, film, k)
            numbers.append(doubted(found, modelled(film, k, record), record.output(output)))
    film_model = compression.model if compression is not None else film.model if film is not None else None
    model = Model(film_model, plate.model if plate is not None else None)
    return Identified(
        records=tuple(records),
        output=output,
        model=fitted_to(model, with_film) if with_film else model,
        film=film,
        plate=plate,
        film_records=tuple(with_film),
        plate_records=tuple(with_plate),
        findings=check_model(film.model, *seen_degC(with_film)) if film is not None else (),
        compression=compression,
        numbers=tuple(numbers),
        lag_s=lag_s,
        drive=with_plate[0].drive if with_plate else None,
    )


def modelled(film: FilmFit, number: int, record: Record) -> Array:
    """Return the output of the film model over a film record of that number, nan where the thermometer is not
    believed."""
    time = record["time_s"]
    output = film.along(number, time)
    if record.has("resistance_time_s"):
        read = np.where(np.isfinite(record["resistance_time_s"]), record["resistance_time_s"], time)
        output = np.interp(read, time, output)
    return np.where(np.isfinite(record["temperature_degC"]), output, np.nan)


def _film_fit(records: Sequence[Record], output: str, courses: Sequence[Array | None], options: FitOptions) -> FilmFit:
    """Fit a film, each reading of the resistance at its own time if the record has it. Raises Faults.

    courses: of each record the plate's temperature in its rows (degC) as the fit of the plate has it, None if there is
    no such fit.
    """
    inputs = []
    for r, course in zip(records, courses, strict=True):
        read_s = r["resistance_time_s"] if r.has("resistance_time_s") else None
        row = FilmRecord(r["time_s"], r["temperature_degC"], r.output(output), r.source, read_s, course)
        inputs.append(row)
    how = {"kind": options.kind, "form": options.form, "operators": options.operators, "initial": options.initial}
    try:
        ordered = not options.violate_order
        return identify_film_records(inputs, output_name=output, ordered=ordered, **how)
    except ValueError as error:
        raise _fault_of(records, error) from None


def _fault_of(records: Sequence[Record], error: ValueError) -> Faults:
    text = str(error)
    if any(text.startswith(record.source) for record in records):
        return Faults([text])
    return Faults([f"{', '.join(record.source for record in records)}: {text}"])


def plate_notes(fit: PlateFit, known: Iterable[str] = ()) -> list[str]:
    """Return what the record does not determine of its plate, and first whether the model describes it at all. known:
    notes on the film of the same record, not to be repeated."""
    before = set(known)
    notes = [note for note in fit.identifiability if note not in before]
    if fit.rmse_K > MISFIT * fit.noise_K and not fit.far_off:  # the first note is on that
        times = fit.rmse_K / max(fit.noise_K, 1e-9)  # no thermometer resolves a nanokelvin
        notes.insert(
            0,
            f"The model is off by {times:.0f} times the thermometer's noise, so no intervals are given: something is "
            "missing, such as a heat sink that warms up or a thermometer that lags.",
        )
    return notes


def finding_notes(findings: Iterable[Finding]) -> list[str]:
    """Return what to know of a film model before it is used, within the temperatures of its records."""
    return [f"{finding.what}: {finding.advice}" for finding in findings]


def finding_documents(findings: Iterable[Finding]) -> list[dict[str, Any]]:
    """Return all findings for the JSON."""
    return [
        {
            **{key: getattr(finding, key) for key in ("kind", "what", "advice")},
            "where_degC": list(finding.where_degC) if finding.where_degC else None,
            "operators": list(finding.operators),
        }
        for finding in findings
    ]
