"""What a model says of a record: the chain run over it (`sim.model.record_run`), from its current or temperature."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from compensator.hysteresis.film import FilmModel
from compensator.hysteresis.functions import Array
from compensator.thermal.plate import PlateModel
from rig.config.model_file import Drive, Model
from rig.core.faults import fault
from rig.records.film_output import RISING_RESISTANCE, column_of, in_decades
from rig.records.record_file import Record
from sim.effects.catalogue import catalogue
from sim.effects.effect import Switched, Warming, of_resistances
from sim.inference.nuisance import LEAST_NOISE_DEC, Told, first_readings, fit_own, told_rows
from sim.inference.record.record import Mask, own_noise, read_columns, told_of
from sim.inference.record.record import Record as Rows
from sim.model.chain import NO_PLATE, ChainModel
from sim.model.inputs import NAMES as INPUTS
from sim.model.plate_path import PlatePath
from sim.model.record_own import FilmStart, RecordOwn, long_gaps
from sim.model.record_run import RecordRun, straight_path
from sim.world.films.rising import RisingFilm, film_of_world

Initial = Literal["cooled", "heated", "fitted"]


@dataclass(frozen=True, eq=False)
class Prediction:
    """output: of the film, temperature_degC: of the thermometer, both (rows,), nan where the model says nothing, None
    the model or the record lacks what it takes; driven_by: what the film's temperature came from, None without a film;
    fitted_rows: those to which what belongs to the record was fitted, which are not scored; own: what was fitted, None
    where nothing was; gaps_s: how long each gap lasted that the film's memory is not known through."""

    output: Array | None
    temperature_degC: Array | None
    driven_by: Drive | None
    fitted_rows: Mask
    own: RecordOwn | None = None
    gaps_s: tuple[float, ...] = ()


def predicted(
    model: Model,
    record: Record,
    where: object,
    *,
    initial: Initial | None = None,
    drive: Drive | None = None,
    first_s: float | None = None,
) -> Prediction:
    """The film's output and, from a current, the thermometer's temperature.

    drive: what drives the film; None: as the model file says, else the current where the model has effects. initial: of
    the film's memory, None: the model's; "fitted": with room and first temperatures, to the first rows (first_s seconds
    of each stretch; None: 30 s or 20 rows, whichever is more). where: the model's file. Raises Faults.
    """
    rows = _rows(record)
    if initial == "fitted":  # what a command sent in a gap may still change tells nothing of the record's own
        rows = rows.commanded_in_sight(catalogue().values())
    plate = model.plate is not None and record.has("current_A")
    drive = drive or model.drive or ("current" if model.effects else "temperature")
    if drive == "current" and not plate:
        drive = "temperature"
    if plate and model.plate is not None:
        for name in missing_inputs(record, [name for name, _ in model.plate.inputs]):
            raise fault(record.source, name, f"missing; the plate of {where} is heated by it, too")
    effects = _meaningful(model, where)
    fitted = initial == "fitted"
    told = _first_rows(rows, first_s, fitted)
    readings = _readings(rows, record, model.film, model.plate)
    if fitted and model.film is not None and readings.output is None:
        raise fault(record.source, column_of(model.film.output), "missing; --initial fitted needs readings to fit to")
    film = film_of_world(model.film) if model.film is not None else None
    sense = -1.0 if isinstance(film, RisingFilm) else 1.0  # an ohmmeter reads -log10 of a film that rises, too
    chain = RecordRun(ChainModel(model.plate or NO_PLATE, film, effects))
    start = _start(model.film, initial, readings)
    own, path, shown = None, None, None
    if plate:
        first = RecordOwn(chain.ambient_degC, first_readings(rows, readings.temperature_degC), film=start)
        if fitted:
            alone = readings.only(told) if drive == "current" else replace(readings.only(told), output=None)
            own, _ = fit_own(chain, rows, alone, start)
            first = own
        run = chain.plate(rows, first)
        path, shown = run.path, chain.links.shown_degC(np.where(_covered(rows, readings), run.shown_degC, math.nan))
    if model.film is None:
        return Prediction(None, shown, None, told, own)
    if drive == "temperature":
        effects = tuple(e for e in effects if not e.effect.before_film)
        chain = RecordRun(ChainModel(NO_PLATE, film, effects))
        path = _as_read(rows, record, chain.spacing.longest_s)
        of_film = RecordOwn(chain.ambient_degC, np.zeros(1), film=start)
        if fitted:
            of_film, _ = fit_own(chain, rows, readings.only(told), start, path)
            own = replace(own, film=of_film.film, late=of_film.late) if own is not None else of_film
        output = chain.shown(rows, path, of_film)
        known = np.isfinite(record["temperature_degC"])
    else:
        assert path is not None
        output, known = chain.shown(rows, path, first), _covered(rows, readings)
    return Prediction(np.where(known, sense * output, math.nan), shown, drive, told, own, _unseen_s(rows))


