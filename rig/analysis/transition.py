"""The transition of a fitted film and the first-order reversal curves of its record: numbers, lines, JSON."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from compensator.hysteresis.functions import Array
from rig.analysis.error import Rows, value_and_half
from rig.records.film_output import in_decades, sign_of, unit_of
from rig.records.record import Record
from rig.records.thermometer_faults import describe_false_readings, find_false_readings, mask_readings
from sim.inference.film.fit import FilmFit, identify_film
from sim.inference.readings.odd_readings import repeated_rows
from sim.inference.readings.temperature_path import temperature_path
from sim.inference.transition.forc import Forc, forc
from sim.inference.transition.transition import Quantity, Transition, transition, untold

FAR_OFF = 5.0  # times the noise: beyond it a column may not be what it is taken for
NO_JUMPS = 0.98  # of the changes from reading to reading
FEWEST = 20  # readings from which their noise can be estimated
LEAST = 1e-3  # of the output: of readings without noise no model is asked to be closer
EVERY = 4  # places of a derivative, in a report
MOST_READINGS = 50_000  # of reversal curves: beyond it every so many rows are taken: no ramp has more to say
WORDS = {
    "heating_degC": ("transition temperature on heating", "degC"),
    "cooling_degC": ("transition temperature on cooling", "degC"),
    "hysteresis_K": ("hysteresis, heating - cooling", "K"),
    "width_heating_K": ("width on heating, FWHM", "K"),
    "width_cooling_K": ("width on cooling, FWHM", "K"),
    "midpoint_heating_degC": ("midpoint on heating", "degC"),
    "midpoint_cooling_degC": ("midpoint on cooling", "degC"),
    "hysteresis_at_midpoint_K": ("hysteresis at the midpoints", "K"),
    "change_dec": ("fall of log10 R, cold to hot", "decades"),
    "change": ("change of the output, cold to hot", ""),
    "activation_energy_eV": ("activation energy, insulating side", "eV"),
}


@dataclass(frozen=True, eq=False)
class FilmNumbers:
    """The transition and the reversal curves of one record.

    output: its name; lag_s: the thermometer's lag behind the plate that was taken out of the temperatures, None if it
    is not known; timed: True if the record has times, else no rates are reported; doubt: why none of the numbers is
    determined, "" if they are.
    """

    source: str
    output: str
    transition: Transition
    forc: Forc
    lag_s: float | None = None
    timed: bool = True
    doubt: str = ""

    @property
    def unit(self) -> str:
        return unit_of(self.output)

    def rows(self) -> list[tuple[str, str]]:
        """Return (quantity, value with its interval) for a table."""
        found = self.transition
        named = {name: WORDS[name] for name in WORDS if name in found.quantities}
        if not found.in_decades:
            named.pop("activation_energy_eV", None)
        return [(what, _number(found.quantities[name], of or self.unit)) for name, (what, of) in named.items()]

    def lines(self, whole: bool = True) -> list[str]:
        """Return the lines for the terminal; whole: more than the transition temperatures. They mention reversal curves
        only if there is a diagram: a record that was not made for one has too few, and the JSON says so."""
        of_curves = [] if self.forc.reason else [self.forc_note()]
        if self.doubt:
            return [f"transition: not determined, because {self.doubt}", *of_curves]
        if not whole:
            return ["; ".join(f"{what} {value}" for what, value in self.rows()[:2])]
        numbers = [f"  {what:<36}{value}" for what, value in self.rows()]
        return ["transition, with 95 % intervals:", *numbers, *(f"  {note}" for note in [*self.of_ramps(), *of_curves])]

    def definition(self) -> str:
        """Return how the numbers are defined, with the windows that they were fitted over; "" if there are none."""
        found = self.transition
        if not found.shapes:
            return ""
        what = "log10 R" if found.in_decades else "output"
        windows = " and ".join(f"{2.0 * shape.window_K:.1f} K ({sense})" for sense, shape in found.shapes.items())
        text = f"transition temperature: where |d {what} / dT| of the major branch is largest, fitted over windows of "
        text += windows
        low, high = found.range_degC
        return f"{text}; midpoint: where {what} is halfway between its values at {low:.1f} and {high:.1f} degC"

    def notes(self) -> list[str]:
        """Return the lines on how the numbers were obtained: definition, fitted range, ramps; or why there are none."""
        if self.doubt:
            return [f"Not determined, because {self.doubt}"]
        found = self.transition
        notes = [self.definition()] if found.shapes else []
        if (between := self._activation_range()) is not None:
            notes.append(f"activation energy: of ln R over 1/(kT) between {between[0]:.1f} and {between[1]:.1f} degC")
        return notes + self.of_ramps()

    def of_ramps(self) -> list[str]:
        """Return the line on what a lag does to the hysteresis at these ramps; none without rates."""
        found = self.transition
        if not (self.timed and (rates := found.rates_K_per_s())):
            return []
        ramps = ", ".join(dict.fromkeys(f"{rate:.2g} K/s" for rate in rates.values()))
        text = f"not in the intervals: at these ramps ({ramps}) each second by which the thermometer lags makes the "
        text += f"hysteresis {found.shift_K(1.0):.2g} K too small, by which the film lags as much too large"
        if self.lag_s is not None and self.lag_s > 0.0:
            text += f"; the thermometer's of {self.lag_s:.2g} s ({found.shift_K(self.lag_s):.2g} K) is corrected"
        return [text]

    def forc_note(self) -> str:
        """Return a line on the diagram of the reversal curves, or on why there is none."""
        curves = self.forc
        if curves.reason:
            return f"Diagram of the first-order reversal curves (FORC): not drawn: {curves.reason}"
        peak = curves.peak()
        text = f"FORC diagram: of {curves.reversal_degC.size} curves of {curves.sense}"
        if peak is None:
            return text + ", too far apart for any window"
        return f"{text}; largest at T_r {peak[0]:.1f} degC, T {peak[1]:.1f} degC"

    def document(self) -> dict[str, Any]:
        """Return the record's entry under "transition" in the JSON."""
        found, curves, lag_s, peak = self.transition, self.forc, self.lag_s, self.forc.peak()
        return {
            "record": self.source,
            **{name: quantity.table() for name, quantity in found.quantities.items()},
            "definition": self.definition(),
            "window_K": {sense: 2.0 * shape.window_K for sense, shape in found.shapes.items()},
            "rate_K_per_s": found.rates_K_per_s() if self.timed else None,
            "sensor_lag": None if lag_s is None else _lag_document(lag_s, found.shift_K(lag_s), taken_out=True),
            "range_degC": list(found.range_degC) if found.shapes else None,
            "activation_range_degC": self._activation_range(),
            "forc": {
                "curves": int(curves.reversal_degC.size),
                "sense": curves.sense,
                "reason": curves.reason or None,
                "window_K": list(curves.window_K) if not curves.reason else None,
                "peak": peak and dict(zip(("reversal_degC", "degC", "density_per_K2"), peak, strict=True)),
            },
        }

    def shown(self) -> dict[str, Any]:
        """Return what a page shows: rows of the table, notes, and the derivative of each branch."""
        found = self.transition
        return {
            "rows": [] if self.doubt else [list(row) for row in self.rows()],
            "notes": self.notes(),
            "derivative": {
                sense: {
                    "degC": degC[::EVERY].tolist(),
                    "slope": slope[::EVERY].tolist(),
                    "half_width": half[::EVERY].tolist(),
                    "steepest_degC": found.quantities[f"{sense}_degC"].value,
                }
                for sense, (degC, slope, half) in ({} if self.doubt else found.derivatives()).items()
            },
            "ylabel": "d log10 R / dT / (1/K)" if found.in_decades else f"d output / dT / ({self.unit}/K)",
            "forc": self.forc_note(),
        }

    def lag_left_in(self, lag_s: float) -> tuple[str, dict[str, Any]] | None:
        """Return a line and its JSON on a lag of the thermometer (s) that is still in the temperatures; None if it
        shifts nothing."""
        shift_K = self.transition.shift_K(lag_s)
        if not (lag_s > 0.0 and shift_K > 0.0 and self.timed):
            return None
        text = f"the thermometer lags behind the plate by {lag_s:.2g} s, as the current shows: at these ramps the loop "
        text += f"looks {shift_K:.2g} K narrower than it is; the numbers are not corrected for this"
        return f"{self.source}: {text}", _lag_document(lag_s, shift_K, taken_out=False)

    def _activation_range(self) -> list[float] | None:
        fit = self.transition.activation
        return [fit.low_degC, fit.high_degC] if fit is not None and fit.energy_eV.value is not None else None


