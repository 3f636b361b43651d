"""Which of a table's columns is taken for which of ours: as typed, by our own names, by names that are plain; and what
has to be asked for, in lines with the --column to type.
"""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from compensator.hysteresis.functions import Array
from rig.core.columns import GUESSED, OF_A_RECORD
from rig.records.branches import names_twice
from rig.records.column_names import ColumnMapping, Meaning, ending_of, meaning_of, other_unit, typed
from rig.records.numbers import Numbers, blank_like, number_like, read_numbers, tidied, within_range
from rig.records.table import Column, Table
from rig.records.times import clock_alone, date_alone, time_like
from rig.records.units import CONDUCTANCES, RECIPROCALS, UNITS

# between 2001 and 2128: numbers that are moments and no times of a run
SINCE_1970 = {"s": (1e9, 5e9), "ms": (1e12, 5e12), "us": (1e15, 5e15), "ns": (1e18, 5e18)}
MOST_DUTY = 1.05  # a duty of 256 in 255 is written too
LEAST_PLATE_A = 0.02  # a plate's current reaches more; an ohmmeter's test current does not
SHOWN_NAMES = 30
MOST_OFFERED = 4  # columns that may be it, in one line


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

    def holds_numbers(self, k: int) -> bool:
        """Whether a column begins with a number."""
        return self.table.columns[k].numbers is not None or number_like(self.first(k))

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

    def to_type(self, ours: str, k: int, units: Sequence[str | None]) -> str:
        """What to type for a column, in each unit that it may have."""
        return " or ".join(typed(ours, self.names, k, unit) for unit in units)

    def there(self) -> str:
        """The names that there are, as many as can be read."""
        shown = ", ".join(name[:60] for name in self.shown[:SHOWN_NAMES])
        more = len(self.shown) - SHOWN_NAMES
        return shown + (f" and {more} more" if more > 0 else "")


def take_typed(taking: Taking, mappings: Sequence[ColumnMapping]) -> None:
    """What somebody typed with --column; a name that is not there is a fault."""
    for mapping in mappings:
        k = mapping.found_in(taking.names)
        if k is None:
            other_way = ""
            if mapping.theirs in OF_A_RECORD and mapping.ours in taking.names:
                expected = typed(mapping.theirs, taking.names, taking.names.index(mapping.ours))
                other_way = f"; ours stands first: expected {expected}"
            text = f"no column {mapping.theirs!r} for {mapping.ours}; there are {taking.there()}{other_way}"
            taking.faults.append(taking.at_names(text))
        elif mapping.ours in taking.chosen:
            text = f"--column {mapping.ours} was typed twice; expected once, with | between several names"
            taking.faults.append(taking.at_names(text))
        elif mapping.ours not in OF_A_RECORD:
            taking.renamed[k] = mapping.ours
        else:
            unit, note = mapping.unit, ""
            meaning = taking.meanings[k]
            if not mapping.unit_said and meaning.unit in UNITS[ending_of(mapping.ours)] and meaning.unit != unit:
                unit, note = str(meaning.unit), "as its name says"
            said = mapping.unit_said or bool(note)
            _refuse_other_unit(taking, mapping, k, unit)
            taken = next((ours for ours, choice in taking.chosen.items() if choice.index == k), "")
            if taken:
                text = f"{taking.shown[k]!r} was typed for {taken} and for {mapping.ours}; expected a column for each"
                taking.faults.append(taking.at_names(text))
            taking.chosen[mapping.ours] = Choice(k, unit, "typed", said, mapping.layout, note)


def _refuse_other_unit(taking: Taking, mapping: ColumnMapping, k: int, taken: str) -> None:
    """A name that says another quantity's unit than that of the column that it was typed for. By its number a column is
    taken in the unit that is typed, whatever its name says."""
    ours, ending = mapping.ours, ending_of(mapping.ours)
    unit = other_unit(taking.names[k], taking.table.columns[k].unit, ending)
    by_number = mapping.unit_said and mapping.theirs.strip().startswith("#")
    if not unit or by_number or taken in RECIPROCALS:
        return
    meaning = taking.meanings[k]
    if meaning.ours == ours and meaning.unit is not None:
        expected = typed(ours, taking.names, k, meaning.unit)
    else:
        number = shlex.quote(f"{ours}=#{k + 1}@{mapping.unit}")
        expected = f"another column, or --column {number} if its name is wrong"
    text = f"{taking.shown[k]!r} was typed for {ours}, and its name says {unit}, which is no unit of that; "
    taking.faults.append(taking.at_names(f"{text}expected {expected}"))


