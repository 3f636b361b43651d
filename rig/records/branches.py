"""The heating and the cooling branch of a loop, side by side or in two files, in the order in which they were taken.

Tables of published loops have no times. The name of a branch says which way its rows go in time: of a cooling branch
that is sorted upwards the last row was the first.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from compensator.hysteresis.functions import Array
from rig.core.faults import fault
from rig.records.column_names import interpret_name
from rig.records.record import Record, Refused
from rig.records.table import Column, Table

HEATING = "heating heat heated warm warming warmup up upward rising increasing erwärmen aufheizen heizen chauffage"
COOLING = "cooling cool cooled cooldown down downward downwards falling decreasing abkühlen kühlen refroidissement"
BRANCH_OF = {**dict.fromkeys(HEATING.split(), "heating"), **dict.fromkeys(COOLING.split(), "cooling")}
OTHER_BRANCH = {"heating": "cooling", "cooling": "heating"}
END_SHARE = 0.1  # of the rows: their mean temperatures at both ends show which way a branch goes
FEWEST_ROWS = 3  # of a branch
JUMP = 0.5  # of the temperature range, in one row: a branch that begins where the other one did
MOST_WORDS = 8  # different ones in a column that names branches
Kind = TypeVar("Kind", bound=Record | Refused)


@dataclass(frozen=True)
class RowOrder:
    """The order of a file's rows as the user gave it.

    period_s: the time between rows, if the file has no times. reversed: the last row was taken first. branches:
    heating and cooling stand side by side, or in two files.
    """

    period_s: float | None = None
    reversed: bool = False
    branches: bool = False


def branch_in_name(name: str) -> tuple[str, str]:
    """Return 'heating', 'cooling' or '', as a word of a name says, and the name without such words."""
    words = [word for word in re.findall(r"[^\W\d_]+", name) if word.lower() in BRANCH_OF]
    if len({BRANCH_OF[word.lower()] for word in words}) != 1:
        return "", name
    bare = name
    for word in map(re.escape, words):
        without = re.sub(rf"[\[(]\s*{word}\s*[\])]", "", bare)
        bare = re.sub(rf"(?:^|[\s_\-.,:/]+){word}(?![^\W\d_])", "", bare) if without == bare else without
    return BRANCH_OF[words[0].lower()], " ".join(bare.split()).strip(" _-.,:/")


def has_repeated_names(names: Sequence[str]) -> bool:
    """Return True if every name stands there twice, in the same order: T, R, T, R."""
    half = len(names) // 2
    return len(names) >= 4 and list(names[:half]) == list(names[half:]) and all(names)


def _direction(degC: Array) -> str:
    """Return 'heating' if a branch's temperature is higher at its end than at its begin, else 'cooling'."""
    finite = degC[np.isfinite(degC)]
    part = max(1, int(END_SHARE * finite.size))
    rises = finite.size > 1 and float(np.mean(finite[-part:])) > float(np.mean(finite[:part]))
    return "heating" if rises else "cooling"


