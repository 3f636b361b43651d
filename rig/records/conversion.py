"""The record in a table: columns chosen, converted to our units, put in the order of time, and checked.

The user's --column options come first, then our own names, then clear names (`rig.records.column_names`). A note says
which column was taken for which. A file whose columns are not clear, or whose numbers contradict their meaning, is
refused, with the options to type. A unit that the user typed is believed; one that a name gave is not, if the numbers
say otherwise.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compensator.hysteresis.functions import Array
from rig.core.clock import DAY_S
from rig.core.faults import Faults, fault, in_python
from rig.records.branches import RowOrder, join_loop, reverse_second_branch, split_branches
from rig.records.column_choice import Choice, ColumnChoice
from rig.records.column_names import ColumnMapping, column_option, unit_ending
from rig.records.numbers import CONDUCTANCES, DECIMALS, DRIVE_SHARES, LOGARITHMS, UNITS, BadField, find_overload
from rig.records.record import Record, without_false_readings
from rig.records.table import Column, Table, pivot_readings, table_from_arrays
from rig.records.times import SECOND_FRACTIONS, SUMMER_TIME, clock_changes, is_clock_time, is_date, is_time, read_times

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


@dataclass(frozen=True, eq=False)
class _Check:
    """Check for columns that cannot be what they were taken for; each method returns lines for the user.

    values: our columns in our units, each of shape (rows,); chosen: the file's column and unit of each; names: of all
    columns of the file.
    """

    table: Table
    values: Mapping[str, Array]
    chosen: Mapping[str, Choice]
    names: Sequence[str]

    def all(self) -> list[str]:
        if self.values["time_s"].size < 2:
            return [f"{self.table.source}: {self.values['time_s'].size} rows: expected at least 2"]
        with np.errstate(over="ignore", invalid="ignore"):
            temperatures = [line for name in OWNERS for line in self.temperature(name)]
            return [*self.times(), *self.resistance(), *temperatures, *self.sizes(), *self.current()]

    def _line(self, text: str, row: int | None = None, rows: NDArray[np.intp] | None = None) -> str:
        """Return a line about the file or a row of it; rows: all that have the fault."""
        several = rows is not None and rows.size > 1
        more = f" ({rows.size} such rows, to {self.table.place_of(int(rows[-1]))})" if several else ""  # type: ignore
        return f"{self.table.source}: {'' if row is None else f'{self.table.place_of(row)}: '}{text}{more}"

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
            others = [name for name in ("temperature_degC", "resistance_ohm", "current_A") if name in self.values]
            rising = [name for name in others if np.all(np.diff(self.values[name]) > 0.0)]
            text = "time_s: its numbers do not increase, and those of {} do in every row: are two columns swapped?"
            swapped = [self._line(text.format(name)) for name in rising[:1]]
            return [*swapped, self._do_not_increase(time, steps, back)]
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


FEW_ROWS = 20  # in more, some may follow a clock that was set back
MOST_STEPS_BACK = 0.01  # of the rows
LARGEST_STEP_BACK_S = 1.0  # more than the network sets a computer's clock back by


@in_python()
def record_from_arrays(
    columns: Mapping[str, Any],
    column: Iterable[str] = (),
    needs: Iterable[str] = (),
    source: str = "arrays",
    order: RowOrder | None = None,
) -> Record:
    """Return a record of arrays by name, each of shape (rows,); the names are read as those of a file. Raises Faults.

    column: options for names that are not clear, such as 'resistance_ohm=R@kohm'; needs: columns that have to be there,
    besides time_s; source: the record's name in messages.
    """
    mappings = [ColumnMapping.parse(text) for text in column]
    return record_from_table(table_from_arrays(columns, source), mappings, needs, order=order)


def record_from_table(
    table: Table,
    mappings: Iterable[ColumnMapping] = (),
    needs: Iterable[str] = (),
    options: bool = True,
    order: RowOrder | None = None,
) -> Record:
    """Return the record in a table. Raises Faults, a line for each.

    options: the user can type --column, so that faults may say what to type.
    """
    mappings, needs, order = list(mappings), list(needs), order or RowOrder()
    if order.reversed:
        table = table.select(range(len(table.line_of))[::-1])
    parts = _parts(table, mappings, order)
    records: list[Record] = []
    faults: dict[str, None] = {}
    for part in parts.values():
        try:
            records.append(_record_of_part(*_with_typed_times(part, mappings, order), needs, options))
        except Faults as found:
            faults |= dict.fromkeys(found.lines)
    if faults:
        raise Faults(faults)
    return join_loop(records, list(parts)) if len(records) > 1 else reverse_second_branch(records[0], order)


def _parts(table: Table, mappings: Sequence[ColumnMapping], order: RowOrder) -> dict[str, Table]:
    """Return tables with a row for each moment and a column for each quantity: one for each branch, by its sense, or
    {"": table}. The table stays as it is if the user typed names that it would lose, or numbers of its columns."""
    parts = split_branches(pivot_readings(table), order.branches)
    names = [column.name for column in table.columns]
    for mapping in mappings:
        found = [mapping.find([column.name for column in part.columns]) for part in parts.values()]
        by_number = len(parts) > 1 and mapping.theirs.strip().startswith("#")
        if mapping.find(names) is not None and (None in found or by_number):
            return {"": table}
    return parts


def _record_of_part(table: Table, mappings: Sequence[ColumnMapping], needs: Sequence[str], options: bool) -> Record:
    choice = ColumnChoice(table, options)
    choice.choose_typed(mappings)
    choice.choose_own()
    if not choice.faults:
        choice.choose_clear()
        choice.ask(["time_s", *(name for name in needs if name != "time_s")])
    if choice.faults:
        raise Faults(choice.faults)
    return _convert(choice)


def _with_typed_times(
    table: Table, mappings: list[ColumnMapping], order: RowOrder
) -> tuple[Table, list[ColumnMapping]]:
    """Return the table with times by the rows' order, if `time_s=row` or a period was typed, and other mappings."""
    others = [each for each in mappings if not each.is_row_number]
    if order.period_s is None and len(others) == len(mappings):
        return table, mappings
    step, times = (1.0, "rows") if order.period_s is None else (order.period_s, "period")
    left = [column for column in table.columns if column.name.strip() not in ("time_s", "resistance_time_s")]
    timed = [each for each in table.columns if each.meaning.ours == "time_s" and table.times == "file"]
    timed = [each for each in timed if np.any(each.filled())]
    for each in timed:
        with suppress(ValueError):
            if each.name.strip() == "time_s" and np.all(np.diff(each.numbers(table.decimal).values) > 0.0):
                text = "a period or time_s=row was typed, and the file has time_s; expected one of them"
                raise fault(table.source, table.place, text)
    time = Column("time_s", step * np.arange(len(table.line_of), dtype=np.float64))
    notes = [*table.notes, "no times: rows taken in their order; no rates are reported"]
    if timed:
        names = ", ".join(repr(each.name) for each in timed)
        notes.append(f"{names} left out: the times are those of --period or time_s=row")
    return replace(table, columns=[*left, time], notes=notes, times=times), others