def _lag_document(lag_s: float, shift_K: float, taken_out: bool) -> dict[str, Any]:
    return {"tau_s": lag_s, "shift_K": shift_K, "taken_out": taken_out}


def _number(quantity: Quantity, unit: str) -> str:
    """Return a value and half of its interval, both to the interval's second digit."""
    if quantity.value is None or quantity.ci95 is None:
        return f"not determined: {quantity.reason}"
    half = 0.5 * (quantity.ci95[1] - quantity.ci95[0])
    value, half_width = value_and_half(quantity.value, half)
    return f"{value} +- {half_width} {unit}".rstrip()


def film_numbers(
    time_s: Array,
    degC: Array,
    output: Array,
    name: str,
    source: str,
    lag_s: float | None = None,
    fit: FilmFit | None = None,
    number: int = 0,
) -> FilmNumbers:
    """Return the numbers from arrays of shape (rows,): s, degC, and the output `name`, nan if there is no reading.

    fit: of a film to these rows as the record of this number; None: it is fitted here. Raises ValueError if no film can
    be fitted.
    """
    fit = fit if fit is not None else identify_film(time_s, degC, output, output_name=name)
    decades = in_decades(name)
    sign = float(-sign_of(name) if decades else sign_of(name))  # -log10 R, or the column as the record has it
    found = transition(fit, time_s, degC, output, number=number, sign=sign, in_decades=decades)
    thin = slice(None, None, -(-time_s.size // MOST_READINGS))
    curves = forc(time_s[thin], degC[thin], sign * output[thin], in_decades=decades)
    return FilmNumbers(source, name, found, curves, lag_s)


def numbers_of_record(record: Record, output: str, fit: FilmFit | None = None, number: int = 0) -> FilmNumbers:
    """Return the numbers of a record, each reading at the temperature of its own time. fit, number: as for
    `film_numbers`."""
    time, degC = record["time_s"], record["temperature_degC"]
    values = fresh(record.output(output))
    if record.has("resistance_time_s"):
        values = at_own_times(time, values, record["resistance_time_s"])
    found = film_numbers(time, degC, values, output, record.source, None, fit, number)
    return replace(found, timed=record.times == "file")


def doubted(numbers: FilmNumbers, modelled: Array, measured: Array) -> FilmNumbers:
    """Return the numbers without values if the film model of the record is off by more than `FAR_OFF` times the noise.

    modelled, measured: the output, shape (rows,), nan if there is none.
    """
    times = times_the_noise(modelled - measured, float(np.ptp(measured[np.isfinite(measured)])))
    if times <= FAR_OFF:
        return numbers
    why = f"the film model misses this record by {times:.0f} times the noise"
    found, named = numbers.transition, dict(numbers.rows())
    quantities = {
        name: quantity if quantity.value is None else untold(f"{why} (apparent value {named[WORDS[name][0]]})")
        for name, quantity in found.quantities.items()
    }
    return replace(numbers, transition=replace(found, quantities=quantities), doubt=why)


def times_the_noise(residual: Array, span: float) -> float:
    """Return how many times the noise a fit is off (RMS). The noise is estimated from the changes from reading to
    reading, without the largest ones. span: of the output."""
    finite = residual[np.isfinite(residual)]
    if finite.size < FEWEST:
        return 0.0
    changes = np.sort(np.diff(finite, 2) ** 2)[: math.ceil(NO_JUMPS * (finite.size - 2))]
    noise = math.sqrt(float(np.mean(changes)) / 6.0)
    return float(np.sqrt(np.mean(finite**2))) / max(noise, LEAST * span)


def fresh(values: Array) -> Array:
    """Return the readings with nan in place of those that a meter slower than the rows repeats."""
    once = values.copy()
    once[repeated_rows(values)] = np.nan
    return once


def at_own_times(time_s: Array, values: Array, read_s: Array) -> Array:
    """Return the values interpolated to the rows' times, from the times at which they were read."""
    read = np.where(np.isfinite(read_s), read_s, time_s)
    good = np.isfinite(values)
    if int(np.sum(good)) < 2 or not np.all(np.diff(read[good]) > 0.0):
        return values
    return np.where(good, np.interp(time_s, read[good], values[good]), np.nan)


def plate_course(time_s: Array, temperature_degC: Array, lag_s: float) -> Array:
    """Return the plate's temperature (degC) behind a thermometer that lags: T + lag dT/dt, on the smoothed course."""
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
