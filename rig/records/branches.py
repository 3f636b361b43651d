"""The two branches of a loop, heating and cooling, where they stand side by side or in two files: one after the other.

Tables of published loops have no times. Which way the rows of a branch go in time its name says: of a cooling branch
that is sorted upwards the last row was the first.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from compensator.hysteresis.functions import Array
from rig.core.faults import fault
from rig.records.column_names import meaning_of
from rig.records.numbers import read_numbers
from rig.records.record import Record, Refused
from rig.records.table import Column, Table

HEATING = "heating heat heated warm warming warmup up upward rising increasing erwärmen aufheizen heizen chauffage"
COOLING = "cooling cool cooled cooldown down downward downwards falling decreasing abkühlen kühlen refroidissement"
SENSE = {**dict.fromkeys(HEATING.split(), "heating"), **dict.fromkeys(COOLING.split(), "cooling")}
ENDS = 0.1  # of the rows: their means at both ends tell which way a branch goes
FEWEST_ROWS = 3  # of a branch
A_JUMP = 0.5  # of the range, in one row: a branch that begins where the other one did
MOST_WORDS = 8  # that a column may have that says heating or cooling
Kind = TypeVar("Kind", bound=Record | Refused)


@dataclass(frozen=True)
class Rows:
    """What somebody says of a file's rows. period_s: how far apart they are, where the file has no times. turned: the
    last was taken first. branches: heating and cooling stand side by side, or in two files."""

    period_s: float | None = None
    turned: bool = False
    branches: bool = False


def sense_in(name: str) -> tuple[str, str]:
    """'heating', 'cooling' or '', as a word of a name says, and the name without such words."""
    words = [word for word in re.findall(r"[^\W\d_]+", name) if word.lower() in SENSE]
    if len({SENSE[word.lower()] for word in words}) != 1:
        return "", name
    bare = name
    for word in map(re.escape, words):
        without = re.sub(rf"[\[(]\s*{word}\s*[\])]", "", bare)
        bare = re.sub(rf"(?:^|[\s_\-.,:/]+){word}(?![^\W\d_])", "", bare) if without == bare else without
    return SENSE[words[0].lower()], " ".join(bare.split()).strip(" _-.,:/")


def rises(values: Array) -> bool:
    """Whether a branch's temperature is higher at its end than at its begin."""
    finite = values[np.isfinite(values)]
    part = max(1, int(ENDS * finite.size))
    return finite.size > 1 and float(np.mean(finite[-part:])) > float(np.mean(finite[:part]))


