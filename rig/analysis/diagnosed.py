"""A record diagnosed: which of its columns can be used, which kinds of plate are possible, what is refused.

A record that is held out has to be able to judge: the gain is measured by a simulation from its own current, or
temperature if it has no current, against readings that move. There base and extended model run as `predict --initial
fitted` runs them. Their errors replace those of the record's own held-out rows; where the extended model's are larger,
the base model is handed over.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from compensator.hysteresis.functions import Array
from compensator.thermal.plate import Kind
from rig.analysis.film_records import rising
from rig.analysis.prediction import fitted_values, missing_inputs, predicted
from rig.config.model_file import Model
from rig.core.faults import Faults, fault
from rig.records.film_output import FALLING_RESISTANCE, column_of, in_decades, unit_of
from rig.records.record import content_digest
from rig.records.record_file import Record
from sim.diagnosis.diagnose import diagnose
from sim.diagnosis.extended_model import ExtendedModel, extended_model
from sim.diagnosis.result import Caution, Channel, Diagnosis, HeldOutRecord
from sim.inference.evidence import FALSE_ALARM
from sim.inference.gain import Gain, gain, rms
from sim.inference.joint.likelihood import Fit
from sim.inference.record.quantity import Quantity
from sim.inference.record.record import read_columns
from sim.model.inputs import NAMES as INPUTS

FEWEST = 40  # rows
LEAST_K, LEAST_DEC = 0.5, 0.05
TIMES = 8.0  # of the noise
MOST_OFFERED = 6  # columns, in a message


def usable_columns(record: Record, output: str = FALLING_RESISTANCE) -> tuple[dict[str, Array], list[str]]:
    """Return the columns that a diagnosis can use, and a note for each that was left out; output: of the film, as in a
    model file. Raises Faults if none is left."""
    columns, lost = informative(record, output)
    name = column_of(output, record.columns)
    unjudged = {name: "film and its meter", "current_A": "plate, driver and thermometer"}
    notes = [f"{column}: {why}: {unjudged[column]} were not judged" for column, why in lost.items()]
    if name not in columns and "current_A" not in columns:
        lines = [f"{record.source}: {note}" for note in notes]
        text = f"the temperature alone says nothing of plate or film; expected also current_A or {name} (or both)"
        known = ("time_s", "temperature_degC", name, "current_A", *INPUTS)
        if others := [column for column in (*record.columns, *record.text_columns) if column not in known]:
            text += f". Not used: {', '.join(others[:MOST_OFFERED])}. If one is a current, or a share of full drive, "
            text += f"--column current_A={others[0]}@A, or @duty, @percent, @pwm255; a voltage has first to be "
            text += "converted to a share of full power, (u/u_max)^2"
        raise Faults([*lines, f"{record.source}: {text}"])
    return columns, notes


def informative(record: Record, output: str) -> tuple[dict[str, Array], dict[str, str]]:
    """Return the columns that hold information, each of shape (rows,); and of film and drive by name why a column that
    exists holds none. Raises Faults for too few rows, or a temperature that does not move."""
    if record.rows < FEWEST:
        raise Faults([f"{record.source}: {record.rows} rows; expected at least {FEWEST}"])
    require_moving(record)
    columns, lost = dict(record.columns), {}
    name = column_of(output, record.columns)
    if record.has_output(output):
        changed, needed = _moved(record.output(output), LEAST_DEC if in_decades(output) else 0.0)
        if changed < needed or changed == 0.0:
            unit = "decades" if in_decades(output) else unit_of(output)
            text = f"changes by {changed:.2g} {unit} only, expected at least {needed:.2g}"
            lost[name] = f"{text} (a sweep through the transition)"
    elif name in columns:
        lost[name] = "no finite number"
    if record.has("current_A") and np.nanmax(record["current_A"]) == np.nanmin(record["current_A"]) == 0.0:
        lost["current_A"] = "0 in all rows"
    elif "current_A" in columns and not record.has("current_A"):
        lost["current_A"] = "no finite number"
    return {column: values for column, values in columns.items() if column not in lost}, lost


def require_moving(record: Record) -> None:
    """Raise Faults for a record whose temperature does not move beyond its noise: nothing follows it."""
    if not record.has("temperature_degC"):
        raise Faults([f"{record.source}: temperature_degC: no finite number in {record.rows} rows"])
    moved, needed = _moved(record["temperature_degC"], LEAST_K)
    if moved < needed:
        text = f"temperature_degC: moves by {moved:.2g} K only; expected at least {needed:.2g} K, beyond its noise"
        raise Faults([f"{record.source}: {text}, and steps or sweeps through the film's transition"])


def _moved(values: Array, least: float) -> tuple[float, float]:
    """Return how far finite values move apart from outliers, and how far they have to for anything to be concluded."""
    good = values[np.isfinite(values)]
    if good.size < 3:
        return 0.0, least
    low, high = np.percentile(good, [2.0, 98.0])
    noise = 1.4826 * float(np.median(np.abs(np.diff(good)))) / np.sqrt(2.0)
    most = 20.0 * least if least > 0.0 else math.inf
    return float(high - low), min(max(least, TIMES * noise), most)


def require_different(records: Sequence[Record]) -> None:
    """Raise Faults, a line for each record that holds the same as one before it, whatever their names: held out, it
    would judge the fit to itself."""
    digests, lines = [content_digest(record) for record in records], []
    for k, record in enumerate(records):
        first = records[digests.index(digests[k])].source
        if digests.index(digests[k]) < k:
            same = "is given twice" if first == record.source else f"holds the same as {first}"
            lines.append(f"{record.source}: {same}; expected each record once, fitted or held out")
    if lines:
        raise Faults(lines)


def require_judging(
    holdout: Sequence[Record],
    diagnosed: Sequence[Record],
    usable: Sequence[Mapping[str, Array]],
    output: str,
    say: Callable[[str], None],
) -> None:
    """Raise Faults, before anything is fitted, for held-out records that cannot judge what is diagnosed.

    usable: of each record that is diagnosed the columns that can be used; output: of the film, as in a model file; say:
    called for a record that judges the film alone.
    """
    film = any(column_of(output, columns) in columns for columns in usable)
    plate = any("current_A" in columns for columns in usable)
    lines = []
    for other in holdout:
        name = column_of(output, other.columns)
        try:
            lost = _lost(other, output)
        except Faults as faults:
            lines += faults.lines
            continue
        judged_by = f"by which a held-out record judges that of {diagnosed[0].source}"
        if film and name in lost:
            lines.append(f"{other.source}: {name}: {lost[name]}; expected a film that switches, {judged_by}")
        if plate and "current_A" in lost:
            if film and "current_A" not in other.columns:
                say(f"{other.source}: no current_A: it judges the film alone")
            else:
                expected = f"expected a current that drives the plate, {judged_by}"
                lines.append(f"{other.source}: current_A: {lost['current_A']}; {expected}")
    if lines:
        raise Faults(lines)


def _lost(other: Record, output: str) -> dict[str, str]:
    """Return by name why another record shows nothing of film and drive. Raises Faults if it shows nothing."""
    columns, lost = informative(other, output)
    try:
        rows = read_columns(columns, held_out=False, quantity=Quantity(output))
    except ValueError as error:
        raise Faults(f"{other.source}: {line}" for line in str(error).splitlines()) from None
    name = column_of(output, other.columns)
    if rows.output is None:
        few = f"fewer than {FEWEST} finite readings" if name in columns else "missing"
        lost.setdefault(name, few)
    if rows.current_A is None:
        lost.setdefault("current_A", "missing")
    return lost


SHARE = "share_of_full_drive"  # code of the warning
QUANTIZATION = "thermometer_quantization"  # read off the readings, and in no fit


@dataclass(frozen=True)
class Asked:
    """How to diagnose. base: "generalized_pi": a film without D(T), None: with one; output: of the film, as in a model
    file; plate: its kind, None: what the drive allows; assume: effects that are there, with the parameters that are
    known; budget_s: how long it may take; false_alarm: the share of records without any effect that may be given a
    name; first_s: seconds of a held-out record to which its own room, first temperatures and memory are fitted, None:
    30 s or 20 rows, whichever is more; effect_files: user-defined effects, which another process has to load too."""

    base: str | None = None
    output: str = FALLING_RESISTANCE
    plate: str | None = None
    assume: Mapping[str, Mapping[str, float]] | None = None
    budget_s: float | None = None
    false_alarm: float | None = None
    first_s: float | None = None
    effect_files: tuple[Path, ...] = ()


def diagnosed(
    records: Sequence[Record],
    asked: Asked | None = None,
    holdout: Sequence[Record] = (),
    earlier: Sequence[Record] = (),
    say: Callable[[str], None] = lambda text: None,
) -> tuple[Diagnosis, ExtendedModel]:
    """Return the diagnosis of records of one rig (or one record), and the model that predicts best.

    holdout: other records of the rig, on which the gain is measured; earlier: other records of the film, to which the
    extended model's film is fitted too; say: takes progress. Raises Faults where nothing can be said.
    """
    asked = asked or Asked()
    first = records[0]
    require_different([*records, *holdout])
    if timeless := [one.source for one in (*records, *holdout) if one.times == "rows"]:  # effects differ in their pace
        text = "it has no times, only the order of its rows; a diagnosis needs them: expected --period SECONDS"
        raise Faults(f"{source}: {text}" for source in timeless)
    output = rising(records, asked.output, say)
    usable = [usable_columns(one, output) for one in records]
    for note in dict.fromkeys(note for _, notes in usable for note in notes):
        say(note)
    _require_alike(records, holdout)
    require_judging(holdout, records, [columns for columns, _ in usable], output, say)
    try:
        diagnosis = diagnose(
            *(columns for columns, _ in usable),
            base=asked.base,
            output=output,
            kinds=possible_kinds(records, asked.plate),
            assume=asked.assume,
            false_alarm=FALSE_ALARM if asked.false_alarm is None else asked.false_alarm,
            budget_s=asked.budget_s,
            clock=time.monotonic,
            say=say,
        )
        quantity = diagnosis.record.quantity
        rows = [read_columns(one.columns, held_out=False, quantity=quantity) for one in earlier]
        extended = extended_model(diagnosis.fit, diagnosis.record, rows)
    except (np.linalg.LinAlgError, ArithmeticError) as error:  # the first is a ValueError too
        text = f"no fit could be made of this record ({type(error).__name__}: {error})"
        raise fault(first.source, "", f"{text}; expected readings that follow current or temperature") from None
    except ValueError as error:
        raise Faults(f"{first.source}: {line}" for line in str(error).splitlines()) from None
    film = None if diagnosis.film is None else {**diagnosis.film, **(extended.film_form() or {})}
    for f in diagnosis.findings:
        if f.name == QUANTIZATION:
            rounding: dict[str, float | str] = {"name": f.name, **{p: v for p, (v, _) in f.parameters.items()}}
            extended = replace(extended, effects=(*extended.effects, rounding))
    diagnosis = replace(diagnosis, film=film, sources=tuple(one.source for one in records))
    diagnosis = _with_left_out(diagnosis, records)
    diagnosis = _of_full_drive(diagnosis, next((one.drive for one in records if one.drive is not None), None))
    if holdout:
        say("computing errors on held-out records")
        diagnosis, extended = on_other_records(diagnosis, extended, holdout, asked.first_s)
    return diagnosis, extended


def on_other_records(
    diagnosis: Diagnosis, extended: ExtendedModel, holdout: Sequence[Record], first_s: float | None
) -> tuple[Diagnosis, ExtendedModel]:
    """Return the diagnosis with errors and gains on other records in place of the held-out rows' own, and the model
    that predicts them best: the extended one, the base model, or the likeliest set with what was not named. A base
    model that predicts better takes back that the effects explain anything."""

    def model(fit: Fit) -> ExtendedModel:
        return extended_model(fit, diagnosis.record)

    def errors(of: ExtendedModel) -> _Errors:
        return _errors(diagnosis, model_of(of), holdout, first_s)

    base_model = model(diagnosis.base)
    base = errors(base_model)
    after, written = errors(extended), "extended"
    findings = []
    for finding in diagnosis.findings:
        if (without := diagnosis.without.get(finding.name)) is not None:
            finding = replace(finding, gain=_gains(errors(model(without)), after))
        findings.append(finding)
    verdict = diagnosis.verdict
    if diagnosis.findings and _is_better(after, base):
        verdict, written, extended, after = "partly_unexplained", "base", base_model, base
    if diagnosis.likeliest.effects != diagnosis.fit.effects:
        likeliest = model(diagnosis.likeliest)
        if _is_better(after, other := errors(likeliest)):
            written, extended, after = "likeliest", likeliest, other
    channels = dict(diagnosis.channels)
    for key, found in _gains(base, after).items():
        if (channel := channels.get(key)) is not None:
            channels[key] = Channel(channel.noise, found.rmse_before, found.rmse_after, after.all[key].size)
    elsewhere = tuple(
        HeldOutRecord(record.source, {key: (rms(b[key]), rms(a[key]), a[key].size) for key in a}, room)
        for record, b, a, room in zip(holdout, base.each, after.each, after.rooms_degC, strict=True)
    )
    news: dict[str, Any] = {"verdict": verdict, "channels": channels, "elsewhere": elsewhere, "written": written}
    return replace(diagnosis, findings=tuple(findings), **news), extended


def _gains(before: _Errors, after: _Errors) -> dict[str, Gain]:
    """Return what one model gains over another, by channel."""
    every = {key: np.ones(values.size, dtype=np.bool_) for key, values in after.all.items()}
    return {key: gain(before.all[key], values, every[key]) for key, values in after.all.items()}


def _is_better(errors: _Errors, others: _Errors) -> bool:
    """Return True if another model predicts better: surely so in one channel, and surely worse in none."""
    reductions = [found.reduction_ci95 for found in _gains(errors, others).values()]
    return any(low > 0.0 for low, _ in reductions) and not any(high < 0.0 for _, high in reductions)


@dataclass(frozen=True, eq=False)
class _Errors:
    """A model's errors on other records, by channel: of each its readings that are scored, and all one after the other;
    the room of each."""

    each: list[dict[str, Array]]
    rooms_degC: list[float | None]

    @property
    def all(self) -> dict[str, Array]:
        keys = dict.fromkeys(key for one in self.each for key in one)
        return {key: np.concatenate([one[key] for one in self.each if key in one]) for key in keys}


def _errors(diagnosis: Diagnosis, model: Model, records: Sequence[Record], first_s: float | None) -> _Errors:
    """Return the errors of a model that is run as `predict --initial fitted` runs it."""
    each, rooms = [], []
    for record in records:
        found = predicted(model, record, record.source, initial="fitted", first_s=first_s)
        left = {}
        if found.temperature_degC is not None:
            left["temperature_K"] = found.temperature_degC - record["temperature_degC"]
        if found.output is not None and model.film is not None:
            left[diagnosis.record.quantity.channel] = found.output - record.output(model.film.output)
        scored = {key: values[~found.fitted_rows & np.isfinite(values)] for key, values in left.items()}
        each.append({key: values for key, values in scored.items() if values.size})
        rooms.append(fitted_values(found, model).get("ambient_degC"))
    return _Errors(each, rooms)


def _with_left_out(diagnosis: Diagnosis, records: Sequence[Record]) -> Diagnosis:
    """Return the diagnosis with the rows in which the thermometer was not believed."""
    warnings: list[Caution] = []
    rows: list[dict[str, Any]] = []
    for number, record in enumerate(records, 1):
        of = number if len(records) > 1 else None
        warnings += [Caution("thermometer_not_believed", line, record=of) for line in record.left_out_lines()]
        for one in record.left_out:
            entry = {"record": number, "column": "temperature_degC", "rule": one.why}
            rows += [{**entry, "time_s": t} for t in record["time_s"][one.first : one.last + 1].tolist()]
    return replace(diagnosis, warnings=(*warnings, *diagnosis.warnings), not_believed=tuple(rows))


def _of_full_drive(found: Diagnosis, drive: str | None) -> Diagnosis:
    """Return the diagnosis with a warning where the current is a share of the full drive (in the unit `drive`), and
    without typical sizes in ampere beside numbers in another unit."""
    if drive is None or found.record.current_A is None:
        return found
    text = (
        f"A stands for the full drive here: current_A is a share of it ({drive}). What is in A is a share, too, and "
        "what is per A is per full drive"
    )
    limits = tuple(replace(limit, typical=None) if limit.parameter.endswith("_A") else limit for limit in found.limits)
    return replace(found, warnings=(Caution(SHARE, text), *found.warnings), limits=limits, drive=drive)


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


def model_of(extended: ExtendedModel) -> Model:
    """Return a model as a model file has it: of a record with current, the current drives the film."""
    drive = "current" if extended.plate is not None else None
    return Model(extended.film, extended.plate, extended.effects, drive)  # type: ignore[arg-type]


def possible_kinds(records: Sequence[Record], plate: str | None) -> tuple[Kind, ...]:
    """The kinds of plate to try: a drive that cools in none of the records may be a heater's, in ampere, too."""
    if plate is not None:
        return ("heater",) if plate == "heater" else ("peltier",)
    if any(record.drive == "pwm255" for record in records):  # a switched heater's drive is its power
        return ("heater",)
    driven = [record["current_A"] for record in records if record.has("current_A")]
    if driven and not any(bool((current < 0.0).any()) for current in driven):
        return ("peltier", "heater")
    return ("peltier",)
