"""A record diagnosed: which of its columns hold information, which kinds of plate are possible, what is refused.

With other records held out, the extended model's error there is that of the very model that is handed over, run as
`predict --initial fitted` runs it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from compensator.hysteresis.functions import Array
from rig.analysis.film_sense import rising
from rig.analysis.given_twice import require_different
from rig.analysis.held_out import require_judging
from rig.analysis.predicted import missing_inputs, predicted
from rig.analysis.prediction_error import fitted_values
from rig.analysis.telling import telling_columns
from rig.config.model_file import Model
from rig.core.faults import Faults, fault
from rig.records.film_output import FALLING_RESISTANCE
from rig.records.record_file import Record
from sim.diagnosis.data.record import Record as Rows
from sim.diagnosis.data.record import read_columns
from sim.diagnosis.diagnose import diagnose
from sim.diagnosis.extended_model import ExtendedModel, extended_model, with_film
from sim.diagnosis.of_full_drive import of_full_drive
from sim.diagnosis.report.caution import Caution
from sim.diagnosis.result import Diagnosis, HeldOutRecord
from sim.diagnosis.search.chain import FALSE_ALARM
from sim.inference.film.selection import rms
from sim.model.inputs import NAMES as INPUTS


def diagnosed(
    record: Record,
    base: str | None = None,
    output: str = FALLING_RESISTANCE,
    holdout: Sequence[Record] = (),
    plate: str | None = None,
    assume: Mapping[str, Mapping[str, float]] | None = None,
    budget_s: float | None = None,
    further: Sequence[Record] = (),
    false_alarm: float | None = None,
    say: Callable[[str], None] = lambda text: None,
    of_film: Sequence[Record] = (),
) -> tuple[Diagnosis, ExtendedModel]:
    """The diagnosis of one record, with the film's form found; output: of the film, as in a model file; assume:
    effects that are there, with the parameters that are known; budget_s: how long it may take; further: records
    of the same rig, diagnosed with it as one; false_alarm: the share of records with nothing in them that may be given
    a name, None: `FALSE_ALARM`; of_film: other records of the film, which decide what this one leaves open of it, and
    tell the extended model's, too. Raises Faults where nothing can be said."""
    together = [record, *further]
    require_different([*together, *holdout])
    _require_times([*together, *holdout])
    output = rising(together, output, say)
    telling = [telling_columns(one, output) for one in together]
    for note in dict.fromkeys(note for _, notes in telling for note in notes):
        say(note)
    _require_alike(together, holdout)
    require_judging(holdout, together, [columns for columns, _ in telling], output, say)
    try:
        diagnosis = diagnose(
            *(columns for columns, _ in telling),
            base=base,
            output=output,
            holdout=[other.columns for other in holdout],
            of_film=[other.columns for other in of_film],
            as_predicted=True,
            kinds=possible_kinds(together, plate),
            assume=assume,
            budget_s=budget_s,
            chosen_false_alarm=FALSE_ALARM if false_alarm is None else false_alarm,
            clock=time.monotonic,
            say=say,
        )
        extended = extended_model(diagnosis, None, rows_of_film(diagnosis, of_film))
    except (np.linalg.LinAlgError, ArithmeticError) as error:  # the first is a ValueError too
        text = f"no fit could be made of this record ({type(error).__name__}: {error})"
        raise fault(record.source, "", f"{text}; expected readings that follow current or temperature") from None
    except ValueError as error:
        raise Faults(f"{record.source}: {line}" for line in str(error).splitlines()) from None
    diagnosis = replace(with_film(diagnosis, extended), sources=tuple(one.source for one in together))
    diagnosis = _with_left_out(diagnosis, together)
    diagnosis = of_full_drive(diagnosis, next((one.drive for one in together if one.drive is not None), None))
    return with_prediction(diagnosis, model_of(extended), holdout) if holdout else diagnosis, extended


