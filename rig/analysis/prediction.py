"""A model against a record: simulated output and temperature, their errors, and what to know of them.

The chain (`sim.model.record_run`) is simulated over the whole record, from its current or from its temperature; never
one step ahead.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from compensator.hysteresis.film import FilmModel
from compensator.hysteresis.functions import Array
from compensator.thermal.plate import PlateModel
from rig.analysis.error import OF_MODEL, RESIDUAL, in_brackets, judgement, largest, residual, rms
from rig.analysis.film_records import beyond_seen
from rig.analysis.inversion import order_warning
from rig.config.model_file import Drive, Model
from rig.core.faults import fault
from rig.records.film_output import RISING_RESISTANCE, column_of, in_decades, sign_of, unit_of
from rig.records.record_file import Record
from sim.effects.catalogue import catalogue
from sim.effects.effect import Switched, Warming, of_resistances
from sim.inference.nuisance import LEAST_NOISE_DEC, Told, first_readings, fit_own, told_rows
from sim.inference.record.record import Mask, own_noise, read_columns, told_of
from sim.inference.record.record import Record as Rows
from sim.model.chain import NO_PLATE, ChainModel
from sim.model.record_own import FilmStart, RecordOwn, long_gaps
from sim.model.record_run import RecordRun, straight_path
from sim.world.films import RisingFilm, film_of_world

Initial = Literal["cooled", "heated", "fitted"]


@dataclass(frozen=True, eq=False)
class Prediction:
    """A simulated record.

    output: of the film, temperature_degC: of the thermometer, both shape (rows,), nan where the model predicts nothing;
    None if the model or the record lacks what it takes. driven_by: source of the film's temperature, None without a
    film. fitted_rows: rows to which the record's own state was fitted, which are not scored; own: that state, None if
    nothing was fitted. gaps_s: duration of each gap through which the film's memory is unknown.
    """

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
    """Simulate the film's output and, from a current, the thermometer's temperature. Raises Faults.

    drive: what drives the film; None: as the model file says, else the current if the model has effects. initial: the
    film's memory, None: the model's; "fitted": with room and first temperatures, to the first rows (first_s seconds of
    each stretch; None: 30 s or 20 rows, whichever is more). where: the model's file.
    """
    rows = _rows(record)
    if initial == "fitted":  # rows that a command sent in a gap may still change are of no use for the fit
        rows = rows.commanded_in_sight(catalogue().values())
    plate = model.plate is not None and record.has("current_A")
    drive = drive or model.drive or ("current" if model.effects else "temperature")
    if drive == "current" and not plate:
        drive = "temperature"
    if plate and model.plate is not None:
        for name in missing_inputs(record, [name for name, _ in model.plate.inputs]):
            raise fault(record.source, name, f"missing; the plate of {where} is heated by it, too")
    effects = model.switched()
    for e in effects if model.film is not None and not in_decades(model.film.output) else ():
        if of_resistances(e.effect):
            text = f"{e.name}: has no meaning for the film output {model.film.output!r}"  # type: ignore[union-attr]
            raise fault(where, "effects", text)
    fitted = initial == "fitted"
    if first_s is not None and not fitted:
        raise fault("--first", f"{first_s:g}", "expected --initial fitted with it: else nothing is fitted")
    if first_s is not None and not 0.0 < first_s < math.inf:
        raise fault("--first", f"{first_s:g}", "expected a number of seconds > 0")
    first_rows = told_rows(rows, first_s) if fitted else np.zeros(rows.rows, dtype=np.bool_)
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
            alone = readings.only(first_rows) if drive == "current" else replace(readings.only(first_rows), output=None)
            own, _ = fit_own(chain, rows, alone, start)
            first = own
        run = chain.plate(rows, first)
        path, shown = run.path, chain.links.shown_degC(np.where(_covered(rows, readings), run.shown_degC, math.nan))
    if model.film is None:
        return Prediction(None, shown, None, first_rows, own)
    if drive == "temperature":
        effects = tuple(e for e in effects if not e.effect.before_film)
        chain = RecordRun(ChainModel(NO_PLATE, film, effects))
        known = np.isfinite(record["temperature_degC"])  # in between the readings are interpolated
        degC = np.interp(rows.time_s, rows.time_s[known], record["temperature_degC"][known])
        path = straight_path(rows.time_s, degC, chain.spacing.longest_s)
        of_film = RecordOwn(chain.ambient_degC, np.zeros(1), film=start)
        if fitted:
            of_film, _ = fit_own(chain, rows, readings.only(first_rows), start, path)
            own = replace(own, film=of_film.film, late=of_film.late) if own is not None else of_film
        output = chain.shown(rows, path, of_film)
    else:
        assert path is not None
        output, known = chain.shown(rows, path, first), _covered(rows, readings)
    after = long_gaps(rows)
    unseen_s = tuple((rows.time_s[after] - rows.time_s[after - 1]).tolist())
    return Prediction(np.where(known, sense * output, math.nan), shown, drive, first_rows, own, unseen_s)


def needs_test_current(effects: tuple[Switched, ...]) -> bool:
    """Return True if one of the effects depends on the ohmmeter's power in the film."""
    return any(isinstance(e.effect.form, Warming) and e.effect.form.heated for e in effects)


