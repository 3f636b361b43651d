"""From a file's table to a record: which column is taken for which of ours, what that is worth, what has to be asked.

What somebody typed with --column comes first, then our own names, then names that are plain
(`rig.files.column_meaning`). What was taken for what is told in a line. Where a column that is needed, or one that
looks as if it held the resistance, is not plain, the file is refused with the line to type.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from compensator.functions import Array
from rig.faults import Faults, fault
from rig.files.column_mapping import ColumnMapping, ending_of, typed
from rig.files.column_meaning import KNOWN, Meaning, meaning_of
from rig.files.credible_columns import faults_in
from rig.files.field_numbers import Numbers, Undecided, blank_like, number_of, read_numbers, tidied, within_range
from rig.files.field_times import Unclear, clock_alone, date_alone, read_times, time_like
from rig.files.record import Record
from rig.files.table import Column, Table
from rig.files.units import CONDUCTANCES, SHARES, UNITS

GUESSED = (
    "time_s",
    "temperature_degC",
    "resistance_ohm",
    "current_A",
    "meter_current_A",
    "setpoint_degC",
    "target_ohm",
    "ambient_degC",
    "sink_degC",
)
ASKED_UNITS = {
    "s": ("s", "ms", "min", "h"),
    "degC": ("degC", "K", "degF"),
    "ohm": ("ohm", "kohm", "Mohm", "S"),
    "A": ("A", "mA"),
}
DRIVE_UNITS = ("duty", "percent", "pwm255")
SINCE_1970 = {"s": (1e9, 5e9), "ms": (1e12, 5e12), "us": (1e15, 5e15), "ns": (1e18, 5e18)}
OTHER_UNIT = {
    "time_s": "time_min",
    "target_ohm": "target_kohm",
    "setpoint_degC": "setpoint_K",
    "current_A": "current_mA",
}
MOST_DUTY = 1.05  # a duty of 256 in 255 is written too
LEAST_PLATE_A = 0.02  # a plate's current reaches more; an ohmmeter's test current does not
LEAST_KELVIN = 150.0  # no record of a film or a Peltier plate stays below this many kelvins
LEAST_OHM = 0.01  # no film's resistance stays below this
MOST_NUMBER_FAULTS = 5
SHOWN_NAMES = 30


@dataclass(frozen=True)
class Choice:
    """A column that was taken: its index, its unit, how (typed, own, guessed), dates' layout."""

    index: int
    unit: str
    how: str
    unit_said: bool = False
    layout: str | None = None
    note: str = ""


class Taking:
    """The columns of one table, taken one after the other."""

    def __init__(self, table: Table, flags: bool = True) -> None:
        self.table, self.flags = table, flags
        self.names = [column.name for column in table.columns]
        self.shown = table.names()
        self.meanings = [meaning_of(column.name, column.unit) for column in table.columns]
        self.chosen: dict[str, Choice] = {}
        self.renamed: dict[int, str] = {}
        self.faults: list[str] = []
        self.said: list[str] = []
        self._numbers: dict[tuple[int, str | None], Numbers] = {}

    # what stands in the columns

    def free(self) -> list[int]:
        """Columns that nothing has taken."""
        taken = {choice.index for choice in self.chosen.values()} | set(self.renamed)
        return [k for k in range(len(self.names)) if k not in taken]

    def first(self, k: int) -> str:
        """The first field that says something, '' in a column of numbers or of none."""
        texts = self.table.columns[k].texts
        return next((text for text in texts if not blank_like(text)), "") if texts is not None else ""

    def filled(self, k: int) -> bool:
        """Whether a column holds anything."""
        numbers = self.table.columns[k].numbers
        return bool(np.any(np.isfinite(numbers))) if numbers is not None else bool(self.first(k))

    def numbers(self, k: int, ending: str | None = None) -> Numbers:
        """A column as numbers, read once. Raises ValueError."""
        if (k, ending) not in self._numbers:
            self._numbers[k, ending] = self._read(self.table.columns[k], ending)
        return self._numbers[k, ending]

    def _read(self, column: Column, ending: str | None) -> Numbers:
        if column.texts is not None:
            return read_numbers(column.texts, self.table.signs, ending)
        assert column.numbers is not None
        return within_range(column.numbers, ending)

    def values(self, k: int) -> Array | None:
        """A column's finite numbers; None where it holds something else."""
        try:
            values = self.numbers(k).values
        except ValueError:
            return None
        values = values[np.isfinite(values)]
        return values if values.size else None

    def at_names(self, text: str) -> str:
        """A fault's line about the names."""
        place = f"{self.table.place}: " if self.table.place else ""
        return f"{self.table.source}: {place}{text}"

    def to_type(self, ours: str, k: int, units: Sequence[str]) -> str:
        """What to type for a column, in each unit that it may have."""
        return " or ".join(typed(ours, self.names, k, unit) for unit in units)