def stack_branch_columns(table: Table, asked: bool) -> Table:
    """Return the table with branches that stand side by side below each other; other tables as they are.

    asked: the user said that there are branches; of names that stand twice the first is heating's then.
    """
    pairs = _branch_columns(table, asked)
    meanings = {base: interpret_name(base, table.columns[k].unit).ours for base, (k, _) in pairs.items()}
    temperature = next((base for base, ours in meanings.items() if ours == "temperature_degC"), None)
    timed = next((base for base, ours in meanings.items() if ours == "time_s"), None)
    alone = [k for k in range(len(table.columns)) if all(k not in both for both in pairs.values())]
    if any(table.columns[k].meaning.ours == "time_s" for k in alone):
        return table
    _refuse_different_units(table, pairs)
    if temperature is None or len(pairs) < 2:
        return table
    try:
        rows, senses = _stacked_rows(table, pairs, temperature, timed)
        if not rows:
            return table
        columns, shifted = [], False
        for base, both in pairs.items():
            first, second = (
                table.columns[both[sense == "cooling"]].select(part) for sense, part in zip(senses, rows, strict=True)
            )
            unit = first.unit or second.unit
            if base == timed:
                before, after = (each.numbers(table.decimal).values for each in (first, second))
                shift_s = _time_shift(before, after)
                columns.append(Column(base, np.concatenate([before, after + shift_s]), unit))
                shifted = shift_s != 0.0
            elif first.texts is not None and second.texts is not None:
                columns.append(Column(base, [*first.texts, *second.texts], unit))
            else:
                columns.append(
                    Column(base, np.concatenate([np.asarray(each.fields) for each in (first, second)]), unit)
                )
    except ValueError:  # dates, or words
        return table
    both_rows = [*rows[0], *rows[1]]
    if timed is None:
        columns.append(Column("time_s", np.arange(len(both_rows), dtype=np.float64)))
    of_times = "; no times, so no rates" if timed is None else "; its times shifted behind the first" * shifted
    notes = [*table.notes, f"branches side by side taken one after the other, {senses[0]} first{of_times}"]
    names = table.shown_names()
    notes += [f"left out: {', '.join(repr(names[k]) for k in alone)}"] if alone else []
    lines = [table.line_of[k] for k in both_rows]
    return replace(table, columns=columns, line_of=lines, notes=notes, times="file" if timed else "rows")


def _branch_columns(table: Table, asked: bool) -> dict[str, tuple[int, int]]:
    """Return the heating and the cooling column of each quantity that has both, by the name without the branch."""
    found: dict[str, dict[str, int]] = {}
    for k, column in enumerate(table.columns):
        sense, base = branch_in_name(column.name)
        if sense:
            found.setdefault(base, {}).setdefault(sense, k)
    pairs = {base: (both["heating"], both["cooling"]) for base, both in found.items() if len(both) == 2}
    if not pairs and asked:
        names = [column.name for column in table.columns]
        twice = [name for name in dict.fromkeys(names) if name and names.count(name) == 2]
        pairs = {name: (names.index(name), len(names) - 1 - names[::-1].index(name)) for name in twice}
    shared = [k for k, column in enumerate(table.columns) if column.meaning.ours == "temperature_degC"]
    paired = [interpret_name(base, table.columns[k].unit).ours for base, (k, _) in pairs.items()]
    if len(shared) == 1 and paired == ["resistance_ohm"]:  # one column of temperatures for both branches
        pairs[table.columns[shared[0]].name] = shared[0], shared[0]
    return pairs


def _stacked_rows(
    table: Table, pairs: dict[str, tuple[int, int]], temperature: str, timed: str | None
) -> tuple[list[list[int]], list[str]]:
    """Return the rows of each branch in the order of time, and which comes first; no rows if a branch is too short.
    Raises ValueError."""
    senses = ["heating", "cooling"]
    if timed:
        columns = [table.columns[k] for k in pairs[timed]]
        begins = [_first_number(column.select(np.flatnonzero(column.filled())), table) for column in columns]
        if begins[1] < begins[0]:
            senses.reverse()
    rows: list[list[int]] = []
    for sense in senses:
        columns = [table.columns[both[sense == "cooling"]] for both in pairs.values()]
        own = np.flatnonzero(np.logical_or.reduce([column.filled() for column in columns])).tolist()
        degC = table.columns[pairs[temperature][sense == "cooling"]].select(own).numbers(table.decimal).values
        if len(own) < FEWEST_ROWS:
            return [], senses
        rows.append(own if timed or _direction(degC) == sense else own[::-1])
    return rows, senses


def _first_number(column: Column, table: Table) -> float:
    try:
        values = column.numbers(table.decimal).values
    except ValueError:
        return math.nan
    return float(values[0]) if values.size else math.nan