def one_after_the_other(table: Table, asked: bool) -> Table:
    """The table with its branches below each other, where it has them side by side; else the same. asked: somebody said
    that it has, so that names that stand twice are those of heating and of cooling."""
    pairs = _pairs(table, asked)
    _share_temperature(table, pairs)
    meanings = {base: meaning_of(base, table.columns[k].unit) for base, (k, _) in pairs.items()}
    degrees = next((base for base, meaning in meanings.items() if meaning.ours == "temperature_degC"), None)
    paired = {k for both in pairs.values() for k in both}
    alone = [k for k in range(len(table.columns)) if k not in paired]
    common = [k for k in alone if meaning_of(table.columns[k].name, table.columns[k].unit).ours == "time_s"]
    timed = next((base for base, meaning in meanings.items() if meaning.ours == "time_s"), None)
    if not common:
        _refuse_other_units(table, pairs)
    if degrees is None or len(pairs) < 2 or common:
        return table
    rows: list[int] = []
    senses = ["heating", "cooling"]
    if timed:
        begins = [_first_time(table, table.columns[k]) for k in pairs[timed]]
        if begins[1] < begins[0]:
            senses.reverse()
            pairs = {base: (cold, warm) for base, (warm, cold) in pairs.items()}
    for number, sense in enumerate(senses):
        filled = np.logical_or.reduce([table.columns[both[number]].filled() for both in pairs.values()])
        own = [int(k) for k in np.flatnonzero(filled)]
        try:
            values = _numbers_of(table.columns[pairs[degrees][number]].of(own), table)
        except ValueError:
            return table
        if len(own) < FEWEST_ROWS:
            return table
        rows += own if timed or rises(values) == (sense == "heating") else own[::-1]
        if not number:
            first = len(rows)
    columns, behind = [], False
    for base, both in pairs.items():
        parts = table.columns[both[0]].of(rows[:first]), table.columns[both[1]].of(rows[first:])
        unit = parts[0].unit or parts[1].unit
        texts = [part.texts for part in parts]
        if base == timed:
            try:
                before, after = (_numbers_of(part, table) for part in parts)
                later = _later(before, after)
                numbers, behind = np.concatenate([before, after + later]), later != 0.0
            except ValueError:  # dates, or words
                return table
            columns.append(Column(base, numbers, unit))
        elif texts[0] is not None and texts[1] is not None:
            columns.append(Column(base, [*texts[0], *texts[1]], unit))
        else:
            numbers = np.concatenate([np.asarray(part.fields) for part in parts])
            columns.append(Column(base, numbers, unit))
    if timed is None:
        columns.append(Column("time_s", np.arange(len(rows), dtype=np.float64)))
    left = [table.columns[k].name or f"#{k + 1}" for k in alone]
    of_times = "; no times, so no rates" if timed is None else "; its times put behind the first" * behind
    said = [*table.said, f"branches side by side taken one after the other, {senses[0]} first{of_times}"]
    said += [f"left: {', '.join(map(repr, left))}"] if left else []
    times = "rows" if timed is None else "file"
    return replace(table, columns=columns, line_of=[table.line_of[k] for k in rows], said=said, times=times)


def _refuse_other_units(table: Table, pairs: dict[str, tuple[int, int]]) -> None:
    """Raises Faults where a quantity's two columns are in different units, by the line of units or by their names."""
    both = [(table.columns[warm], table.columns[cold], base, base) for base, (warm, cold) in pairs.items()]
    for column in table.columns:
        sense, base = sense_in(column.name)
        if sense == "heating" and base not in pairs:
            ours = meaning_of(base, column.unit).ours
            for other in table.columns:
                back, named = sense_in(other.name)
                if back == "cooling" and ours is not None and meaning_of(named, other.unit).ours == ours:
                    both.append((column, other, base, named))
    if len(both) < 2 or not any(meaning_of(base, c.unit).ours == "temperature_degC" for c, _, base, _ in both):
        return
    for warm, cold, base, named in both:
        units = [meaning_of(name, c.unit).unit or c.unit for name, c in ((base, warm), (named, cold))]
        if all(units) and units[0] != units[1]:
            text = f"{warm.name!r} is in {units[0]}, {cold.name!r} in {units[1]}: heating and cooling side by side?"
            expected = "expected both in the same unit, or columns by their numbers"
            raise fault(table.source, table.place, f"{text} {expected}")


def _first_time(table: Table, column: Column) -> float:
    """The first time of a branch; nan where it is no number."""
    try:
        values = _numbers_of(column.of(np.flatnonzero(column.filled())), table)
    except ValueError:
        return math.nan
    return float(values[0]) if values.size else math.nan


def _numbers_of(column: Column, table: Table) -> Array:
    """A column's numbers. Raises ValueError."""
    if column.texts is None:
        return np.asarray(column.fields, dtype=np.float64)
    return read_numbers(column.texts, table.signs).values


def _later(first: Array, second: Array) -> float:
    """By how much the second branch's times are later than they say, s: not at all where they go on."""
    step = float(np.median(np.diff(first)))
    return float(first[-1]) + step - float(second[0]) if second[0] <= first[-1] else 0.0