def record_of(
    table: Table, mappings: Iterable[ColumnMapping] = (), needs: Iterable[str] = (), flags: bool = True
) -> Record:
    """The record in a table. Raises Faults, a line for each, with what to type, where there are flags to type."""
    mappings = list(mappings)
    taking = Taking(table, flags)
    _take_typed(taking, mappings)
    _take_own(taking)
    if taking.faults:
        raise Faults(taking.faults)
    _take_plain(taking)
    _ask(taking, ["time_s", *(name for name in needs if name != "time_s")])
    if taking.faults:
        raise Faults(taking.faults)
    return _converted(taking)


def _take_typed(taking: Taking, mappings: Sequence[ColumnMapping]) -> None:
    for mapping in mappings:
        k = mapping.found_in(taking.names)
        if k is None:
            there = _some(taking.shown)
            taking.faults.append(taking.at_names(f"no column {mapping.theirs!r} for {mapping.ours}; there are {there}"))
        elif mapping.ours not in KNOWN:
            taking.renamed[k] = mapping.ours
        else:
            unit, note = mapping.unit, ""
            meaning = taking.meanings[k]
            if not mapping.unit_said and meaning.unit in UNITS[ending_of(mapping.ours)] and meaning.unit != unit:
                unit, note = str(meaning.unit), "as its name says"
            said = mapping.unit_said or bool(note)
            taking.chosen[mapping.ours] = Choice(k, unit, "typed", said, mapping.layout, note)


def _take_own(taking: Taking) -> None:
    """Our own names, and a name that stands twice where it matters."""
    free = taking.free()
    for name in KNOWN:
        there = [k for k in free if taking.names[k].strip() == name]
        if len(there) > 1:
            taking.faults.append(taking.at_names(f"column {name!r} appears twice"))
        elif there and name not in taking.chosen:
            unit = ending_of(name)
            taking.chosen[name] = Choice(there[0], unit, "own")


def _take_plain(taking: Taking) -> None:
    """Names that are plain, where one column only has them."""
    if "time_s" not in taking.chosen:
        _take_time(taking)
    for ours in GUESSED[1:]:
        if ours in taking.chosen:
            continue
        there = [(k, m) for k in taking.free() if (m := _meaning(taking, k)).ours == ours and m.plain]
        there = [(k, m) for k, m in there if taking.filled(k) and _credible(taking, ours, k, m)]
        if len(there) == 1:
            k, meaning = there[0]
            taking.chosen[ours] = Choice(k, str(meaning.unit), "guessed")


def _meaning(taking: Taking, k: int) -> Meaning:
    """What a name says, or, where it says no unit, what the fields do that have units of their own."""
    meaning = taking.meanings[k]
    if meaning.unit is not None or meaning.said:
        return meaning
    if meaning.ours == "current_A" and "duty" in taking.names[k].lower():
        values = taking.values(k)
        within = values is not None and np.max(np.abs(values)) <= MOST_DUTY
        return Meaning("current_A", "duty", True) if within else meaning
    first = tidied(taking.first(k))
    if not first or first[-1].isdigit():
        return meaning
    for ending, ours in (("ohm", "resistance_ohm"), ("degC", "temperature_degC"), ("A", "current_A")):
        try:
            found = taking.numbers(k, ending).ending
        except ValueError:
            continue
        if found == ending and meaning.ours in (None, ours) and _nothing_strange(taking.names[k], ending):
            return Meaning(ours, ending, True)
    return meaning


