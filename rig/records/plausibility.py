"""Columns whose numbers contradict their meaning: times that go back, kelvins under degC, conductances under ohms.

A unit that the user typed with --column is believed; one that a name or a habit gave is not, if the numbers say
otherwise. The fault holds the options to type, for either case.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compensator.hysteresis.functions import Array
from rig.core.clock import DAY_S
from rig.records.column_choice import Choice
from rig.records.column_names import column_option
from rig.records.table import Table
from rig.records.times import clock_changes

FILM_K = (200.0, 500.0)  # a film's record within these is in K: no Peltier plate reaches them in degC
ROOM_K = (270.0, 320.0)  # a plate's record that begins here and stays below FILM_K's end is in K
HOT_DEGC = 2000.0  # 2 % of the readings above: another column's numbers, no furnace of films is as hot
LEAST_DEGC = -150.0  # all readings below: degC that were converted from K
OWNERS = {"temperature_degC": "a plate's", "sink_degC": "a sink's", "ambient_degC": "a room's"}  # without a film
LEAST_OHM = 0.01  # all readings below: a conductance
MOST_S = 1e11  # three thousand years; epochs in ms are 1e12
SPREADSHEET_DAYS = (36526.0, 73050.0)  # 2000 to 2099, counted from the end of 1899
HALF_AN_HOUR_D = 1.0 / 48.0  # rows are taken more often: seconds in the range of the days are further apart
ABSOLUTE_ZERO_DEGC = -273.15
MOST_DEGC, MOST_A, MOST_OHM = 1e6, 1e5, 1e30  # beyond these not even outliers are; overrange is inf


def find_implausible_values(
    table: Table, values: Mapping[str, Array], chosen: Mapping[str, Choice], names: Sequence[str]
) -> list[str]:
    """Return a line for each column that cannot be what it was taken for.

    Parameters
    ----------
    values : our columns in our units, each of shape (rows,)
    chosen : the file's column and unit of each
    names : of all columns of the file
    """
    if values["time_s"].size < 2:
        return [f"{table.source}: {values['time_s'].size} rows: expected at least 2"]
    check = _Check(table, values, chosen, names)
    with np.errstate(over="ignore", invalid="ignore"):
        return [
            *check.times(),
            *check.resistance(),
            *(line for name in OWNERS for line in check.temperature(name)),
            *check.sizes(),
            *check.current(),
        ]


@dataclass(frozen=True, eq=False)
class _Check:
    """The columns to check; each method returns lines for the user."""

    table: Table
    values: Mapping[str, Array]
    chosen: Mapping[str, Choice]
    names: Sequence[str]

    def _line(self, text: str, row: int | None = None, rows: NDArray[np.intp] | None = None) -> str:
        """Return a line about the file or a row of it; rows: all that have the fault."""
        place = "" if row is None else f"{self.table.place_of(row)}: "
        more = ""
        if rows is not None and rows.size > 1:
            more = f" ({rows.size} such rows, to {self.table.place_of(int(rows[-1]))})"
        return f"{self.table.source}: {place}{text}{more}"

    def _wrong(self, name: str, rows: NDArray[np.intp], expected: str) -> list[str]:
        """Return a line about the first of some rows, if there are any."""
        if not rows.size:
            return []
        row = int(rows[0])
        return [self._line(f"{name}: {float(self.values[name][row])!r}: {expected}", row, rows)]

    def _either(self, name: str, unit: str) -> str:
        """Return the options for another unit and for the one that was taken."""
        choice = self.chosen[name]
        first, second = (column_option(name, self.names, choice.index, each) for each in (unit, choice.unit))
        return f"expected {first} or {second} if it is so"

    def _unit_guessed(self, name: str) -> str:
        """Return the unit that a column was taken in if the user did not type it, else ''."""
        choice = self.chosen.get(name)
        return choice.unit if choice is not None and not choice.unit_typed else ""

    def times(self) -> list[str]:
        """Check that times are finite and increase, and are no dates as numbers."""
        time = self.values["time_s"]
        faults = self._wrong("time_s", np.flatnonzero(~np.isfinite(time)), "expected a finite number")
        if faults:
            return faults
        steps = np.diff(time)
        back = np.flatnonzero(steps <= 0.0) + 1
        if back.size:
            return [*self._swapped(), self._do_not_increase(time, steps, back)]
        if np.max(np.abs(time)) > MOST_S:
            index = self.chosen["time_s"].index if "time_s" in self.chosen else None
            option = column_option("time_s", self.names, index, "ms") if index is not None else ""
            text = f"time_s: {float(np.max(np.abs(time)))!r} s is beyond any clock"
            return [self._line(f"{text}: expected seconds or {option}")]
        days = SPREADSHEET_DAYS[0] < time[0] and time[-1] < SPREADSHEET_DAYS[1]
        if self._unit_guessed("time_s") and days and float(np.median(steps)) < HALF_AN_HOUR_D:
            text = f"time_s: {time[0]:.8g} to {time[-1]:.8g}: a spreadsheet's dates, which count days?"
            return [self._line(f"{text} {self._either('time_s', 'd')}")]
        return []

    def _swapped(self) -> list[str]:
        """Return a line if another column increases in every row, as times do."""
        others = [name for name in ("temperature_degC", "resistance_ohm", "current_A") if name in self.values]
        rising = [name for name in others if np.all(np.diff(self.values[name]) > 0.0)]
        text = "time_s: its numbers do not increase, and those of {} do in every row: are two columns swapped?"
        return [self._line(text.format(name)) for name in rising[:1]]

    def _do_not_increase(self, time: Array, steps: Array, back: NDArray[np.intp]) -> str:
        """Return the line for times that do not increase in the rows `back`."""
        k, same = int(back[0]), int(np.sum(steps == 0.0))
        if back.size == time.size - 1 > 1:
            expected = "expected increasing times, or --reversed: the last row was taken first"
            return self._line(f"time_s: falls in every row; {expected}")
        if 2 * same > back.size and same > 1:
            expected = "expected a time of its own for each row, or --period SECONDS if they are evenly spaced"
            return f"{self._line('time_s: the same as in the row before', k, back)}: {expected}"
        if clock_changes(time, DAY_S / 2.0)[k] > 0.0:
            text = "time_s: the clock went back by 12 h: of 12 hours, without AM or PM?"
            expected = "expected times of 24 hours, or --period SECONDS if the rows are evenly spaced"
            return self._line(f"{text} {expected}", k)
        anew = "; it starts again, as in another sweep: give each sweep a file of its own"
        text = f"time_s: {float(time[k])!r} after {float(time[k - 1])!r}: expected increasing times"
        return self._line(text + anew * int(time[k] <= time[0]), k, back)

    def resistance(self) -> list[str]:
        """Check that resistances are positive, and no conductances."""
        resistance = self.values.get("resistance_ohm")
        if resistance is None:
            return []
        faults = self._wrong("resistance_ohm", np.flatnonzero(resistance <= 0.0), "expected > 0")
        finite, unit = resistance[np.isfinite(resistance)], self._unit_guessed("resistance_ohm")
        if not faults and finite.size and unit and np.max(finite) < LEAST_OHM:
            text = f"at most {float(np.max(finite)):.3g} ohm: conductance and resistance mixed up?"
            either = self._either("resistance_ohm", "ohm" if unit.endswith("S") else "S")
            faults.append(self._line(f"resistance_ohm: {text} {either}"))
        return faults

    def temperature(self, name: str) -> list[str]:
        """Check that a column of temperatures is in its unit, and no other quantity."""
        temperature, unit = self.values.get(name), self._unit_guessed(name)
        finite = temperature[np.isfinite(temperature)] if temperature is not None else np.empty(0)
        if not finite.size:
            return []
        low, high = (float(v) for v in np.percentile(finite, [2.0, 98.0]))
        if high > HOT_DEGC and name == "temperature_degC":  # sinks and rooms may have sensors that are not there
            return [self._line(f"{name}: to {float(np.max(finite)):g} degC: are two columns swapped?")]
        film = name == "temperature_degC" and bool(np.any(np.isfinite(self.values.get("resistance_ohm", np.empty(0)))))
        kelvin = FILM_K[0] < low and high < FILM_K[1] and (film or ROOM_K[0] <= float(finite[0]) <= ROOM_K[1])
        if unit == "degC" and kelvin:
            other, shown = "K", f"{low:.1f} to {high:.1f} degC"
        elif unit == "K" and high < LEAST_DEGC:
            other, shown = "degC", f"{low + 273.15:.1f} to {high + 273.15:.1f} K"
        else:
            return []
        owner = "a film's" if film else OWNERS[name]
        text = f"{name}: {shown} is not {owner} temperature, in {other} it is: {self._either(name, other)}"
        return [self._line(text)]

    def sizes(self) -> list[str]:
        """Check for numbers that are none of the quantity in any unit: one of them would spoil a fit."""
        bounds = {
            "temperature_degC": (ABSOLUTE_ZERO_DEGC, MOST_DEGC),
            "current_A": (-MOST_A, MOST_A),
            "resistance_ohm": (-math.inf, MOST_OHM),
        }
        faults = []
        for name, (low, high) in bounds.items():
            column = self.values.get(name)
            if column is None:
                continue
            below = column <= low
            if name == "temperature_degC" and 2 * np.sum(below) <= column.size:  # the thermometer was unplugged
                below[:] = False
            beyond = np.flatnonzero(np.isfinite(column) & (below | (column > high)))
            allowed = f"at most {high:g}, or inf" if low == -math.inf else f"{low:g} to {high:g}, or an empty field"
            faults += self._wrong(name, beyond, f"expected {allowed} for no reading")
        return faults

    def current(self) -> list[str]:
        """Check for a current that stands only where it changes: it would be unknown in all other rows."""
        known = np.isfinite(self.values["current_A"]) if "current_A" in self.values else np.empty(0, dtype=np.bool_)
        if known.size <= 2 or not known.any() or bool(np.any(known[2:] & known[1:-1] & known[:-2])):
            return []
        text = f"stands in {np.count_nonzero(known)} of {known.size} rows, nowhere in three one after the other"
        return [self._line(f"current_A: {text}; expected in each: fill it down where only changes are written")]