def _convert(choice: ColumnChoice) -> Record:
    """Return the record with every column in our units. Raises Faults."""
    values: dict[str, Array] = {}
    texts: dict[str, list[str]] = {}
    faults: list[str] = []
    for k, name in _columns_in_order(choice):
        chosen = choice.chosen.get(name)
        ours = chosen is not None and chosen.index == k
        try:
            values[name] = _convert_column(choice, name, chosen) if ours and chosen else choice.numbers(k).values
        except BadField as bad:
            if ours:
                expected = bad.expected
                if not choice.options:  # of a target: nobody can type --decimal
                    expected = expected.replace(DECIMALS, "expected decimals with a point")
                faults.append(_line(choice.table, bad.row, f"{name}: {bad.text[:40]!r}: {expected}"))
            texts[name] = list(choice.table.columns[k].texts or [])
        except Faults as found:
            faults += found.lines
    if faults:
        raise Faults(faults)
    table, kept = choice.table, _in_time(choice, values["time_s"])
    if kept.size < values["time_s"].size:
        table = table.select(kept)
        values = {name: column[kept] for name, column in values.items()}
        texts = {name: [column[k] for k in kept] for name, column in texts.items()}
    faults = _Check(table, values, choice.chosen, choice.names).all()
    if faults:
        raise Faults(faults)
    current = choice.chosen.get("current_A")
    drive = current.unit if current is not None and current.unit in DRIVE_SHARES else None
    return without_false_readings(Record(values, table.source, drive, texts, _notes(choice), times=table.times))