def missing_inputs(record: Record, names: Iterable[str]) -> list[str]:
    """Return those of some inputs that a record does not have."""
    return [name for name in names if not record.has(name)]


def _rows(record: Record) -> Rows:
    """Return when the record's rows were commanded and read, with gaps found as a diagnosis finds them."""
    if "temperature_degC" in record.columns and not record.has("temperature_degC"):
        raise fault(record.source, "temperature_degC", f"no finite number in {record.rows} rows, expected degC")
    try:
        rows = read_columns({n: record[n] for n in record.columns if record.has(n)}, held_out=False, fewest=1)
    except ValueError as error:
        name, _, text = str(error).splitlines()[0].partition(": ")
        raise fault(record.source, name, text) from None
    if rows.current_A is None and record.has("current_A"):
        rows = replace(rows, current_A=np.zeros(rows.rows))
    return rows


def _readings(rows: Rows, record: Record, film: FilmModel | None, plate: PlateModel | None) -> Told:
    """Return the readings, of the film as the output of its model, with the error of the plate's model."""
    readings = told_of(rows)
    if plate is not None:
        readings = replace(readings, error_K=plate.error_K, error_time_s=plate.error_time_s)
    output = None
    if film is not None and record.has_output(film.output):
        output = np.asarray(record.output(film.output), dtype=np.float64)
        output = np.where(np.isfinite(output), output, np.nan)
        if readings.output is not None and in_decades(film.output):
            output = readings.output  # without what stands out of its neighbours
        elif film.output == RISING_RESISTANCE:
            output = -output
    sigma_dec = max(LEAST_NOISE_DEC, own_noise(output)) if output is not None else LEAST_NOISE_DEC
    return replace(readings, output=output, sigma_dec=sigma_dec)


def _start(film: FilmModel | None, initial: Initial | None, readings: Told) -> FilmStart:
    """Return the film's memory at the first reading of the thermometer."""
    if film is None:
        return FilmStart()
    chosen: Any = film.initial if initial in (None, "fitted") else initial
    if initial == "fitted":
        return FilmStart(chosen)
    return FilmStart(chosen, (float(readings.temperature_degC[np.isfinite(readings.temperature_degC)][0]),))


def _covered(rows: Rows, readings: Told) -> Mask:
    """Return True for the rows from the first reading of the thermometer on, in each stretch."""
    read, seen = np.isfinite(readings.temperature_degC), np.zeros(rows.rows, dtype=np.bool_)
    for begin, end in zip(rows.first_rows, [*rows.first_rows[1:], rows.rows], strict=True):
        known = np.flatnonzero(read[begin:end])
        if known.size:
            seen[begin + known[0] : end] = True
    return seen


