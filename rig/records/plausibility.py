"""Columns that cannot be what they are taken for: times that go back, kelvins called degC, conductances called ohms.

A unit that somebody typed with --column is believed; one that a name or a habit gave is not, where the numbers say
otherwise. The refusal holds what to type, either way.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from compensator.hysteresis.functions import Array
from rig.core.clock import DAY_S
from rig.records.column_names import typed
from rig.records.table import Table
from rig.records.times import hours_off

FILM_K = (200.0, 500.0)  # a film's record that stays within these is one in K: as degC no Peltier plate reaches them
ROOM_K = (270.0, 320.0)  # a plate's record that begins here and stays below FILM_K's end is one in K
HOT_DEGC = 2000.0  # a record that goes beyond again and again has another column's numbers: no furnace of films does
LEAST_DEGC = -150.0  # a record that stays below was taken for one in K and is not
WHOSE = {"temperature_degC": "a plate's", "sink_degC": "a sink's", "ambient_degC": "a room's"}  # without a film
LEAST_OHM = 0.01  # no film's resistance stays below this: it is a conductance
MOST_S = 1e11  # three thousand years; epochs in ms are 1e12
DAYS = (36526.0, 73050.0)  # of the years 2000 to 2099 as a spreadsheet counts them, from the end of 1899
HALF_AN_HOUR_D = 1.0 / 48.0  # nobody takes a row less often: seconds in that range are further apart
ABSOLUTE_ZERO_DEGC = -273.15  # no temperature is below
MOST_DEGC, MOST_A = 1e6, 1e5  # beyond which not even an outlier is
MOST_OHM = 1e30  # beyond which no ohmmeter reads; overrange is inf


class Chosen(Protocol):
    """What is known of a column that was taken: which it is, its unit, and whether somebody typed that unit."""

    @property
    def index(self) -> int: ...

    @property
    def unit(self) -> str: ...

    @property
    def unit_said(self) -> bool: ...


def faults_in(
    table: Table, values: Mapping[str, Array], chosen: Mapping[str, Chosen], names: Sequence[str]
) -> list[str]:
    """A line for everything that cannot be."""
    time = values["time_s"]
    if time.size < 2:
        return [f"{table.source}: {time.size} rows: expected at least 2"]
    return [
        *_exchanged(table, values),
        *_time_faults(table, time, chosen, names),
        *_resistance_faults(table, values, chosen, names),
        *(line for name in WHOSE for line in _temperature_faults(table, values, chosen, names, name)),
        *_size_faults(table, values),
        *_current_faults(table, values),
    ]


def _told(table: Table, name: str, rows: NDArray[np.intp], column: Array, expected: str) -> list[str]:
    """A line about the first row with a fault, and how many more there are; none where there is none."""
    if not rows.size:
        return []
    first = int(rows[0])
    text = f"{table.source}: {table.at(first)}: {name}: {float(column[first])!r}: {expected}"
    return [text + _more(table, rows)]


def _more(table: Table, rows: NDArray[np.intp]) -> str:
    """How many rows have the fault that is told of the first of them."""
    return f" ({rows.size} such rows, to {table.at(int(rows[-1]))})" if rows.size > 1 else ""


def _exchanged(table: Table, values: Mapping[str, Array]) -> list[str]:
    """A line where another column goes on as times do, and the times do not."""
    with np.errstate(over="ignore", invalid="ignore"):
        if np.all(np.diff(values["time_s"]) > 0.0):
            return []
        others = [name for name in ("temperature_degC", "resistance_ohm", "current_A") if name in values]
        rising = [name for name in others if np.all(np.diff(values[name]) > 0.0)]
    text = "do not increase, and those of {} do in every row: are two columns exchanged?"
    return [f"{table.source}: time_s: its numbers {text.format(rising[0])}"] if rising else []


def _time_faults(table: Table, time: Array, chosen: Mapping[str, Chosen], names: Sequence[str]) -> list[str]:
    faults = _told(table, "time_s", np.flatnonzero(~np.isfinite(time)), time, "expected a finite number")
    with np.errstate(over="ignore", invalid="ignore"):
        back = np.flatnonzero(np.diff(time) <= 0.0) + 1
    if back.size == time.size - 1 > 1:
        return [
            f"{table.source}: time_s: falls in every row; expected increasing times, or --reversed: the last row was "
            "taken first"
        ]
    if back.size and not faults:
        k = int(back[0])
        after = f"{float(time[k])!r} after {float(time[k - 1])!r}"
        same = int(np.sum(np.diff(time) == 0.0))
        if 2 * same > back.size and same > 1:
            text = f"{table.source}: {table.at(k)}: time_s: the same as in the row before"
            expected = "expected a time of its own for each row, or --period SECONDS if they are evenly apart"
            return [f"{text}{_more(table, back)}: {expected}"]
        if hours_off(time, DAY_S / 2.0)[k] > 0.0:
            text = f"{table.source}: {table.at(k)}: time_s: the clock went back by 12 h: of 12 hours, without AM or PM?"
            return [f"{text} expected times of 24 hours, or --period SECONDS if the rows are evenly apart"]
        again = "; it begins anew, as of another sweep: give each as a file of its own" if time[k] <= time[0] else ""
        text = f"{table.source}: {table.at(k)}: time_s: {after}: expected increasing times{again}"
        faults.append(text + _more(table, back))
    if not faults and np.max(np.abs(time)) > MOST_S:
        what = typed("time_s", names, chosen["time_s"].index, "ms") if "time_s" in chosen else ""
        faults.append(
            f"{table.source}: time_s: {float(np.max(np.abs(time)))!r} s is beyond any clock: expected seconds or {what}"
        )
    choice = chosen.get("time_s")
    if not faults and choice is not None and not choice.unit_said and _days_of_a_spreadsheet(time):
        what = f"{typed('time_s', names, choice.index, 'd')} or {_same(names, 'time_s', choice)}"
        text = f"{time[0]:.8g} to {time[-1]:.8g}: a spreadsheet's dates, which count days? expected {what}"
        faults.append(f"{table.source}: time_s: {text}")
    return faults


def _days_of_a_spreadsheet(time: Array) -> bool:
    """Whether times may be dates as spreadsheets write them as numbers: rows of less than half an hour apart."""
    within = DAYS[0] < time[0] and time[-1] < DAYS[1]
    return within and float(np.median(np.diff(time))) < HALF_AN_HOUR_D


def _resistance_faults(
    table: Table, values: Mapping[str, Array], chosen: Mapping[str, Chosen], names: Sequence[str]
) -> list[str]:
    resistance = values.get("resistance_ohm")
    if resistance is None:
        return []
    below = np.flatnonzero(resistance <= 0.0)
    faults = _told(table, "resistance_ohm", below, resistance, "expected > 0")
    finite = resistance[np.isfinite(resistance)]
    choice = chosen.get("resistance_ohm")
    if not faults and finite.size and choice is not None and not choice.unit_said and np.max(finite) < LEAST_OHM:
        other = "ohm" if choice.unit.endswith("S") else "S"
        what = f"{typed('resistance_ohm', names, choice.index, other)} or {_same(names, 'resistance_ohm', choice)}"
        text = f"at most {float(np.max(finite)):.3g} ohm: conductance and resistance mixed up? expected {what}"
        faults.append(f"{table.source}: resistance_ohm: {text}")
    return faults


def _same(names: Sequence[str], ours: str, choice: Chosen) -> str:
    return f"{typed(ours, names, choice.index, choice.unit)} if it is so"


def _temperature_faults(
    table: Table, values: Mapping[str, Array], chosen: Mapping[str, Chosen], names: Sequence[str], ours: str
) -> list[str]:
    """A line for a column of temperatures, by our name, whose numbers are of another unit, or none of a temperature."""
    temperature, choice = values.get(ours), chosen.get(ours)
    finite = temperature[np.isfinite(temperature)] if temperature is not None else np.empty(0)
    if not finite.size:
        return []
    low, high = (float(v) for v in np.percentile(finite, [2.0, 98.0]))
    if high > HOT_DEGC and ours == "temperature_degC":  # of a sensor that is not there others may be told so
        return [f"{table.source}: {ours}: to {float(np.max(finite)):g} degC: are two columns exchanged?"]
    if choice is None or choice.unit_said:
        return []
    read = ours == "temperature_degC" and "resistance_ohm" in values
    film = read and bool(np.any(np.isfinite(values["resistance_ohm"])))
    begins = ROOM_K[0] <= float(finite[0]) <= ROOM_K[1]
    other = ""
    if choice.unit == "degC" and FILM_K[0] < low and high < FILM_K[1] and (film or begins):
        other = "K"
    elif choice.unit == "K" and high < LEAST_DEGC:
        other = "degC"
    if not other:
        return []
    what = f"{typed(ours, names, choice.index, other)} or {_same(names, ours, choice)}"
    shown = f"{low:.1f} to {high:.1f} degC" if other == "K" else f"{low + 273.15:.1f} to {high + 273.15:.1f} K"
    whose = "a film's" if film else WHOSE[ours]
    return [f"{table.source}: {ours}: {shown} is not {whose} temperature, in {other} it is: expected {what}"]


def _size_faults(table: Table, values: Mapping[str, Array]) -> list[str]:
    """Numbers that are none of the quantity, whatever the unit: each would carry a fit away."""
    bounds = {
        "temperature_degC": (ABSOLUTE_ZERO_DEGC, MOST_DEGC),
        "current_A": (-MOST_A, MOST_A),
        "resistance_ohm": (-math.inf, MOST_OHM),
    }
    faults = []
    for name, (low, high) in bounds.items():
        column = values.get(name)
        if column is None:
            continue
        below = column <= low
        if name == "temperature_degC" and 2 * np.sum(below) <= column.size:  # of a thermometer that was unplugged
            below[:] = False
        beyond = np.flatnonzero(np.isfinite(column) & (below | (column > high)))
        bounds_told = f"at most {high:g}, or inf" if low == -math.inf else f"{low:g} to {high:g}, or an empty field"
        expected = f"expected {bounds_told} for no reading"
        faults += _told(table, name, beyond, column, expected)
    return faults


def _current_faults(table: Table, values: Mapping[str, Array]) -> list[str]:
    """A line where the current stands only in the rows in which it changes: between them it would be unknown, and no
    three rows are left of which a plate could be found."""
    known = np.isfinite(values["current_A"]) if "current_A" in values else np.empty(0, dtype=np.bool_)
    if not known.any() or bool(np.any(known[2:] & known[1:-1] & known[:-2])):
        return []
    text = f"stands in {np.count_nonzero(known)} of {known.size} rows, nowhere in three one after the other"
    expected = "expected in each: fill it down where only changes are written"
    return [f"{table.source}: current_A: {text}; {expected}"] if known.size > 2 else []