def _nothing_strange(name: str, ending: str) -> bool:
    """Whether a name with the unit behind it is plain."""
    return meaning_of(f"{name} ({ending})").plain


def _credible(taking: Taking, ours: str, k: int, meaning: Meaning) -> bool:
    """Whether numbers may be what a name and a unit make of them; where not, they are asked for."""
    try:
        numbers = taking.numbers(k, ending_of(ours))
    except ValueError:
        return True  # a fault that is told with its line
    values = numbers.values[np.isfinite(numbers.values)]
    if not values.size:
        return False
    if ours == "current_A":
        largest = float(np.max(np.abs(values)))
        if meaning.unit == "percent":
            return largest == 0.0 or 1.0 < largest <= 110.0
        if meaning.unit != "duty":
            largest = float(np.max(np.abs(UNITS["A"][str(meaning.unit)](values))))
            return largest == 0.0 or largest >= LEAST_PLATE_A
    return True


def _take_time(taking: Taking) -> None:
    """The column of times: seconds that rise, else dates, else a clock's times, else seconds since 1970."""
    there = [k for k in taking.free() if taking.meanings[k].ours == "time_s" and taking.filled(k)]
    timed = [k for k in there if time_like(taking.first(k))]
    rising = []
    for k in there:
        values = taking.values(k) if k not in timed else None
        if values is not None and values.size >= 2 and taking.meanings[k].plain and np.all(np.diff(values) > 0.0):
            rising.append(k)
    if len(rising) == 1:
        taking.chosen["time_s"] = Choice(rising[0], str(taking.meanings[rising[0]].unit), "guessed")
        return
    if rising:
        return
    if not there:
        timed = [k for k in taking.free() if time_like(taking.first(k)) and not date_alone(taking.first(k))]
    if timed:
        dated = [k for k in timed if not clock_alone(taking.first(k))]
        taking.chosen["time_s"] = Choice((dated or timed)[0], "s", "guessed")
        return
    for k in there:
        values = taking.values(k)
        if values is None or taking.meanings[k].said:
            continue
        for unit, (low, high) in SINCE_1970.items():
            if low < np.min(values) and np.max(values) < high:
                taking.chosen["time_s"] = Choice(k, unit, "guessed", note="since 1970")
                return


def _ask(taking: Taking, needs: Sequence[str]) -> None:
    """Lines for what is needed and not plain, and for what looks like a resistance or a current and is not plain."""
    if not taking.table.named and not taking.chosen:
        taking.faults.append(taking.at_names(_without_names(taking)))
        return
    for ours in needs:
        if ours not in taking.chosen and ours not in taking.renamed.values():
            text = f"column {ours!r} missing; there are {_some(taking.shown)}{_to_type(taking, ours)}"
            taking.faults.append(taking.at_names(text))
    for ours in ("temperature_degC", "resistance_ohm", "current_A"):
        if ours in taking.chosen or ours in needs or not taking.flags:
            continue
        for k in [k for k in taking.free() if taking.filled(k) and taking.values(k) is not None]:
            meaning = taking.meanings[k]
            if meaning.ours != ours:
                continue
            what = taking.to_type(ours, k, _units_asked(taking, ours, k))
            share = meaning.unit == "percent" or (ours == "current_A" and not _is_current(taking.names[k]))
            why = (
                "a share of full drive?"
                if share
                else meaning.doubt or ("more than one column may be it" if meaning.plain else "its unit is not said")
            )
            if ours == "resistance_ohm":
                keep = typed(taking.names[k] or f"column{k + 1}", taking.names, k)
                text = f"{taking.shown[k]!r}: {why}; expected {what} or, to leave it as it is, {keep}"
                taking.faults.append(taking.at_names(text))
            else:
                taking.said.append(f"{taking.shown[k]!r} left: {why}; if it is {ours}, {what}")


