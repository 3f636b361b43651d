"""A prediction beside its record: the error of each channel, the columns of a file, what belongs to the record."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from compensator.hysteresis.functions import Array
from rig.analysis.predicted import Prediction, needs_test_current
from rig.analysis.residual import RESIDUAL, residual
from rig.config.model_file import Drive, Model
from rig.core.faults import fault
from rig.records.film_output import column_of, in_decades, sign_of, unit_of
from rig.records.record_file import Record


@dataclass(frozen=True, eq=False)
class ChannelError:
    """One channel of a record beside its prediction; errors over the rows to which nothing was fitted.

    name: the film's output, or "temperature_degC"; what: in words; unit: of rmse and max_abs (dec, K, or the column's);
    rows: how many were compared; mean_residual: of measured - model over them. measured, predicted: shape (rows of the
    record,), all of them, nan where there is nothing."""

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
        """Measured - model (`rig.analysis.residual`), shape (rows of the record,)."""
        return residual(self.measured, self.predicted, self.name)

    def in_words(self) -> str:
        """Return a line for people."""
        sizes = f"RMSE {self.rmse:.4f} {self.unit}, largest {self.max_abs:.4f} {self.unit}"
        return f"{self.what}: {sizes}, mean of {RESIDUAL} {self.mean_residual:+.4f} {self.unit}, {self.rows} rows"

    def document(self) -> dict[str, Any]:
        """As the JSON of `peltier predict` has it."""
        return {
            f"rmse_{self.unit}": self.rmse,
            f"max_abs_{self.unit}": self.max_abs,
            f"rows_{self.unit}": self.rows,
            f"mean_residual_{self.unit}": self.mean_residual,
        }


def require_something_to_predict(model: Model, record: Record, where: object, drive: Drive | None = None) -> None:
    """Raises Faults for a model without a film on a record from whose current no plate can be simulated, and where such
    a plate is to drive the film (drive, None: as the model says)."""
    plate = model.plate is not None and record.has("current_A") and record.times != "rows"
    if model.film is None and not plate:
        text = f"missing; expected a [film], or a [plate] and current_A in {record.source}"
        raise fault(where, "film", text)
    if drive == "current" and not plate:
        lacks = f"{where} has no [plate]" if model.plate is None else f"{record.source} has no current_A"
        raise fault("--drive", drive, f"{lacks}; expected --drive temperature")


def left_out(model: Model, record: Record) -> str | None:
    """A line for what the model has and the record cannot drive."""
    if model.film is not None and needs_test_current(model.switched()) and not record.has("meter_current_A"):
        return f"{record.source}: no meter_current_A: the model's self-heating is left out"
    return None


def gap_note(found: Prediction, record: Record) -> str | None:
    """A line for gaps in the rows that the film's memory is not known through, and what was made of it there."""
    if not found.gaps_s:
        return None
    count = len(found.gaps_s)
    seen = f"{record.source}: {count} gap{'s' * (count > 1)} in which the temperature is unknown, the longest of "
    seen += f"{max(found.gaps_s):.3g} s: "
    if found.own is None:
        return f"{seen}the film's memory goes straight through; --initial fitted finds it from the rows that follow"
    went = [degC for degC in found.own.film.passed_degC if any(np.isfinite(degC))]
    if not went:
        return f"{seen}the first rows after show no excursion, the film's memory goes straight through"
    degC = "; ".join(" and ".join(f"{t:.1f}" for t in both if np.isfinite(t)) for both in went)
    return f"{seen}by the first rows after, the film's memory is as if the temperature had gone to {degC} degC"


def room_note(found: Prediction, model: Model, record: Record) -> str | None:
    """A line for a plate whose room is that of another day, or one that the model's own record did not tell."""
    if found.own is not None or found.temperature_degC is None or model.plate is None:
        return None
    room = f"{model.plate.ambient_degC:.1f} degC"
    said = f"the room is the model's, {room}; --initial fitted finds the record's own in its first rows"
    return f"{record.source}: {said}"


def errors_of(found: Prediction, model: Model, record: Record) -> list[ChannelError]:
    """Of the film's output and of the temperature, each where it was both predicted and measured."""
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
            rmse, largest = float(np.sqrt(np.mean(error**2))), float(np.max(np.abs(error)))
            mean = float(np.mean(error))
            errors.append(ChannelError(name, what, unit, rmse, largest, int(error.size), mean, measured, predicted))
    return errors


def predicted_columns(found: Prediction, model: Model, errors: Sequence[ChannelError] = ()) -> dict[str, Array]:
    """By name, as a file has them: predicted_ohm, or predicted_ with the output's own column; predicted_degC; and of
    each channel that was measured too residual_dec, residual_K or residual_UNIT, measured - model."""
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


def told_in_words(found: Prediction, time_s: Array, first_s: float | None) -> str:
    """Which rows of a record (time_s, shape (rows,)) what belongs to it was fitted to. first_s: how long they were to
    last; None: it was not said."""
    told = found.fitted_rows.astype(np.int64)
    begins, ends = np.flatnonzero(np.diff(told, prepend=0) == 1), np.flatnonzero(np.diff(told, append=0) == -1) + 1
    first, after = int(ends[0] - begins[0]), int(np.sum(ends[1:] - begins[1:]))
    text, gaps = f"the first {first} rows", begins.size - 1
    if gaps:
        text += f" and {after} after {'a gap' if gaps == 1 else f'{gaps} gaps'}"
    goes_on = ends < time_s.size
    fewer = first_s is not None and np.any(time_s[ends[goes_on]] - time_s[begins[goes_on]] <= first_s)
    return f"{text} (half of the rows at most: the rest is to be predicted)" if fewer else text


def fitted_values(found: Prediction, model: Model) -> dict[str, Any]:
    """What belongs to the record, as it was fitted: rows, ambient_degC, first_degC, memory, turned_at_degC; empty where
    nothing was."""
    if found.own is None:
        return {}
    film = found.own.film
    fitted: dict[str, Any] = {"rows": int(np.sum(found.fitted_rows))}
    if model.plate is not None and found.temperature_degC is not None:
        fitted["ambient_degC"] = found.own.ambient_degC
        fitted["first_degC"] = float(found.own.plate_degC[0])
    if model.film is not None:
        fitted |= {"memory": film.initial, "turned_at_degC": film.previous_degC}
    return fitted