def _line(table: Table, row: int, text: str) -> str:
    return f"{table.source}: {table.place_of(row)}: {text}"


def _columns_in_order(choice: ColumnChoice) -> list[tuple[int, str]]:
    """Return index and name of each column of the record: chosen ones, and others under the file's name, each once."""
    found = [(chosen.index, ours) for ours, chosen in choice.chosen.items()]
    used = set(choice.chosen)
    for k in choice.free() + sorted(choice.renamed):
        name = choice.renamed.get(k, choice.names[k].strip()) or f"#{k + 1}"
        name = f"{name} #{k + 1}" if name in used else name
        used.add(name)
        found.append((k, name))
    return sorted(found, key=lambda each: each[0])


def _in_time(choice: ColumnChoice, time: Array) -> NDArray[np.intp]:
    """Return the rows without the few that have no place in time: repeated word for word, or written while a clock that
    was set back by less than a second caught up. Raises Faults if a clock of dates went back by an hour, once."""
    table, kept = choice.table, np.arange(time.size)
    if np.all(np.diff(time) > 0.0) or not np.all(np.isfinite(time)):
        return kept
    chosen = choice.chosen["time_s"]
    hour = np.flatnonzero(clock_changes(time) > 0.0)
    if hour.size == 1 and is_time(choice.firsts[chosen.index]):
        layout = f"{chosen.layout}+{SUMMER_TIME}" if chosen.layout else SUMMER_TIME
        option = column_option("time_s", choice.names, chosen.index, layout)
        text = f"time_s: the clock went back by 1 h (end of summer time?); expected {option}"
        raise Faults([_line(table, int(hour[0]), text)])
    seen: dict[tuple[object, ...], int] = {}
    fields = zip(*(column.fields for column in table.columns), strict=True)
    first = np.array([seen.setdefault(row, k) for k, row in enumerate(fields)], dtype=np.intp)
    repeated = np.flatnonzero(first < np.arange(time.size))
    if repeated.size:
        text = f"{_rows_text(table, repeated)} left out, the same word for word as"
        choice.notes.append(f"{text} {table.place_of(int(first[repeated[0]]))}")
    kept = np.delete(kept, repeated)
    steps = np.diff(time[kept])
    back = steps[steps <= 0.0]
    few = kept.size > FEW_ROWS and back.size <= max(1.0, MOST_STEPS_BACK * kept.size)
    if back.size and few and np.min(back) > -LARGEST_STEP_BACK_S:
        behind = time[kept] <= np.concatenate([[-np.inf], np.maximum.accumulate(time[kept])[:-1]])
        by_s = float(np.median(steps)) - np.min(back)
        how = f"went back by {by_s:.3g} s" if np.min(back) < 0.0 else "stood still"
        choice.notes.append(f"{_rows_text(table, kept[behind])} left out: the clock {how}")
        kept = kept[~behind]
    return kept


def _rows_text(table: Table, rows: NDArray[np.intp]) -> str:
    return table.place_of(int(rows[0])) + (f" and {rows.size - 1} more" if rows.size > 1 else "")