def needs_test_current(effects: tuple[Switched, ...]) -> bool:
    """Whether the ohmmeter's power in the film matters."""
    return any(isinstance(e.effect.form, Warming) and e.effect.form.heated for e in effects)


def missing_inputs(record: Record, names: Iterable[str]) -> list[str]:
    """Those of some inputs that a record does not have."""
    return [name for name in names if not record.has(name)]


def _meaningful(model: Model, where: object) -> tuple[Switched, ...]:
    """The model's effects. Raises Faults for one that the film's output cannot have."""
    effects = model.switched()
    if model.film is not None and not in_decades(model.film.output):
        for e in effects:
            if of_resistances(e.effect):
                text = f"{e.name}: has no meaning for the film output {model.film.output!r}"
                raise fault(where, "effects", text)
    return effects


def _rows(record: Record) -> Rows:
    """When the record's rows were commanded and read, gaps found as a diagnosis finds them."""
    asked = (
        "time_s",
        "temperature_degC",
        "current_A",
        "resistance_ohm",
        "meter_current_A",
        "resistance_time_s",
        "current_time_s",
        "meter_current_time_s",
        *INPUTS,
    )
    if "temperature_degC" in record.columns and not record.has("temperature_degC"):
        raise fault(record.source, "temperature_degC", f"no finite number in {record.rows} rows, expected degC")
    try:
        rows = read_columns({n: record[n] for n in asked if record.has(n)}, held_out=False, fewest=1)
    except ValueError as error:
        name, _, text = str(error).splitlines()[0].partition(": ")
        raise fault(record.source, name, text) from None
    if rows.current_A is None and record.has("current_A"):
        rows = replace(rows, current_A=np.zeros(rows.rows))
    return rows


def _readings(rows: Rows, record: Record, film: FilmModel | None, plate: PlateModel | None) -> Told:
    """What was read, of the film in the output of its model, and by how much the plate's model is off."""
    told = told_of(rows)
    if plate is not None:
        told = replace(told, error_K=plate.error_K, error_time_s=plate.error_time_s)
    output = None
    if film is not None and record.has_output(film.output):
        output = np.asarray(record.output(film.output), dtype=np.float64)
        output = np.where(np.isfinite(output), output, np.nan)
        if told.output is not None and in_decades(film.output):
            output = told.output  # without what stands out of its neighbours
        elif film.output == RISING_RESISTANCE:
            output = -output
    sigma_dec = max(LEAST_NOISE_DEC, own_noise(output)) if output is not None else LEAST_NOISE_DEC
    return replace(told, output=output, sigma_dec=sigma_dec)


def _start(film: FilmModel | None, initial: Initial | None, readings: Told) -> FilmStart:
    """The memory that the first reading of the thermometer stands for."""
    if film is None:
        return FilmStart()
    chosen: Any = film.initial if initial in (None, "fitted") else initial
    if initial == "fitted":
        return FilmStart(chosen)
    return FilmStart(chosen, float(readings.temperature_degC[np.isfinite(readings.temperature_degC)][0]))


def _first_rows(rows: Rows, first_s: float | None, fitted: bool) -> Mask:
    """Those to which what belongs to the record is fitted. Raises Faults for seconds that are none, or for none."""
    if first_s is not None and not fitted:
        raise fault("--first", f"{first_s:g}", "expected --initial fitted beside it: else nothing is fitted")
    if first_s is not None and not 0.0 < first_s < math.inf:
        raise fault("--first", f"{first_s:g}", "expected a number of seconds > 0")
    return told_rows(rows, first_s) if fitted else np.zeros(rows.rows, dtype=np.bool_)


def _unseen_s(rows: Rows) -> tuple[float, ...]:
    """How long each gap lasted that the film's memory is not known through."""
    after = long_gaps(rows)
    return tuple((rows.time_s[after] - rows.time_s[after - 1]).tolist())


def _covered(rows: Rows, readings: Told) -> Mask:
    """The rows from the first reading of the thermometer on, in each stretch."""
    read, seen = np.isfinite(readings.temperature_degC), np.zeros(rows.rows, dtype=np.bool_)
    for begin, end in zip(rows.first_rows, [*rows.first_rows[1:], rows.rows], strict=True):
        known = np.flatnonzero(read[begin:end])
        if known.size:
            seen[begin + known[0] : end] = True
    return seen


def _as_read(rows: Rows, record: Record, longest_s: float) -> PlatePath:
    """The thermometer's readings, straight between them."""
    degC = record["temperature_degC"]
    known = np.isfinite(degC)
    return straight_path(rows.time_s, np.interp(rows.time_s, rows.time_s[known], degC[known]), longest_s)