def below_each_other(table: Table) -> Table:
    """The table with the rows of each branch in the order of time, where a column says which is which and no column has
    times: heating rises. The same where it has no such column, or both come more than once."""
    meanings = [meaning_of(column.name, column.unit).ours for column in table.columns]
    named = next((k for k, column in enumerate(table.columns) if _names_branches(column)), None)
    if named is None or "time_s" in meanings or meanings.count("temperature_degC") != 1:
        return table
    senses = [sense_in(text)[0] for text in table.columns[named].texts or []]
    try:
        degC = _numbers_of(table.columns[meanings.index("temperature_degC")], table)
    except ValueError:
        return table
    second = next(k for k, sense in enumerate(senses) if sense != senses[0])
    if len(set(senses[second:])) > 1:
        return table
    rows: list[int] = []
    for part in (range(second), range(second, len(senses))):
        rows += part if rises(degC[list(part)]) == (senses[part[0]] == "heating") else part[::-1]
    time = Column("time_s", np.arange(len(rows), dtype=np.float64))
    said = [*table.said, f"rows in the order of the branches in {table.names()[named]!r}; no times, so no rates"]
    ordered = table.of(rows)
    return replace(ordered, columns=[*ordered.columns, time], said=said, times="rows")


def _names_branches(column: Column) -> bool:
    """Whether each field says heating or cooling, and both are said."""
    if not column.texts or not sense_in(column.texts[0])[0]:
        return False
    words = set(column.texts)
    senses = {sense_in(word)[0] for word in words} if len(words) <= MOST_WORDS else set()
    return senses == {"heating", "cooling"}


def in_sequence(record: Record, rows: Rows) -> Record:
    """A record without times whose temperature jumps back once, from one branch's end to the other's begin: where
    somebody said that it has branches, with the second turned round. Raises Faults where nobody did."""
    degC = record.columns.get("temperature_degC", np.empty(0))
    read = np.flatnonzero(np.isfinite(degC))
    if record.times == "file" or read.size < 4 * FEWEST_ROWS:
        return record
    neighbours = np.pad(degC[read], 1, mode="edge")  # a single reading that is far off is no jump
    seen = np.median([neighbours[:-2], neighbours[1:-1], neighbours[2:]], axis=0)
    steps = np.abs(np.diff(seen)) / max(float(np.ptp(seen)), 1e-300)
    k = int(np.argmax(steps))
    once = steps[k] >= A_JUMP and np.partition(steps, -2)[-2] < 0.5 * steps[k]
    if not once or rises(seen[: k + 1]) != rises(seen[k + 1 :]):
        return record
    second = int(read[k + 1])
    if not rows.branches:
        text = f"temperature_degC: from {seen[k]:.1f} to {seen[k + 1]:.1f} degC in one row: two branches, sorted alike?"
        expected = "expected --branches (the second is turned round), or a file for each sweep"
        raise fault(record.source, f"row {second + 1}", f"{text} {expected}")
    said = f"two branches, the second from row {second + 1} on turned round"
    order = np.concatenate([np.arange(second), np.arange(second, degC.size)[::-1]])
    return replace(record.of_rows(order), said=(*record.said, said))


def _pairs(table: Table, asked: bool) -> dict[str, tuple[int, int]]:
    """Of each quantity that there is of both branches: the name without its branch, and both columns, heating first."""
    found: dict[str, dict[str, int]] = {}
    for k, column in enumerate(table.columns):
        sense, base = sense_in(column.name)
        if sense:
            found.setdefault(base, {}).setdefault(sense, k)
    pairs = {base: (both["heating"], both["cooling"]) for base, both in found.items() if len(both) == 2}
    if pairs or not asked:
        return pairs
    names = [column.name for column in table.columns]
    twice = [name for name in dict.fromkeys(names) if name and names.count(name) == 2]
    return {name: (names.index(name), len(names) - 1 - names[::-1].index(name)) for name in twice}


def _share_temperature(table: Table, pairs: dict[str, tuple[int, int]]) -> None:
    """One column of temperatures, where that is all there is beside a resistance of each branch: it is both's."""
    meanings = [meaning_of(column.name, column.unit).ours for column in table.columns]
    alone = [k for k, ours in enumerate(meanings) if ours == "temperature_degC"]
    paired = [meaning_of(base, table.columns[k].unit).ours for base, (k, _) in pairs.items()]
    if len(alone) == 1 and paired == ["resistance_ohm"]:
        pairs[table.columns[alone[0]].name] = alone[0], alone[0]