def _units_asked(taking: Taking, ours: str, k: int) -> Sequence[str]:
    """The units to offer: that of the name where it has one, else the usual ones."""
    meaning = taking.meanings[k]
    if meaning.doubt.startswith("the name says"):
        return (str(meaning.unit), "ohm" if meaning.unit in CONDUCTANCES else "S")
    if meaning.unit is not None and not (ours == "current_A" and meaning.unit == "percent"):
        return (meaning.unit,)
    if ending_like(taking.names[k]) and ours == "temperature_degC":
        return ({"C": "degC", "degC": "degC", "K": "K", "F": "degF"}[taking.names[k].strip().rpartition("_")[2]],)
    if "milliohms" in meaning.doubt:
        return ("Mohm", "mohm")
    if "logarithm's" in meaning.doubt:
        return ("log10ohm", "lnohm")
    if ours == "current_A" and meaning.unit == "percent":
        values = taking.values(k)
        return DRIVE_UNITS[:2] if values is not None and np.max(np.abs(values)) <= 1.0 else ("percent",)
    if ours == "current_A" and not _is_current(taking.names[k]):
        return DRIVE_UNITS
    if ours == "temperature_degC":
        values = taking.values(k)
        if values is not None and np.min(values) > 200.0:
            return ("K", "degC")
    return ASKED_UNITS[ending_of(ours)]


def _is_current(name: str) -> bool:
    return meaning_of(f"{name} (mA)").plain and not meaning_of(f"{name} (%)").plain


def _to_type(taking: Taking, ours: str) -> str:
    """What to type for a column that is missing: for each that may be it, in each unit."""
    free = [k for k in taking.free() if taking.filled(k)]
    likely = [k for k in free if taking.meanings[k].ours == ours]
    if not likely and ours == "time_s":
        likely = [k for k in free if time_like(taking.first(k)) or _rises(taking.values(k))]
    if not likely and ours == "temperature_degC":
        likely = [k for k in free if ending_like(taking.names[k]) == "degC" and taking.values(k) is not None]
    if not likely:
        return ""
    if not taking.flags:
        return f"; expected the name {ours}, or it with another unit, as {OTHER_UNIT.get(ours, ours)}"
    most = 2 if len(likely) > 1 else 4  # units to offer for each
    lines = [taking.to_type(ours, k, _units_asked(taking, ours, k)[:most]) for k in likely[:4]]
    why = next((taking.meanings[k].doubt for k in likely if taking.meanings[k].doubt), "")
    return f"; {why + '; ' if why else ''}expected {' or '.join(lines)}"


def ending_like(name: str) -> str:
    """'degC' for a name that ends like a temperature's, as 'y_C' or 'plate1_K'."""
    tail = name.strip().rpartition("_")[2]
    return "degC" if tail in ("C", "K", "degC", "F") else ""


def _rises(values: Array | None) -> bool:
    return values is not None and values.size >= 2 and bool(np.all(np.diff(values) > 0.0))


def _without_names(taking: Taking) -> str:
    """What to type for a file without names, by what its columns look like; a proposal that has to be looked at."""
    told: dict[str, str] = {}
    for k in range(len(taking.names)):
        values = taking.values(k)
        if time_like(taking.first(k)):
            told.setdefault("time_s", f"#{k + 1}")
        elif values is None:
            continue
        elif "time_s" not in told and _rises(values):
            told["time_s"] = f"#{k + 1}@s"
        elif "temperature_degC" not in told and np.min(values) > -60.0 and np.max(values) < 500.0:
            unit = "K" if np.min(values) > 200.0 else "degC"
            told["temperature_degC"] = f"#{k + 1}@{unit}"
        elif "resistance_ohm" not in told and np.min(values) > 0.0:
            told["resistance_ohm"] = f"#{k + 1}@ohm"
    lines = " ".join(f"--column '{ours}={theirs}'" for ours, theirs in told.items()) or "--column 'time_s=#1@s'"
    return (
        f"no names above {len(taking.names)} columns of numbers; expected --column OURS=#NUMBER@UNIT for each, "
        f"as it might be {lines}"
    )