def take_own(taking: Taking) -> None:
    """Our own names, and a name that stands twice where it matters."""
    free = taking.free()
    for name in OF_A_RECORD:
        there = [k for k in free if taking.names[k].strip() == name]
        if len(there) > 1:
            taking.faults.append(taking.at_names(f"column {name!r} appears twice"))
        elif there and name not in taking.chosen:
            unit = ending_of(name)
            taking.chosen[name] = Choice(there[0], unit, "own")


def take_plain(taking: Taking) -> None:
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
    plain = [k for k in there if k not in timed and taking.meanings[k].plain]
    if len(plain) == 1 and not timed:  # its rows are told that do not rise, or are no numbers
        taking.chosen["time_s"] = Choice(plain[0], str(taking.meanings[plain[0]].unit), "guessed")
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


ASKED_UNITS = {
    "s": ("s", "ms", "min", "h", "d"),
    "degC": ("degC", "K", "degF"),
    "ohm": ("ohm", "kohm", "Mohm", "S"),
    "A": ("A", "mA"),
}
ENDING_UNITS = {"C": "degC", "c": "degC", "degC": "degC", "degc": "degC", "K": "K", "k": "K", "F": "degF", "f": "degF"}
DRIVE_UNITS = ("duty", "percent", "pwm255")
OTHER_UNIT = {
    "time_s": "time_min",
    "target_ohm": "target_kohm",
    "setpoint_degC": "setpoint_K",
    "current_A": "current_mA",
}


def ask(taking: Taking, needs: Sequence[str]) -> None:
    """Lines for what is needed and not plain, and for what looks like a resistance or a current and is not plain."""
    if not taking.table.named and not taking.chosen:
        taking.faults.append(taking.at_names(_without_names(taking)))
        return
    if "time_s" not in taking.chosen and names_twice([column.name for column in taking.table.columns]):
        text = "every name stands there twice: heating and cooling side by side? expected --branches (heating first)"
        taking.faults.append(taking.at_names(f"there are {taking.there()}; {text}, or columns by their numbers"))
        return
    offered: set[int] = set()
    for ours in needs:
        if ours not in taking.chosen and ours not in taking.renamed.values():
            text = f"column {ours!r} missing; there are {taking.there()}{_to_type(taking, ours, offered)}"
            taking.faults.append(taking.at_names(text))
    for ours in ("temperature_degC", "resistance_ohm", "current_A"):
        if ours in taking.chosen or ours in needs or not taking.flags:
            continue
        for k in [
            k for k in taking.free() if taking.meanings[k].ours == ours and taking.filled(k) and k not in offered
        ]:
            what = taking.to_type(ours, k, _units_asked(taking, ours, k))
            why, another = _why(taking, ours, k)
            if ours == "resistance_ohm" and not another:
                keep = typed(taking.names[k] or f"column{k + 1}", taking.names, k)
                text = f"{taking.shown[k]!r}: {why}; expected {what} or, to leave it as it is, {keep}"
                taking.faults.append(taking.at_names(text))
            else:
                taking.said.append(f"{taking.shown[k]!r} left: {why}; if it is {ours}, {what}")


def _why(taking: Taking, ours: str, k: int) -> tuple[str, bool]:
    """Why a column was not taken, and whether its name says that it may be of something else."""
    meaning = taking.meanings[k]
    if meaning.doubt:
        return meaning.doubt, False
    if ours == "current_A" and (
        meaning.unit == "percent" or (meaning.unit is None and not _is_current(taking.names[k]))
    ):
        return "a share of full drive?", False
    if meaning.plain:
        several = sum(each.ours == ours and each.plain for each in taking.meanings) > 1
        return ("more than one column may be it" if several else "too small for a plate's current"), False
    if meaning.unit is not None:
        return "a word of its name is not known", True
    return "its unit is not said", False


def _units_asked(taking: Taking, ours: str, k: int) -> Sequence[str | None]:
    """The units to offer: that of the name where it has one, else the usual ones."""
    meaning = taking.meanings[k]
    if ours == "time_s" and time_like(taking.first(k)):
        return (None,)
    if meaning.doubt.startswith("the name says"):
        return (str(meaning.unit), "ohm" if meaning.unit in CONDUCTANCES else "S")
    if meaning.unit is not None and not (ours == "current_A" and meaning.unit == "percent"):
        return (meaning.unit,)
    if ending_like(taking.names[k]) and ours == "temperature_degC":
        return (ENDING_UNITS[taking.names[k].strip().rpartition("_")[2]],)
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


