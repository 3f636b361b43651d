"""Film and plate fitted to records: a film where there is temperature and output, a plate where there is current."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from compensator.hysteresis.film import FilmModel
from compensator.hysteresis.functions import Array
from compensator.inverse.check import Finding, check_model
from rig.analysis.earlier_records import seen_degC, told_by
from rig.analysis.film_numbers import FilmNumbers, doubted, numbers_of_record
from rig.analysis.film_sense import rising
from rig.config.model_file import Model
from rig.core.faults import Faults, fault
from rig.records.film_output import FALLING_RESISTANCE, column_of
from rig.records.record_file import Record
from sim.inference.film.compression import Compression, compress
from sim.inference.film.fit import FilmFit, FilmRecord, identify_film_records
from sim.inference.plate.fit import PlateFit, PlateRecord, identify_plate_records


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


@dataclass(frozen=True, eq=False)
class Identified:
    """What was fitted to records: film and plate, None where the records have none; model: both as a model file has
    them, the film compressed where `AskedFit.compress` is set.

    output: the film's, in the sense in which it rises with temperature; film_records: those with such an output;
    plate_records: those with a current;
    findings: what to know of the film between the temperatures seen; numbers: the transition of each film record,
    without a model; lag_s: of the thermometer behind the plate, 0 where it was not fitted; drive: the unit of a current
    that is a share of full drive, else None.
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


def identified(records: Sequence[Record], asked: AskedFit, say: Callable[[str], None]) -> Identified:
    """One film and one plate of all records. Raises Faults."""
    with_film = [r for r in records if r.has_output(asked.output)]
    with_plate = [r for r in records if r.has("current_A") and r.times != "rows"]
    for record in records:
        if record.has("current_A") and record.times == "rows":
            say(
                f"{record.source}: it has no times, so no plate is fitted; --period SECONDS says how far apart rows are"
            )
    if not with_film and not with_plate:
        raise _nothing_to_fit(records, asked.output)
    output = rising(records, asked.output, say)
    found = Identified(tuple(records), output, Model(None, None))
    film_model, plate_model = None, None
    courses: dict[int, Array] = {}
    if with_plate:
        plate = plate_fit(with_plate, asked.plate)
        plate_model = plate.model
        found = replace(found, plate=plate, drive=with_plate[0].drive, plate_records=tuple(with_plate))
        if not plate.far_off:
            courses = {id(record): course for record, course in zip(with_plate, plate.course_degC, strict=True)}
    if with_film:
        film = film_fit(with_film, output, [courses.get(id(record)) for record in with_film], **asked.of_the_film)
        findings = check_model(film.model, *seen_degC(with_film)).findings
        compression = _compressed(film.model, with_film, asked.compress) if asked.compress is not None else None
        film_model = film.model if compression is None else compression.model
        numbers = tuple(
            doubted(numbers_of_record(record, output), modelled(film, k, record), record.output(output))
            for k, record in enumerate(with_film)
        )
        found = replace(
            found,
            film=film,
            film_records=tuple(with_film),
            findings=tuple(findings),
            compression=compression,
            numbers=numbers,
            lag_s=plate_fit(with_plate, asked.plate, lag=True).lag_s if with_plate else 0.0,
        )
    model = Model(film_model, plate_model)
    return replace(found, model=told_by(model, with_film) if with_film else model)


def modelled(film: FilmFit, number: int, record: Record) -> Array:
    """Return the output of the film model over a film record of that number, where the thermometer is believed."""
    time = record["time_s"]
    output = film.along(number, time)
    if record.has("resistance_time_s"):
        read = np.where(np.isfinite(record["resistance_time_s"]), record["resistance_time_s"], time)
        output = np.interp(read, time, output)
    return np.where(np.isfinite(record["temperature_degC"]), output, np.nan)


def _nothing_to_fit(records: Sequence[Record], output: str) -> Faults:
    """Why there is neither a film nor a plate in the records."""
    name = column_of(output)
    lines = []
    for record in records:
        there = [column for column in (name, "current_A") if column in record.columns]
        what = f"{' and '.join(there)}: no finite number in {record.rows} rows" if there else "no such column"
        lines.append(f"{record.source}: {name}, current_A: {what}; expected one of them at least (--column maps names)")
    return Faults(lines)


def _compressed(model: FilmModel, records: Sequence[Record], operators: int) -> Compression:
    """The film with fewer operators. Raises Faults."""
    try:
        return compress(model, operators, *seen_degC(records))
    except ValueError as error:
        raise fault("--compress", repr(operators), str(error)) from None


def film_fit(records: Sequence[Record], output: str, courses: Sequence[Array | None], **how: Any) -> FilmFit:
    """Fit a film. Readings of the resistance have their own times, where the record has them.

    courses: of each record the plate's temperature in its rows (degC) as the fit of the plate has it, None where there
    is none; how: as `identify_film_records`. Raises Faults.
    """
    inputs = [
        FilmRecord(
            r["time_s"],
            r["temperature_degC"],
            r.output(output),
            r.source,
            r["resistance_time_s"] if r.has("resistance_time_s") else None,
            course,
        )
        for r, course in zip(records, courses, strict=True)
    ]
    try:
        return identify_film_records(inputs, output_name=output, **how)
    except ValueError as error:
        raise said_of(records, error) from None


def plate_fit(records: Sequence[Record], kind: Any = "peltier", lag: bool = False) -> PlateFit:
    """lag: whether the thermometer's lag behind the plate is fitted too. Raises Faults."""
    inputs = [PlateRecord(r["time_s"], r["temperature_degC"], r["current_A"], r.source) for r in records]
    try:
        return identify_plate_records(inputs, kind=kind, lag=lag)
    except ValueError as error:
        raise said_of(records, error) from None


def said_of(records: Sequence[Record], error: ValueError) -> Faults:
    """The fault with the record that it is about."""
    text = str(error)
    if any(text.startswith(record.source) for record in records):
        return Faults([text])
    return Faults([f"{', '.join(record.source for record in records)}: {text}"])