@dataclass(frozen=True, eq=False)
class ChannelError:
    """Error of one channel of a record, over the rows to which nothing was fitted.

    name: the film's output, or "temperature_degC"; what: in words; unit: of rmse and max_abs (dec, K, or the column's);
    rows: number compared; mean_residual: of measured - model. measured, predicted: shape (rows of the record,), nan
    where there is nothing.
    """

    name: str
    what: str
    unit: str
    rmse: float
    max_abs: float
    rows: int
    mean_residual: float
    measured: Array
    predicted: Array

    @property
    def residual(self) -> Array:
        """Measured - model (`rig.analysis.error`), shape (rows of the record,)."""
        return residual(self.measured, self.predicted, self.name)

    def in_words(self) -> str:
        """Return a line for people."""
        judged = in_brackets(judgement(self.rmse, self.unit, OF_MODEL))
        sizes = f"RMS error {self.rmse:.4f} {self.unit}{judged}, largest {self.max_abs:.4f} {self.unit}"
        return f"{self.what}: {sizes}, mean of {RESIDUAL} {self.mean_residual:+.4f} {self.unit}, {self.rows} rows"

    def document(self) -> dict[str, Any]:
        return {
            f"rmse_{self.unit}": self.rmse,
            f"max_abs_{self.unit}": self.max_abs,
            f"rows_{self.unit}": self.rows,
            f"mean_residual_{self.unit}": self.mean_residual,
        }


@dataclass(frozen=True, eq=False)
class Comparison:
    """A prediction compared with its record.

    columns: as a file has them: predicted_ohm, or predicted_ with the output's own column; predicted_degC; and of each
    channel that was measured residual_dec, residual_K or residual_UNIT. fitted: the record's own state, if it was
    fitted. warnings: what the model leaves out or extrapolates; notes: what to know of record and simulation.
    """

    record: Record
    found: Prediction
    errors: tuple[ChannelError, ...]
    columns: dict[str, Array]
    fitted: dict[str, Any]
    warnings: tuple[str, ...]
    notes: tuple[str, ...]

    def lines(self, first_s: float | None) -> list[str]:
        """Return the lines for the terminal. first_s: duration of the fitted rows that was asked for, None: default."""
        lines = [*self.notes]
        if self.fitted:
            shown = {
                k: f"{v:.4g}" if isinstance(v, float) else "none" if v is None else v for k, v in self.fitted.items()
            }
            values = ", ".join(f"{name} {value}" for name, value in shown.items() if name != "rows")
            lines.append(f"fitted to {_fitted_rows_in_words(self.found, self.record['time_s'], first_s)}: {values}")
        return [*lines, *(error.in_words() for error in self.errors)]

    def document(self, model: object) -> dict[str, Any]:
        """Return the JSON of `peltier predict`. model: its file."""
        result: dict[str, Any] = {"format": "peltier-prediction/1", "model": model, "record": self.record.source}
        optional = {"notes": list(self.notes), "film_driven_by": self.found.driven_by, "fitted": self.fitted}
        result |= {name: value for name, value in optional.items() if value}
        result["left_out"] = self.record.left_out_document()
        for error in self.errors:
            result |= error.document()
        return result


def compared(
    model: Model,
    record: Record,
    where: object,
    *,
    initial: Initial | None = None,
    drive: Drive | None = None,
    first_s: float | None = None,
) -> Comparison:
    """Predict a record and compare; the arguments are those of `predicted`. Raises Faults."""
    found = predicted(model, record, where, initial=initial, drive=drive, first_s=first_s)
    errors = tuple(errors_of(found, model, record))
    warnings = [
        order_warning(model.film, where) if model.film is not None else None,
        beyond_seen(model, record["temperature_degC"], where),
    ]
    if model.film is not None and needs_test_current(model.switched()) and not record.has("meter_current_A"):
        warnings.append(f"{record.source}: no meter_current_A: the model's self-heating is left out")
    room = None  # the model's is of another day
    if found.own is None and found.temperature_degC is not None and model.plate is not None:
        room = f"room temperature taken from the model, {model.plate.ambient_degC:.1f} degC; "
        room += "--initial fitted fits it to the record's first rows"
    notes = [*record.left_out_lines(), _gap_note(found), room]
    return Comparison(
        record,
        found,
        errors,
        _columns(found, model, errors),
        fitted_values(found, model),
        tuple(text for text in warnings if text is not None),
        tuple(f"{record.source}: {text}" for text in notes if text is not None),
    )


def require_something_to_predict(model: Model, record: Record, where: object, drive: Drive | None = None) -> None:
    """Raise Faults for a model without a film on a record from whose current no plate can be simulated, and if such a
    plate is to drive the film (drive, None: as the model says)."""
    plate = model.plate is not None and record.has("current_A") and record.times != "rows"
    if model.film is None and not plate:
        text = f"missing; expected a [film], or a [plate] and current_A in {record.source}"
        raise fault(where, "film", text)
    if drive == "current" and not plate:
        lacks = f"{where} has no [plate]" if model.plate is None else f"{record.source} has no current_A"
        raise fault("--drive", drive, f"{lacks}; expected --drive temperature")