def _to_type(taking: Taking, ours: str, offered: set[int]) -> str:
    """What to type for a column that is missing: for each that may be it, in each unit. offered: for another."""
    free = [k for k in taking.free() if k not in offered and taking.filled(k)]
    named = [k for k in free if taking.meanings[k].ours == ours]
    likely = [k for k in named if taking.holds_numbers(k) or (ours == "time_s" and time_like(taking.first(k)))]
    unknown = [k for k in free if taking.meanings[k].ours is None and not _foreign(taking, k, ours)]
    if not likely and ours == "time_s":
        rising = [k for k in unknown if _rises(taking.values(k)) and not _counts(taking.values(k))]
        likely = [k for k in unknown if time_like(taking.first(k)) or k in rising]
    if not likely and ours == "temperature_degC":
        likely = [k for k in unknown if ending_like(taking.names[k]) == "degC" and taking.values(k) is not None]
    if not taking.flags:
        return f"; expected the name {ours}, or it with another unit, as {OTHER_UNIT.get(ours, ours)}" if likely else ""
    why = next((taking.meanings[k].doubt for k in likely if taking.meanings[k].doubt), "")
    strange = [k for k in named if k not in likely]
    if strange:
        why = f"{taking.shown[strange[0]]!r} holds {taking.first(strange[0])[:40]!r}, which is none that is known"
    if not likely:
        return (f"; {why}" if why else "") + (_no_times(taking) if ours == "time_s" else "")
    offered |= set(likely[:MOST_OFFERED])
    most = 2 if len(likely) > 1 else 5  # units to offer for each
    lines = [taking.to_type(ours, k, _units_asked(taking, ours, k)[:most]) for k in likely[:MOST_OFFERED]]
    return f"; {why + '; ' if why else ''}expected {' or '.join(lines)}"


def _foreign(taking: Taking, k: int, ours: str) -> bool:
    """Whether a column's name says a unit that ours cannot have."""
    return bool(other_unit(taking.names[k], taking.table.columns[k].unit, ending_of(ours)))


def _no_times(taking: Taking) -> str:
    """What to type where no column may be one of times."""
    return (
        "; no column of times: expected --column time_s=row if the rows stand as they were taken, or --period SECONDS "
        "if they are evenly apart too; with --reversed if the last was taken first, as in a cooling branch that is "
        "sorted upwards; no rates are reported then"
    )


def ending_like(name: str) -> str:
    """'degC' for a name that ends like a temperature's, as 'y_C' or 'plate1_K'."""
    return "degC" if name.strip().rpartition("_")[2] in ENDING_UNITS else ""


def _rises(values: Array | None) -> bool:
    return values is not None and values.size >= 2 and bool(np.all(np.diff(values) > 0.0))


def _counts(values: Array | None) -> bool:
    """Whether a column counts the rows, which is no time."""
    return values is not None and values[0] in (0.0, 1.0) and bool(np.all(np.diff(values) == 1.0))


def _without_names(taking: Taking) -> str:
    """What to type for a file without names, by what its columns look like; a proposal that has to be looked at."""
    told: dict[str, str] = {}
    for k in range(len(taking.names)):
        values = taking.values(k)
        if time_like(taking.first(k)):
            told.setdefault("time_s", f"#{k + 1}")
        elif values is None:
            continue
        elif "time_s" not in told and _rises(values) and len(taking.names) > 2:  # of two it is the temperature
            told["time_s"] = f"#{k + 1}@s"
        elif "temperature_degC" not in told and np.min(values) > -60.0 and np.max(values) < 500.0:
            unit = "K" if np.min(values) > 200.0 else "degC"
            told["temperature_degC"] = f"#{k + 1}@{unit}"
        elif "resistance_ohm" not in told and np.min(values) > 0.0:
            told["resistance_ohm"] = f"#{k + 1}@ohm"
    told.setdefault("time_s", "row")
    lines = " ".join(f"--column '{ours}={theirs}'" for ours, theirs in told.items())
    return (
        f"no names above {len(taking.names)} columns of numbers; expected --column OURS=#NUMBER@UNIT for each, "
        f"as it might be {lines}"
    )