def _some(names: Sequence[str]) -> str:
    shown = ", ".join(name[:60] for name in names[:SHOWN_NAMES])
    return shown + (f" and {len(names) - SHOWN_NAMES} more" if len(names) > SHOWN_NAMES else "")


def _converted(taking: Taking) -> Record:
    """Every column in our units. Raises Faults."""
    values: dict[str, Array] = {}
    texts: dict[str, list[str]] = {}
    faults: list[str] = []
    by_index: dict[int, list[str]] = {}
    for ours, choice in taking.chosen.items():
        by_index.setdefault(choice.index, []).append(ours)
    names = _kept_names(taking)
    for k in range(len(taking.names)):
        for ours in by_index.get(k, []):
            try:
                values[ours] = _ours(taking, ours, taking.chosen[ours])
            except Faults as found:
                faults += found.lines
        if k in by_index or k not in names:
            continue
        try:
            values[names[k]] = taking.numbers(k).values
        except ValueError:
            texts[names[k]] = list(taking.table.columns[k].texts or [])
    if not faults:
        faults = faults_in(taking.table, values, taking.chosen, taking.names)
    if faults:
        raise Faults(faults)
    current = taking.chosen.get("current_A")
    drive = current.unit if current is not None and current.unit in SHARES else None
    return Record(values, taking.table.source, drive, texts, tuple(_told(taking)))


def _kept_names(taking: Taking) -> dict[int, str]:
    """Names of the columns that are kept as they are, each once, by index."""
    kept: dict[int, str] = {}
    used = set(taking.chosen)
    for k in taking.free() + sorted(taking.renamed):
        name = taking.renamed.get(k, taking.names[k].strip()) or f"#{k + 1}"
        if name in used:
            name = f"{name} #{k + 1}"
        used.add(name)
        kept[k] = name
    return kept


def _ours(taking: Taking, ours: str, choice: Choice) -> Array:
    """One of our columns. Raises Faults: a field that is no number or no time."""
    table, ending = taking.table, ending_of(ours)
    if ours == "time_s" and time_like(taking.first(choice.index)):
        return _times(taking, choice)
    try:
        numbers = taking.numbers(choice.index, ending)
    except Undecided as error:
        what = " expected --decimal , or --decimal ." if taking.flags else " expected decimals with a point"
        text = f"{ours}: {str(error)[:40]!r}: a comma or point before decimals, or between thousands?"
        raise fault(table.source, _place(taking, choice, str(error)), f"{text}{what}") from None
    except ValueError:
        raise Faults(_no_numbers(taking, ours, choice)) from None
    taking.said += [f"in {ours} {text}" for text in numbers.said]
    values = numbers.values
    if numbers.ending is None and choice.unit != ending:
        values = np.asarray(UNITS[ending][choice.unit](values), dtype=np.float64)
    if np.any(np.isinf(numbers.values)):
        _refuse_endless(taking, ours, choice, numbers.values)
        if ending in ("degC", "A"):  # of a resistance alone it says something
            values = np.where(np.isinf(numbers.values), np.nan, values)
    return values


def _refuse_endless(taking: Taking, ours: str, choice: Choice, values: Array) -> None:
    """Infinity is a reading beyond the range where it was written so, not where it has too many digits."""
    table, texts = taking.table, taking.table.columns[choice.index].texts
    rows = [int(k) for k in np.flatnonzero(np.isinf(values))] if texts is not None else []
    wrong = [k for k in rows if texts is not None and sum(map(str.isdigit, texts[k])) > 2 and not _sentinel(texts[k])]
    if wrong and texts is not None:
        raise Faults(
            f"{table.source}: {table.at(k)}: {ours}: {texts[k][:24]!r}: expected a number that a double holds"
            for k in wrong[:MOST_NUMBER_FAULTS]
        )