def _refuse_different_units(table: Table, pairs: dict[str, tuple[int, int]]) -> None:
    """Raise Faults if a quantity's two columns are in different units, by their names or the line of units."""
    both = [(table.columns[warm], table.columns[cold], base, base) for base, (warm, cold) in pairs.items()]
    for column in table.columns:
        sense, base = branch_in_name(column.name)
        ours = interpret_name(base, column.unit).ours if sense == "heating" and base not in pairs else None
        for other in table.columns if ours is not None else ():
            back, named = branch_in_name(other.name)
            if back == "cooling" and interpret_name(named, other.unit).ours == ours:
                both.append((column, other, base, named))
    if len(both) < 2 or not any(interpret_name(base, c.unit).ours == "temperature_degC" for c, _, base, _ in both):
        return
    for warm, cold, base, named in both:
        units = [interpret_name(name, c.unit).unit or c.unit for name, c in ((base, warm), (named, cold))]
        if all(units) and units[0] != units[1]:
            text = f"{warm.name!r} is in {units[0]}, {cold.name!r} in {units[1]}: heating and cooling side by side?"
            expected = "expected both in the same unit, or columns by their numbers"
            raise fault(table.source, table.place, f"{text} {expected}")


def _time_shift(first: Array, second: Array) -> float:
    """Return what to add to the second branch's times, s, so that they follow the first; 0 if they do already."""
    step = float(np.median(np.diff(first)))
    return float(first[-1]) + step - float(second[0]) if second[0] <= first[-1] else 0.0


def order_branch_rows(table: Table) -> Table:
    """Return the table with the rows of each branch in the order of time, if a column names the branch of each row and
    no column has times; other tables, and those with several loops, as they are."""
    meanings = [column.meaning.ours for column in table.columns]
    named = next((k for k, column in enumerate(table.columns) if _names_branches(column)), None)
    if named is None or "time_s" in meanings or meanings.count("temperature_degC") != 1:
        return table
    senses = [branch_in_name(text)[0] for text in table.columns[named].texts or []]
    second = next(k for k, sense in enumerate(senses) if sense != senses[0])
    try:
        degC = table.columns[meanings.index("temperature_degC")].numbers(table.decimal).values
    except ValueError:
        return table
    if len(set(senses[second:])) > 1:
        return table
    rows: list[int] = []
    for part in (range(second), range(second, len(senses))):
        rows += part if _direction(degC[list(part)]) == senses[part[0]] else part[::-1]
    ordered = table.select(rows)
    time = Column("time_s", np.arange(len(rows), dtype=np.float64))
    text = f"rows in the order of the branches in {table.shown_names()[named]!r}; no times, so no rates"
    return replace(ordered, columns=[*ordered.columns, time], notes=[*table.notes, text], times="rows")


def _names_branches(column: Column) -> bool:
    if not column.texts or not branch_in_name(column.texts[0])[0]:
        return False
    words = set(column.texts)
    return len(words) <= MOST_WORDS and {branch_in_name(word)[0] for word in words} == {"heating", "cooling"}


def reverse_second_branch(record: Record, order: RowOrder) -> Record:
    """Return a record without times whose temperature jumps back once, from the end of a branch to the begin of the
    other, with its second branch reversed. Raises Faults if the user did not say that it has branches."""
    degC = record.columns.get("temperature_degC", np.empty(0))
    read = np.flatnonzero(np.isfinite(degC))
    if record.times == "file" or read.size < 4 * FEWEST_ROWS:
        return record
    neighbours = np.pad(degC[read], 1, mode="edge")  # a single reading that is far off is no jump
    smooth = np.median([neighbours[:-2], neighbours[1:-1], neighbours[2:]], axis=0)
    steps = np.abs(np.diff(smooth)) / max(float(np.ptp(smooth)), 1e-300)
    k = int(np.argmax(steps))
    once = steps[k] >= JUMP and np.partition(steps, -2)[-2] < 0.5 * steps[k]
    if not once or _direction(smooth[: k + 1]) != _direction(smooth[k + 1 :]):
        return record
    second = int(read[k + 1])
    if not order.branches:
        jump = f"temperature_degC: from {smooth[k]:.1f} to {smooth[k + 1]:.1f} degC in one row"
        expected = "expected --branches (the second is reversed), or a file for each sweep"
        raise fault(record.source, f"row {second + 1}", f"{jump}: two branches, sorted the same way? {expected}")
    note = f"two branches, the second from row {second + 1} on reversed"
    rows = np.concatenate([np.arange(second), np.arange(second, degC.size)[::-1]])
    return replace(record.reordered(rows), notes=(*record.notes, note))


