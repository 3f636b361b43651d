"""Choice of a table's columns for ours: as typed, by our own names, by clear names; and what to ask the user for.

A column that is needed, or that looks like a resistance, and whose name is not clear is a fault; its message holds the
--column options to choose from.
"""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from compensator.hysteresis.functions import Array
from rig.core.reading import GUESSED, OF_A_RECORD
from rig.records.branches import has_repeated_names
from rig.records.column_names import (
    ColumnMapping,
    Meaning,
    column_option,
    contradicting_unit,
    interpret_name,
    unit_ending,
)
from rig.records.numbers import DRIVE_SHARES, RECIPROCALS, UNITS, Numbers, is_number
from rig.records.table import Table
from rig.records.times import is_clock_time, is_date, is_time

# Numbers between 2001 and 2128 are moments; no times of a run are as large.
SINCE_1970 = {"s": (1e9, 5e9), "ms": (1e12, 5e12), "us": (1e15, 5e15), "ns": (1e18, 5e18)}
MOST_DUTY = 1.05  # some write a duty of 256 in 255
COLDEST_K = 200.0  # temperatures above are more likely K than degC
LEAST_PLATE_A = 0.02  # a plate's current reaches more, an ohmmeter's test current does not
MOST_NAMES = 30  # in a message
MOST_OFFERED = 4  # columns in a message
OFFERED_UNITS: dict[str, Sequence[str]] = {
    "s": ("s", "min", "ms", "h", "d"),
    "degC": ("degC", "K", "degF"),
    "ohm": ("ohm", "kohm", "Mohm", "S"),
    "A": ("A", "mA"),
}
UNKNOWN_WORD = "a word of its name is not known"  # so it may be of another quantity
NO_TIMES = (
    "; no column of times: expected --column time_s=row if the rows are in the order in which they were taken, or "
    "--period SECONDS if they are also evenly spaced; with --reversed if the last was taken first, as in a cooling "
    "branch that is sorted upwards; no rates are reported then"
)


@dataclass(frozen=True)
class Choice:
    """A chosen column: its index, its unit, how it was chosen ("typed", "own", "guessed"), the layout of its dates."""

    index: int
    unit: str
    how: str
    unit_typed: bool = False
    layout: str | None = None
    note: str = ""