def names_twice(names: Sequence[str]) -> bool:
    """Whether every name stands there twice, in the same order: T, R, T, R."""
    half = len(names) // 2
    return len(names) >= 4 and list(names[:half]) == list(names[half:]) and all(names)


def loops(found: Sequence[Kind], rows: Rows) -> list[Kind]:
    """Records, those of a loop's two branches joined to one; what was refused stays in its place. They are that where
    their names say heating and cooling and are alike beside that, and have no times, or `rows.branches` says so. Raises
    Faults."""
    records = [one for one in found if isinstance(one, Record)]
    named: dict[str, dict[str, Record]] = {}
    for record in records:
        sense, base = sense_in(Path(record.source).stem)
        if sense and (record.times != "file" or rows.branches):
            named.setdefault(str(Path(record.source).with_name(base or "loop")), {}).setdefault(sense, record)
    pairs = [tuple(both.values()) for both in named.values() if len(both) == 2]
    single = [record for record in records if not _loop(record.columns.get("temperature_degC", np.empty(0)))]
    if rows.branches and not pairs and len(found) == len(records) > 1 and single:
        of = ", ".join(record.source for record in records)
        senses = {sense_in(Path(record.source).stem)[0] for record in records}
        if len(records) == 2 and senses in ({"heating"}, {"cooling"}):
            raise fault("--branches", of, f"both names say {senses.pop()}; expected one of heating and one of cooling")
        if len(records) == len(single) == 2:
            pairs = [(single[0], single[1])]
        elif any(record.times == "file" for record in single):
            text = "expected two files, of heating and of cooling, or names of columns that say which is which"
            raise fault("--branches", of, text)
    joined: list[Any] = []
    for one in found:
        pair = next((pair for pair in pairs if any(one is each for each in pair)), None)
        if isinstance(one, Refused):
            joined.append(one)
        elif pair is None:
            joined.append(one if rows.turned else _in_its_sense(one, sense_in(Path(one.source).stem)[0]))
        elif one is pair[0]:
            joined.append(_joined(pair[0], pair[1]))
    return joined


def _in_its_sense(record: Record, sense: str) -> Record:
    """A branch without times in the order in which it was taken, which the name says: heating rises."""
    degC = record.columns.get("temperature_degC", np.empty(0))
    if not sense or record.times == "file" or _loop(degC) or rises(degC) == (sense == "heating"):
        return record
    said = f"its name says {sense}, and its rows go the other way: the last is taken as the first"
    return replace(record.of_rows(np.arange(record.rows)[::-1]), said=(*record.said, said))


def _loop(values: Array) -> bool:
    """Whether a temperature goes there and back again."""
    finite = values[np.isfinite(values)]
    return abs(float(finite[-1] - finite[0])) < 0.5 * float(np.ptp(finite)) if finite.size else True


def _joined(one: Record, other: Record) -> Record:
    """Both branches in one record, in this order: each in the sense that its name says, or the second back again."""
    senses = [sense_in(Path(record.source).stem)[0] for record in (one, other)]
    back = {"heating": "cooling", "cooling": "heating"}
    if not any(senses):
        senses[0] = "heating" if rises(one["temperature_degC"]) else "cooling"
    senses = [senses[0] or back[senses[1]], senses[1] or back[senses[0]]]
    first, second = (_in_its_sense(record, sense) for record, sense in zip((one, other), senses, strict=True))
    if second["time_s"][-1] < first["time_s"][0]:
        first, second = second, first
    later = _later(first["time_s"], second["time_s"])
    said = f"joined with {second.source} as the branches of one loop"
    if one.times == "file":
        said += ", its times put behind" if later else ""
    else:
        said += "; no times, so no rates"
    return replace(
        first.followed_by(second, later),
        source=f"{first.source} + {Path(second.source).name}",
        said=tuple(dict.fromkeys([said, *first.said, *second.said])),
    )