def _sentinel(text: str) -> bool:
    return re.search(r"[eE]\+?3[78]\b", text) is not None


def _place(taking: Taking, choice: Choice, text: str) -> str:
    texts = taking.table.columns[choice.index].texts or []
    return taking.table.at(texts.index(text)) if text in texts else taking.table.place


def _no_numbers(taking: Taking, ours: str, choice: Choice) -> list[str]:
    """Lines for the first fields that are no numbers."""
    table, more = taking.table, 0
    lines: list[str] = []
    sign = table.signs.decimal or "."
    for row, text in enumerate(table.columns[choice.index].texts or []):
        try:
            read_numbers([text], table.signs, ending_of(ours))
        except Undecided:
            continue
        except ValueError:
            if len(lines) < MOST_NUMBER_FAULTS:
                hint = " with a point" if sign == "." and _is_number(tidied(text), ",") else ""
                lines.append(f"{table.source}: {table.at(row)}: {ours}: {text[:40]!r}: expected a number{hint}")
            else:
                more += 1
    if more:
        lines.append(f"{table.source}: {ours}: and {more} more fields that are no numbers")
    return lines or [f"{table.source}: {ours}: some fields have a unit and some have none; expected one way of writing"]


def _is_number(text: str, sign: str) -> bool:
    try:
        number_of(text, sign)
    except ValueError:
        return False
    return True


def _times(taking: Taking, choice: Choice) -> Array:
    """Dates and clock times as seconds; a date's column goes with the clock's beside it, and with one of ms."""
    table, k = taking.table, choice.index
    fields = list(table.columns[k].texts or [])
    layout, beside = choice.layout, ""
    if date_alone(taking.first(k)):
        clock = next((j for j in taking.free() if clock_alone(taking.first(j))), None)
        if clock is not None:
            fields = [f"{a} {b}".strip() for a, b in zip(fields, table.columns[clock].texts or [], strict=True)]
            beside = f" with {taking.shown[clock]!r}"
    try:
        times = read_times(fields, layout)
    except Unclear as error:
        what = " or ".join(typed("time_s", taking.names, k, each) for each in error.layouts)
        text = f"{fields[0][:40]!r}: {error}?" + (f" expected {what}" if what else "")
        raise fault(table.source, table.at(0), f"time_s: {text}") from None
    except ValueError as error:
        bad = str(error)
        row = fields.index(bad) if bad in fields else None
        place = table.at(row) if row is not None else table.place
        raise fault(table.source, place, f"time_s: {bad[:60]!r}: expected a time as in the other rows") from None
    seconds = times.seconds
    milli = _milliseconds(taking, k) if not np.any(seconds % 1.0) else None
    if milli is not None:
        seconds = seconds + (milli - milli[0]) * 1e-3
        beside += " with its milliseconds"
    taking.said.append(f"{times.said}{beside}")
    return seconds


def _milliseconds(taking: Taking, k: int) -> Array | None:
    """The column of milliseconds right behind one of times, as loggers write it."""
    if k + 1 >= len(taking.names) or taking.names[k + 1].strip().lower() not in ("ms", "msec", "milliseconds"):
        return None
    values = taking.values(k + 1)
    complete = values is not None and values.size == len(taking.table.line_of)
    return values if values is not None and complete and np.min(values) >= 0.0 and np.max(values) < 1000.0 else None


def _told(taking: Taking) -> list[str]:
    """What was taken for what, in a line; nothing where every name is ours or was typed with its unit."""
    told = []
    for ours, choice in taking.chosen.items():
        if choice.how == "own" or (choice.how == "typed" and not choice.note):
            continue
        unit = "" if choice.unit == ending_of(ours) else f" in {choice.unit}"
        note = f" {choice.note}" if choice.note else ""
        told.append(f"{ours} from {taking.shown[choice.index]!r}{unit}{note}")
    parts = [f"taken: {', '.join(told)}"] if told else []
    return ["; ".join([*parts, *taking.table.said, *taking.said])] if parts or taking.table.said or taking.said else []