def _convert_column(choice: ColumnChoice, ours: str, chosen: Choice) -> Array:
    """Return one of our columns in its unit. Raises BadField, or Faults for times that were typed as numbers."""
    k, ending = chosen.index, unit_ending(ours)
    first, of_time = f"{ours}: {choice.firsts[k][:40]!r}", ours == "time_s" and is_time(choice.firsts[k])
    if of_time and chosen.how == "typed" and chosen.unit_typed and chosen.layout is None:
        text = f"{first} is a date or a clock's time, and was typed as a number in {chosen.unit}"
        raise Faults([_line(choice.table, 0, f"{text}; expected {column_option(ours, choice.names, k)}")])
    if chosen.layout is not None and not of_time:
        text = f"{first} was typed as a date or a clock's time ({chosen.layout}); expected one, or a unit such as @s"
        raise Faults([_line(choice.table, 0, text)])
    if of_time:
        return _convert_times(choice, chosen)
    numbers = choice.numbers(k, ending)
    choice.notes += [f"in {ours} {text}" for text in numbers.notes]
    values = numbers.values
    if ours == "time_s" and (whole := _add_fractions(choice, values, [k])) is not None:
        values, name = whole
        choice.notes.append(f"time_s with {name!r}")
    infinite = np.isinf(values)
    if numbers.ending is None and chosen.unit != ending:
        values = np.asarray(UNITS[ending][chosen.unit](values), dtype=np.float64)
    if ending in ("degC", "A") and np.any(infinite):  # only of a resistance does an overload mean something
        choice.notes.append(f"in {ours} values beyond the range read as no reading ({int(np.sum(infinite))} rows)")
        return np.where(infinite, np.nan, values)
    return _with_overload(choice, values, chosen.unit) if ours == "resistance_ohm" else values


def _with_overload(choice: ColumnChoice, ohm: Array, unit: str) -> Array:
    """Return resistances with inf where the meter wrote that they are beyond its range, in whatever way."""
    found = {"-inf": np.isneginf(ohm) & (unit not in LOGARITHMS)}
    if unit not in CONDUCTANCES and np.any(overload := find_overload(ohm)):
        found[f"{float(np.max(ohm[overload])):g} ohm, far above all else,"] = overload
    for written, rows in found.items():
        if np.any(rows):
            choice.notes.append(f"in resistance_ohm {written} read as beyond the range ({int(np.sum(rows))} rows)")
            ohm = np.where(rows, np.inf, ohm)
    return ohm


def _convert_times(choice: ColumnChoice, chosen: Choice) -> Array:
    """Return dates and clock times as seconds; a column of dates goes with one of clock times, and of milliseconds."""
    table, k = choice.table, chosen.index
    fields = list(table.columns[k].texts or [])
    indices, names = [k], ""
    if is_date(choice.firsts[k]):
        clock = next((j for j in choice.free() if is_clock_time(choice.firsts[j])), None)
        if clock is not None:
            fields = [f"{a} {b}".strip() for a, b in zip(fields, table.columns[clock].texts or [], strict=True)]
            indices, names = [k, clock], f" with {choice.shown[clock]!r}"
    times = read_times(fields, chosen.layout, lambda layout: column_option("time_s", choice.names, k, layout))
    whole = _add_fractions(choice, times.seconds, indices)
    choice.notes.append(f"{times.note}{names}" + (f" with {whole[1]!r}" if whole is not None else ""))
    return times.seconds if whole is None else whole[0]


def _add_fractions(choice: ColumnChoice, seconds: Array, indices: Sequence[int]) -> tuple[Array, str] | None:
    """Return full seconds with their fractions from another column, and its name: the one right behind the seconds, or
    the only one; None if there is none."""
    if np.any(seconds % 1.0):
        return None
    found = [k for k in choice.free() if choice.names[k].strip().lower() in SECOND_FRACTIONS]
    near = [k for k in found if k - 1 in indices] or found
    if len(near) != 1:
        return None
    name = choice.names[near[0]].strip()
    try:
        values = SECOND_FRACTIONS[name.lower()] * choice.numbers(near[0]).values
    except ValueError:
        return None
    if values.size != seconds.size or not np.all((values >= 0.0) & (values < 1.0)):
        return None
    return np.round(seconds + values - values[0], 9), name


def _notes(choice: ColumnChoice) -> tuple[str, ...]:
    """Return one line on which columns were taken, unless every name is ours or was typed with its unit."""
    taken = []
    for ours, chosen in choice.chosen.items():
        if chosen.how == "guessed" or chosen.note:
            unit = "" if chosen.unit == unit_ending(ours) else f" in {chosen.unit}"
            note = f" {chosen.note}" if chosen.note else ""
            taken.append(f"{ours} from {choice.shown[chosen.index]!r}{unit}{note}")
    parts = [f"taken: {', '.join(taken)}"] if taken else []
    parts += [*choice.table.notes, *choice.notes]
    return ("; ".join(parts),) if parts else ()
