"""The transition and the reversal curves of a record, as `identify` and `calibrate` report them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from compensator.hysteresis.functions import Array
from rig.analysis.score import Rows
from rig.analysis.transition_words import WORDS, document, lines, notes, rows
from rig.records.film_output import in_decades, sign_of, unit_of
from rig.records.record import Record
from rig.records.thermometer_faults import describe_false_readings, find_false_readings, mask_readings
from sim.inference.quantity import untold
from sim.inference.readings.repeated import repeated_rows
from sim.inference.readings.temperature_path import temperature_path
from sim.inference.transition.forc import Forc, forc
from sim.inference.transition.transition import Transition, transition

FAR_OFF = 5.0  # times the noise
NO_JUMPS = 0.98  # of the changes from reading to reading
FEWEST = 20  # readings that tell their noise
LEAST = 1e-3  # of the output: of readings without noise no model is asked to be closer
MOST_READINGS = 50_000  # beyond it every so many rows are taken: no ramp has more to say


@dataclass(frozen=True, eq=False)
class FilmNumbers:
    """What a record shows of its film without a model. output: its name; lag_s: the thermometer's lag behind the plate
    that was taken out of the temperatures, None where none is known. timed: whether the record has times, else no rates
    are reported."""

    source: str
    output: str
    transition: Transition
    forc: Forc
    lag_s: float | None = None
    timed: bool = True

    def lines(self) -> list[str]:
        """For the terminal."""
        return lines(self.transition, self.forc, self.unit, self.lag_s, self.timed)

    def notes(self) -> list[str]:
        """What to know of the numbers."""
        return notes(self.transition, self.lag_s, self.timed)

    def document(self) -> dict[str, Any]:
        """For the JSON."""
        return document(self.source, self.transition, self.forc, self.lag_s, self.timed)

    @property
    def unit(self) -> str:
        """Of the output, where it is no resistance."""
        return unit_of(self.output)


def film_numbers(
    time_s: Array, degC: Array, output: Array, name: str, source: str, lag_s: float | None = None
) -> FilmNumbers:
    """Of arrays of shape (rows,): s, degC, and the output of that name, nan where there is no reading."""
    step = -(-time_s.size // MOST_READINGS)
    thin = slice(None, None, step)
    decades = in_decades(name)
    sign = -sign_of(name) if decades else sign_of(name)  # -log10 R, or the column as the record has it
    columns = time_s[thin], degC[thin], sign * output[thin]
    found = transition(*columns, in_decades=decades)
    return FilmNumbers(source, name, found, forc(*columns, in_decades=decades), lag_s)


def doubted(numbers: FilmNumbers, modelled: Array, measured: Array) -> FilmNumbers:
    """Return the numbers as they may be stated beside a film model of the record: none, where the model is off by more
    than `FAR_OFF` times the noise.

    modelled, measured: the output, shape (rows,), nan where there is none.
    """
    times = times_the_noise(modelled - measured, float(np.ptp(measured[np.isfinite(measured)])))
    if times <= FAR_OFF:
        return numbers
    why = f"the film model is off by {times:.0f} times the noise, so that this record may not be what it is taken for"
    found, named = numbers.transition, dict(rows(numbers.transition, numbers.unit))
    quantities = {
        name: quantity if quantity.value is None else untold(f"{why} (it shows {named[WORDS[name][0]]})")
        for name, quantity in found.quantities.items()
    }
    return replace(numbers, transition=replace(found, quantities=quantities))


def times_the_noise(residual: Array, span: float) -> float:
    """Return how many times the noise a fit is off (RMS). The noise is what changes from reading to reading, without
    the largest jumps. span: of the output."""
    finite = residual[np.isfinite(residual)]
    if finite.size < FEWEST:
        return 0.0
    changes = np.sort(np.diff(finite, 2) ** 2)[: math.ceil(NO_JUMPS * (finite.size - 2))]
    noise = math.sqrt(float(np.mean(changes)) / 6.0)
    return float(np.sqrt(np.mean(finite**2))) / max(noise, LEAST * span)


def numbers_of_record(record: Record, output: str) -> FilmNumbers:
    """Of a record, each reading at the temperature of its own time."""
    time, degC = record["time_s"], record["temperature_degC"]
    values = fresh(record.output(output))
    if record.has("resistance_time_s"):
        own = record["resistance_time_s"]
        values = at_own_times(time, values, own)
    return replace(film_numbers(time, degC, values, output, record.source), timed=record.times == "file")


def fresh(values: Array) -> Array:
    """Readings without those that a meter slower than the rows repeats: nan there."""
    once = values.copy()
    once[repeated_rows(values)] = np.nan
    return once


def at_own_times(time_s: Array, values: Array, read_s: Array) -> Array:
    """What the values were at the rows' times, by straight lines between the times that they were read at."""
    read = np.where(np.isfinite(read_s), read_s, time_s)
    good = np.isfinite(values)
    if int(np.sum(good)) < 2 or not np.all(np.diff(read[good]) > 0.0):
        return values
    return np.where(good, np.interp(time_s, read[good], values[good]), np.nan)


def plate_course(time_s: Array, temperature_degC: Array, lag_s: float) -> Array:
    """The plate's temperature (degC) behind a thermometer that lags: T + lag dT/dt, on the smoothed course."""
    if lag_s == 0.0:
        return temperature_degC
    path = temperature_path(time_s, temperature_degC).temperature_degC
    course: Array = path + lag_s * np.gradient(path, time_s)
    return course


def believed_degC(run: Rows) -> tuple[Array, list[str]]:
    """Return the temperatures of a run, nan in the rows in which the thermometer is not believed, and a line on each of
    these."""
    names = ("time_s", "temperature_degC", "resistance_ohm", "current_A")
    columns = {name: run.column(name) for name in names}
    false = find_false_readings(columns)
    return mask_readings(columns["temperature_degC"], false), describe_false_readings(false, columns["time_s"])


def numbers_of_run(run: Rows, source: str, lag_s: float) -> FilmNumbers:
    """Of a run's rows; lag_s: of the thermometer behind the plate, which is taken out of the temperatures."""
    time, resistance = run.column("time_s"), run.column("resistance_ohm")
    good = np.isfinite(resistance) & (resistance > 0.0)
    values = fresh(np.where(good, -np.log10(np.where(good, resistance, 1.0)), np.nan))
    values = at_own_times(time, values, run.column("resistance_time_s"))
    plate_degC = plate_course(time, believed_degC(run)[0], lag_s)
    return film_numbers(time, plate_degC, values, "minus_log10_ohm", source, lag_s)