def errors_of(found: Prediction, model: Model, record: Record) -> list[ChannelError]:
    """Return the errors of the film's output and of the temperature, each if it was both predicted and measured."""
    pairs = []
    if model.film is not None and found.output is not None and record.has_output(model.film.output):
        name = model.film.output
        what = "log R" if in_decades(name) else column_of(name)
        pairs.append((name, what, unit_of(name), record.output(name), found.output))
    if found.temperature_degC is not None:
        degC = record["temperature_degC"]
        pairs.append(("temperature_degC", "temperature", "K", degC, found.temperature_degC))
    errors = []
    for name, what, unit, measured, predicted in pairs:
        error = residual(measured, predicted, name)[~found.fitted_rows]
        error = error[np.isfinite(error)]
        if error.size:
            sizes = rms(error), largest(error), int(error.size), float(np.mean(error))
            errors.append(ChannelError(name, what, unit, *sizes, measured, predicted))
    return errors


def fitted_values(found: Prediction, model: Model) -> dict[str, Any]:
    """Return the record's own state as it was fitted: rows, ambient_degC, first_degC, memory, turned_at_degC; empty if
    nothing was fitted."""
    if found.own is None:
        return {}
    film = found.own.film
    fitted: dict[str, Any] = {"rows": int(np.sum(found.fitted_rows))}
    if model.plate is not None and found.temperature_degC is not None:
        fitted["ambient_degC"] = found.own.ambient_degC
        fitted["first_degC"] = float(found.own.plate_degC[0])
    if model.film is not None:
        fitted |= {"memory": film.initial, "turned_at_degC": list(film.turned_degC)}
    return fitted


def _columns(found: Prediction, model: Model, errors: Sequence[ChannelError]) -> dict[str, Array]:
    columns: dict[str, Array] = {}
    if model.film is not None and found.output is not None:
        output = model.film.output
        quantity = sign_of(output) * found.output
        name = column_of(output)
        name = "predicted_ohm" if name == "resistance_ohm" else f"predicted_{name}"
        columns[name] = 10.0**quantity if in_decades(output) else quantity
    if found.temperature_degC is not None:
        columns["predicted_degC"] = found.temperature_degC
    return columns | {f"residual_{one.unit}": one.residual for one in errors}


def _gap_note(found: Prediction) -> str | None:
    """Return a line on gaps through which the film's memory is unknown, and what the simulation assumes there."""
    if not found.gaps_s:
        return None
    count = len(found.gaps_s)
    seen = f"{count} gap{'s' * (count > 1)} in which the temperature is unknown, the longest of "
    seen += f"{max(found.gaps_s):.3g} s: "
    if found.own is None:
        return f"{seen}the film's memory goes straight through; --initial fitted finds it from the rows that follow"
    went = found.own.film.passed_degC
    if not went:
        return f"{seen}the first rows after show no excursion, the film's memory goes straight through"
    degC = "; ".join(" and ".join(f"{t:.1f}" for t in both) for _, both in went)
    return f"{seen}by the first rows after, the film's memory is as if the temperature had gone to {degC} degC"


def _fitted_rows_in_words(found: Prediction, time_s: Array, first_s: float | None) -> str:
    """Return to which rows (time_s, shape (rows,)) the record's own state was fitted. first_s: as in `lines`."""
    fitted = found.fitted_rows.astype(np.int64)
    begins, ends = np.flatnonzero(np.diff(fitted, prepend=0) == 1), np.flatnonzero(np.diff(fitted, append=0) == -1) + 1
    first, after = int(ends[0] - begins[0]), int(np.sum(ends[1:] - begins[1:]))
    text, gaps = f"the first {first} rows", begins.size - 1
    if gaps:
        text += f" and {after} after {'a gap' if gaps == 1 else f'{gaps} gaps'}"
    goes_on = ends < time_s.size
    fewer = first_s is not None and np.any(time_s[ends[goes_on]] - time_s[begins[goes_on]] <= first_s)
    return f"{text} (half of the rows at most: the rest is to be predicted)" if fewer else text