def _with_left_out(diagnosis: Diagnosis, records: Sequence[Record]) -> Diagnosis:
    """The diagnosis with the rows in which the thermometer was not believed."""
    warnings: list[Caution] = []
    rows: list[dict[str, Any]] = []
    for number, record in enumerate(records, 1):
        of = number if len(records) > 1 else None
        warnings += [Caution("thermometer_not_believed", line, record=of) for line in record.left_out_lines()]
        for one in record.left_out:
            entry = {"record": number, "column": "temperature_degC", "rule": one.why}
            rows += [{**entry, "time_s": t} for t in record["time_s"][one.first : one.last + 1].tolist()]
    return replace(diagnosis, warnings=[*warnings, *diagnosis.warnings], not_believed=tuple(rows))


def _require_alike(together: Sequence[Record], holdout: Sequence[Record]) -> None:
    """Raises Faults where records of one rig lack what heats the plate in others of them."""
    inputs = [name for name in INPUTS if any(one.has(name) for one in together)]
    lines = [
        f"{one.source}: {name}: missing; expected it in all records of a rig or in none: it heats the plate"
        for one in (*together, *holdout)
        for name in missing_inputs(one, inputs)
    ]
    lines += [
        f"{one.source}: current_A: missing; expected it in all records of a rig or in none"
        for one in together
        if not one.has("current_A") and any(other.has("current_A") for other in together)
    ]
    if lines:
        raise Faults(lines)


def _require_times(records: Sequence[Record]) -> None:
    """Raises Faults: effects are told apart by how fast they are, and of a table without times nobody knows that."""
    lines = [
        f"{one.source}: it has no times, only the order of its rows; a diagnosis needs them: expected --period SECONDS"
        for one in records
        if one.times == "rows"
    ]
    if lines:
        raise Faults(lines)


def rows_of_film(diagnosis: Diagnosis, records: Sequence[Record]) -> list[Rows]:
    """Other records of the film as the extended model takes them. Raises ValueError for one that has too few rows."""
    quantity = diagnosis.chain.record.quantity
    return [read_columns(one.columns, held_out=False, quantity=quantity) for one in records]


def model_of(extended: ExtendedModel) -> Model:
    """An extended model as a model file has it: of a record with current, the current drives the film."""
    drive = "current" if extended.plate is not None else None
    return Model(extended.film, extended.plate, tuple(extended.effects), drive, extended.mixing)  # type: ignore[arg-type]


def with_prediction(diagnosis: Diagnosis, model: Model, holdout: Sequence[Record]) -> Diagnosis:
    """The diagnosis with the extended model's errors on other records as `predict --initial fitted` measures them, in
    the rows that judge."""
    errors: dict[str, list[Array]] = {}
    elsewhere = []
    judging = diagnosis.halves.judging if diagnosis.halves is not None else []
    for record, judges in zip(holdout, judging, strict=True):
        found = predicted(model, record, record.source, initial="fitted")
        left = {}
        if found.temperature_degC is not None:
            left["temperature_K"] = found.temperature_degC - record["temperature_degC"]
        if found.output is not None and model.film is not None:
            left[diagnosis.record.quantity.channel] = found.output - record.output(model.film.output)
        counted = judges & ~found.fitted_rows
        scored = {name: values[counted & np.isfinite(values)] for name, values in left.items()}
        errors_of_it = {n: (rms(v), v.size) for n, v in scored.items() if v.size}
        elsewhere.append(HeldOutRecord(record.source, errors_of_it, fitted_values(found, model).get("ambient_degC")))
        for name, values in scored.items():
            errors.setdefault(name, []).append(values)
    channels = dict(diagnosis.channels)
    for name, parts in errors.items():
        error = np.concatenate(parts)
        channel = channels.get(name)
        if channel is not None and error.size:
            channels[name] = replace(channel, rmse_extended=rms(error), samples_holdout=int(error.size))
    return replace(diagnosis, channels=channels, elsewhere=tuple(elsewhere))


def possible_kinds(records: Sequence[Record], plate: str | None) -> tuple[str, ...]:
    """The kinds of plate to try: a drive that cools in none of the records may be a heater's, in ampere, too."""
    if plate is not None:
        return (plate,)
    if any(record.drive == "pwm255" for record in records):  # a switched heater's drive is its power
        return ("heater",)
    driven = [record["current_A"] for record in records if record.has("current_A")]
    if driven and not any(bool((current < 0.0).any()) for current in driven):
        return ("peltier", "heater")
    return ("peltier",)