def join_branches(found: Sequence[Kind], order: RowOrder) -> list[Kind]:
    """Return records with the two branches of a loop joined to one; refused files stay in their place.

    Two records are branches of a loop if their file names differ in 'heating' and 'cooling' only, and they have no
    times or the user said that there are branches. Raises Faults.
    """
    records = [one for one in found if isinstance(one, Record)]
    named: dict[str, dict[str, Record]] = {}
    for record in records:
        sense, base = branch_in_name(Path(record.source).stem)
        if sense and (record.times != "file" or order.branches):
            named.setdefault(str(Path(record.source).with_name(base or "loop")), {}).setdefault(sense, record)
    pairs = [tuple(both.values()) for both in named.values() if len(both) == 2]
    single = [record for record in records if not _is_loop(record)]
    if order.branches and not pairs and len(found) == len(records) > 1 and single:
        of = ", ".join(record.source for record in records)
        senses = {branch_in_name(Path(record.source).stem)[0] for record in records}
        if len(records) == 2 and senses in ({"heating"}, {"cooling"}):
            raise fault("--branches", of, f"both names say {senses.pop()}; expected one of heating and one of cooling")
        if len(records) == len(single) == 2:
            pairs = [(single[0], single[1])]
        elif any(record.times == "file" for record in single):
            text = "expected two files, of heating and of cooling, or names of columns that say which is which"
            raise fault("--branches", of, text)
    joined: list[Kind] = []
    for one in found:
        pair = next((pair for pair in pairs if any(one is each for each in pair)), None)
        if isinstance(one, Refused):
            joined.append(one)
        elif pair is None:
            joined.append(one if order.reversed else _in_time(one, branch_in_name(Path(one.source).stem)[0]))  # type: ignore[arg-type]
        elif one is pair[0]:
            joined.append(_join(pair[0], pair[1]))  # type: ignore[arg-type]
    return joined


def _in_time(record: Record, sense: str) -> Record:
    """Return a branch without times in the order in which it was taken, as its name says."""
    if not sense or record.times == "file" or _is_loop(record) or _direction(record["temperature_degC"]) == sense:
        return record
    note = f"its name says {sense}, and its rows go the other way: they are reversed"
    return replace(record.reordered(np.arange(record.rows)[::-1]), notes=(*record.notes, note))


def _is_loop(record: Record) -> bool:
    """Return True if the temperature goes there and back again."""
    degC = record.columns.get("temperature_degC", np.empty(0))
    finite = degC[np.isfinite(degC)]
    return abs(float(finite[-1] - finite[0])) < 0.5 * float(np.ptp(finite)) if finite.size else True


def _join(one: Record, other: Record) -> Record:
    """Return both branches in one record, each in the direction of its name, the second behind the first."""
    senses = [branch_in_name(Path(record.source).stem)[0] for record in (one, other)]
    if not any(senses):
        senses[0] = _direction(one["temperature_degC"])
    senses = [senses[0] or OTHER_BRANCH[senses[1]], senses[1] or OTHER_BRANCH[senses[0]]]
    first, second = (_in_time(record, sense) for record, sense in zip((one, other), senses, strict=True))
    if second["time_s"][-1] < first["time_s"][0]:
        first, second = second, first
    shift_s = _time_shift(first["time_s"], second["time_s"])
    shifted = ", its times shifted behind" * (shift_s != 0.0) if one.times == "file" else "; no times, so no rates"
    note = f"joined with {second.source} as the branches of one loop{shifted}"
    return replace(
        first.followed_by(second, shift_s),
        source=f"{first.source} + {Path(second.source).name}",
        notes=tuple(dict.fromkeys([note, *first.notes, *second.notes])),
    )