class ColumnChoice:
    """The columns of one table, chosen step by step.

    options: the user can type --column, so that faults may say what to type. chosen: choice for each of our columns;
    renamed: typed names of columns that are not ours, by index; faults, notes: lines for the user.
    """

    def __init__(self, table: Table, options: bool = True) -> None:
        self.table, self.options = table, options
        self.names = [column.name for column in table.columns]
        self.shown = table.shown_names()
        self.meanings = [column.meaning for column in table.columns]
        self.firsts = [column.first() for column in table.columns]
        self.chosen: dict[str, Choice] = {}
        self.renamed: dict[int, str] = {}
        self.faults: list[str] = []
        self.notes: list[str] = []
        self._numbers: dict[tuple[int, str | None], Numbers] = {}

    def free(self) -> list[int]:
        taken = {choice.index for choice in self.chosen.values()} | set(self.renamed)
        return [k for k in range(len(self.names)) if k not in taken]

    def numbers(self, k: int, ending: str | None = None) -> Numbers:
        """Return a column as numbers. Raises ValueError."""
        if (k, ending) not in self._numbers:
            self._numbers[k, ending] = self.table.columns[k].numbers(self.table.decimal, ending)
        return self._numbers[k, ending]

    def values(self, k: int) -> Array:
        """Return a column's finite numbers; none if it holds anything else."""
        try:
            values = self.numbers(k).values
        except ValueError:
            return np.empty(0)
        return values[np.isfinite(values)]

    def _filled(self, k: int) -> bool:
        return bool(self.firsts[k]) if self.table.columns[k].texts is not None else self.values(k).size > 0

    def _rises(self, k: int) -> bool:
        values = self.values(k)
        return values.size >= 2 and bool(np.all(np.diff(values) > 0.0))

    def _add_fault(self, text: str) -> None:
        place = f"{self.table.place}: " if self.table.place else ""
        self.faults.append(f"{self.table.source}: {place}{text}")

    def _option(self, ours: str, k: int, unit: str | None = None) -> str:
        return column_option(ours, self.names, k, unit)

    def _names_there(self) -> str:
        more = len(self.shown) - MOST_NAMES
        return ", ".join(name[:60] for name in self.shown[:MOST_NAMES]) + (f" and {more} more" if more > 0 else "")

    def choose_typed(self, mappings: Sequence[ColumnMapping]) -> None:
        for mapping in mappings:
            ours, k = mapping.ours, mapping.find(self.names)
            if k is None:
                hint = ""
                if mapping.theirs in OF_A_RECORD and ours in self.names:
                    hint = f"; ours stands first: expected {self._option(mapping.theirs, self.names.index(ours))}"
                self._add_fault(f"no column {mapping.theirs!r} for {ours}; there are {self._names_there()}{hint}")
            elif ours in self.chosen:
                self._add_fault(f"--column {ours} was typed twice; expected once, with | between several names")
            elif ours not in OF_A_RECORD:
                self.renamed[k] = ours
            else:
                unit, meant, note = mapping.unit, self.meanings[k].unit, ""
                if not mapping.unit_typed and meant in UNITS[unit_ending(ours)] and meant != unit:
                    unit, note = str(meant), "as its name says"
                self._check_unit(mapping, k, unit)
                taken = next((name for name, choice in self.chosen.items() if choice.index == k), "")
                if taken:
                    text = f"{self.shown[k]!r} was typed for {taken} and for {ours}; expected a column for each"
                    self._add_fault(text)
                self.chosen[ours] = Choice(k, unit, "typed", mapping.unit_typed or bool(note), mapping.layout, note)

    def _check_unit(self, mapping: ColumnMapping, k: int, unit: str) -> None:
        """Add a fault if the column's name contradicts the unit. A column typed by number and unit is not checked."""
        ours = mapping.ours
        other = self._contradicts(k, ours)
        by_number = mapping.unit_typed and mapping.theirs.strip().startswith("#")
        if not other or by_number or unit in RECIPROCALS:
            return
        meaning = self.meanings[k]
        expected = self._option(ours, k, meaning.unit)
        if meaning.ours != ours or meaning.unit is None:
            number = shlex.quote(f"{ours}=#{k + 1}@{mapping.unit}")
            expected = f"another column, or --column {number} if its name is wrong"
        text = f"{self.shown[k]!r} was typed for {ours}, and its name says {other}, which is no unit of that"
        self._add_fault(f"{text}; expected {expected}")

    def choose_own(self) -> None:
        """Choose the columns with our names; a name that stands there twice is a fault."""
        free = self.free()
        for name in OF_A_RECORD:
            there = [k for k in free if self.names[k].strip() == name]
            if len(there) > 1:
                self._add_fault(f"column {name!r} appears twice")
            elif there and name not in self.chosen:
                self.chosen[name] = Choice(there[0], unit_ending(name), "own")

    def choose_clear(self) -> None:
        """Choose columns with clear names, if only one column has the meaning."""
        if "time_s" not in self.chosen:
            self._choose_time()
        for ours in GUESSED[1:]:
            if ours not in self.chosen:
                there = [(k, m) for k in self.free() if (m := self._full_meaning(k)).ours == ours and m.certain]
                there = [(k, m) for k, m in there if self._filled(k) and self._is_plausible(ours, k, m)]
                if len(there) == 1:
                    self.chosen[ours] = Choice(there[0][0], str(there[0][1].unit), "guessed")

    def _full_meaning(self, k: int) -> Meaning:
        """Return the meaning of a name, with the unit of the fields if the name has none."""
        meaning = self.meanings[k]
        if meaning.unit is not None or meaning.has_unit:
            return meaning
        if meaning.ours == "current_A" and "duty" in self.names[k].lower():
            values = self.values(k)
            within = values.size > 0 and np.max(np.abs(values)) <= MOST_DUTY
            return Meaning("current_A", "duty", True) if within else meaning
        try:
            ending = self.numbers(k).ending
        except ValueError:
            return meaning
        full = interpret_name(f"{self.names[k]} ({ending})") if ending is not None else meaning
        return full if full.certain and meaning.ours in (None, full.ours) else meaning

    def _is_plausible(self, ours: str, k: int, meaning: Meaning) -> bool:
        """Return False if a column is empty, or its currents are too large or too small for their unit."""
        try:
            numbers = self.numbers(k, unit_ending(ours))
        except ValueError:
            return True  # the conversion names the line
        values = np.abs(numbers.values[np.isfinite(numbers.values)])
        if not values.size:
            return False
        if ours != "current_A" or meaning.unit == "duty":
            return True
        largest = float(np.max(values))
        if meaning.unit == "percent":
            return largest == 0.0 or 1.0 < largest <= 110.0
        largest = float(UNITS["A"][str(meaning.unit)](np.array([largest]))[0])
        return largest == 0.0 or largest >= LEAST_PLATE_A

    def _choose_time(self) -> None:
        """Choose the column of times: numbers that rise, else dates, else a clock's times, else seconds since 1970."""
        there = [k for k in self.free() if self.meanings[k].ours == "time_s" and self._filled(k)]
        timed = [k for k in there if is_time(self.firsts[k])]
        clear = [k for k in there if k not in timed and self.meanings[k].certain]
        # A single clear column that does not rise is chosen too, so that its fault is reported by row.
        numeric = [k for k in clear if self._rises(k)] or (clear if len(clear) == 1 and not timed else [])
        if numeric:
            if len(numeric) == 1:
                self.chosen["time_s"] = Choice(numeric[0], str(self.meanings[numeric[0]].unit), "guessed")
            return
        if not there:
            timed = [k for k in self.free() if is_time(self.firsts[k]) and not is_date(self.firsts[k])]
        if timed:
            dated = [k for k in timed if not is_clock_time(self.firsts[k])]
            self.chosen["time_s"] = Choice((dated or timed)[0], "s", "guessed")
            return
        for k in there:
            values = self.values(k)
            for unit, (low, high) in SINCE_1970.items() if values.size and not self.meanings[k].has_unit else ():
                if low < np.min(values) and np.max(values) < high:
                    self.chosen["time_s"] = Choice(k, unit, "guessed", note="since 1970")
                    return

    def ask(self, needs: Sequence[str]) -> None:
        """Add faults for columns that are needed or may be a resistance and are not clear, and notes for others."""
        if not self.table.named and not self.chosen:
            self._add_fault(self._proposal_without_names())
            return
        if "time_s" not in self.chosen and has_repeated_names(self.names):
            text = "every name is there twice: heating and cooling side by side? expected --branches"
            text += " (heating first), or columns by their numbers"
            self._add_fault(f"there are {self._names_there()}; {text}")
            return
        offered: set[int] = set()
        for ours in needs:
            if ours not in self.chosen and ours not in self.renamed.values():
                hint = self._candidates(ours, offered)
                self._add_fault(f"column {ours!r} missing; there are {self._names_there()}{hint}")
        for ours in ("temperature_degC", "resistance_ohm", "current_A"):
            if ours in self.chosen or ours in needs or not self.options:
                continue
            for k in self.free():
                if self.meanings[k].ours != ours or not self._filled(k) or k in offered:
                    continue
                options = " or ".join(self._option(ours, k, unit) for unit in self._offered_units(ours, k))
                why = self._reason(k)
                if ours == "resistance_ohm" and why != UNKNOWN_WORD:
                    keep = self._option(self.names[k] or f"column{k + 1}", k)
                    self._add_fault(f"{self.shown[k]!r}: {why}; expected {options} or, to leave it as it is, {keep}")
                else:
                    self.notes.append(f"{self.shown[k]!r} left out: {why}; if it is {ours}, {options}")

    def _reason(self, k: int) -> str:
        meaning = self.meanings[k]
        if meaning.doubt:
            return meaning.doubt
        if self._is_share(k):
            return "it may be a share of full drive"
        if meaning.certain:
            several = sum(each.ours == meaning.ours and each.certain for each in self.meanings) > 1
            return "more than one column may be it" if several else "too small for a plate's current"
        return "its unit is not given" if meaning.unit is None else UNKNOWN_WORD

    def _is_share(self, k: int) -> bool:
        """Return True if a column may be a share of full drive: percents, or a drive without a unit."""
        meaning, name = self.meanings[k], self.names[k]
        drive = interpret_name(f"{name} (%)").certain or not interpret_name(f"{name} (mA)").certain
        return meaning.ours == "current_A" and (meaning.unit == "percent" or (meaning.unit is None and drive))

    def _offered_units(self, ours: str, k: int) -> Sequence[str | None]:
        """Return the units to offer: those of the name, else the usual ones."""
        meaning, values = self.meanings[k], self.values(k)
        if ours == "time_s" and is_time(self.firsts[k]):
            return (None,)
        if self._is_share(k):
            small = values.size and np.max(np.abs(values)) <= 1.0
            return DRIVE_SHARES if meaning.unit is None else DRIVE_SHARES[:2] if small else ("percent",)
        if meaning.units or meaning.unit is not None:
            return meaning.units or (meaning.unit,)
        if ours == "temperature_degC" and values.size and np.min(values) > COLDEST_K:
            return ("K", "degC")
        return OFFERED_UNITS[unit_ending(ours)]

    def _candidates(self, ours: str, offered: set[int]) -> str:
        """Return what to type for a missing column; offered: columns that were offered for another one."""
        free = [k for k in self.free() if k not in offered and self._filled(k)]
        named = [k for k in free if self.meanings[k].ours == ours]
        likely = [k for k in named if self._may_be(ours, k)]
        if not likely and ours == "time_s":
            unknown = [k for k in free if self.meanings[k].ours is None and not self._contradicts(k, ours)]
            likely = [k for k in unknown if is_time(self.firsts[k]) or (self._rises(k) and not self._counts_rows(k))]
        if not self.options:
            name = f"{ours.rpartition('_')[0]}_{OFFERED_UNITS[unit_ending(ours)][1]}"
            return f"; expected the name {ours}, or it with another unit, as {name}" if likely else ""
        why = next((self.meanings[k].doubt for k in likely if self.meanings[k].doubt), "")
        strange = [k for k in named if k not in likely]
        if strange:
            why = f"{self.shown[strange[0]]!r} holds {self.firsts[strange[0]][:40]!r}, whose form is unknown"
        if not likely:
            return (f"; {why}" if why else "") + (NO_TIMES if ours == "time_s" else "")
        offered |= set(likely[:MOST_OFFERED])
        most = 2 if len(likely) > 1 else 5  # units for each
        options = [self._option(ours, k, u) for k in likely[:MOST_OFFERED] for u in self._offered_units(ours, k)[:most]]
        return f"; {why + '; ' if why else ''}expected {' or '.join(options)}"

    def _may_be(self, ours: str, k: int) -> bool:
        first, texts = self.firsts[k], self.table.columns[k].texts
        return texts is None or is_number(first) or (ours == "time_s" and is_time(first))

    def _contradicts(self, k: int, ours: str) -> str:
        """Return the unit in a column's name if ours cannot have it, else ''."""
        return contradicting_unit(self.names[k], self.table.columns[k].unit, unit_ending(ours))

    def _counts_rows(self, k: int) -> bool:
        values = self.values(k)
        return values[0] in (0.0, 1.0) and bool(np.all(np.diff(values) == 1.0))

    def _proposal_without_names(self) -> str:
        """Return what to type for a file without names, in the usual order of columns, for the user to check."""
        values = self.values(len(self.names) - 2) if len(self.names) > 1 else np.empty(0)
        kelvin = values.size > 0 and np.min(values) > COLDEST_K
        found = ["time_s=row"] if len(self.names) < 3 else ["time_s=#1" + "@s" * (not is_time(self.firsts[0]))]
        first = len(found) if len(self.names) > 2 else 0
        found += [f"temperature_degC=#{first + 1}@{'K' if kelvin else 'degC'}", f"resistance_ohm=#{first + 2}@ohm"]
        options = " ".join(f"--column '{each}'" for each in found)
        return (
            f"no names above {len(self.names)} columns of numbers; expected --column OURS=#NUMBER@UNIT for each, "
            f"for example {options}"
        )
