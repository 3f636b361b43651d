"""The heating and the cooling branch of a loop, put one behind the other in the order in which they were taken.

Tables of published loops have no times. Their branches stand side by side in columns, below each other with a word
for each row's branch, or in two files. Each branch is read as a record, in its own units, and the two are joined.
The name of a branch says which way its rows go in time: of a cooling branch that is sorted upwards the last row was the
first.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from compensator.hysteresis.functions import Array
from rig.core.faults import fault
from rig.records.record import Record, Refused, without_false_readings
from rig.records.table import Column, Table

HEATING = "heating heat heated warm warming warmup up upward rising increasing erwärmen aufheizen heizen chauffage"
COOLING = "cooling cool cooled cooldown down downward downwards falling decreasing abkühlen kühlen refroidissement"
BRANCH_OF = {**dict.fromkeys(HEATING.split(), "heating"), **dict.fromkeys(COOLING.split(), "cooling")}
SENSES = ("heating", "cooling")
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


def split_branches(table: Table, asked: bool) -> dict[str, Table]:
    """Return a table for each branch, by its sense; {"": table} if the table has no branches, or has times that both
    share. asked: the user said that there are branches; of names that stand twice the first is heating's then."""
    parts = _columns_of_branches(table, asked) or _rows_of_branches(table)
    if len(parts) < 2 or any(len(part.line_of) < FEWEST_ROWS for part in parts.values()):
        return {"": table}
    return parts


def _columns_of_branches(table: Table, asked: bool) -> dict[str, Table]:
    named = [branch_in_name(column.name) for column in table.columns]
    if asked and has_repeated_names([column.name for column in table.columns]):
        half = len(named) // 2
        named = [(SENSES[k >= half], name) for k, (_, name) in enumerate(named)]
    halves = {
        sense: [replace(c, name=base) for c, (own, base) in zip(table.columns, named, strict=True) if own == sense]
        for sense in SENSES
    }
    shared = [column for column, (sense, _) in zip(table.columns, named, strict=True) if not sense]
    meanings = {sense: {column.meaning.ours for column in half} for sense, half in halves.items()}
    degC = [column for column in shared if column.meaning.ours == "temperature_degC"]
    if len(degC) == 1 and all(ours == {"resistance_ohm"} for ours in meanings.values()):
        halves = {sense: [degC[0], *half] for sense, half in halves.items()}  # one column of temperatures for both
        shared.remove(degC[0])
    elif not all("temperature_degC" in ours and len(ours) > 1 for ours in meanings.values()):
        return {}
    if any(column.meaning.ours == "time_s" for column in shared):
        return {}
    left = ", ".join(repr(column.name) for column in shared)
    notes = [*table.notes, *([f"left out: {left}"] if left else [])]
    filled = {
        sense: np.flatnonzero(np.logical_or.reduce([column.filled() for column in half if column not in degC]))
        for sense, half in halves.items()
    }
    return {
        sense: _in_rows(replace(table, columns=half, notes=notes).select(filled[sense]))
        for sense, half in halves.items()
    }


def _rows_of_branches(table: Table) -> dict[str, Table]:
    """Return the tables of branches that stand below each other, if a column names the branch of each row and no column
    has times. Several loops stay as they are."""
    meanings = [column.meaning.ours for column in table.columns]

    def names_branches(texts: list[str]) -> bool:
        words = set(texts) if texts and branch_in_name(texts[0])[0] else set()
        return 0 < len(words) <= MOST_WORDS and {branch_in_name(word)[0] for word in words} == set(SENSES)

    words = next(filter(names_branches, (column.texts or [] for column in table.columns)), [])
    if not words or "time_s" in meanings or meanings.count("temperature_degC") != 1:
        return {}
    senses = [branch_in_name(word)[0] for word in words]
    second = next(k for k, sense in enumerate(senses) if sense != senses[0])
    if len(set(senses[second:])) > 1:
        return {}
    rows = {senses[0]: range(second), senses[second]: range(second, len(senses))}
    return {sense: _in_rows(table.select(part)) for sense, part in rows.items()}


def _in_rows(table: Table) -> Table:
    """Return the table of a branch with the numbers of its rows as times, if it has none."""
    if any(column.meaning.ours == "time_s" for column in table.columns):
        return table
    rows = Column("time_s", np.arange(len(table.line_of), dtype=np.float64))
    return replace(table, columns=[*table.columns, rows], times="rows")


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
    return _reordered(record, np.concatenate([np.arange(second), np.arange(second, degC.size)[::-1]]), note)


def join_branches(found: Sequence[Kind], order: RowOrder) -> list[Kind]:
    """Return records with the two branches of a loop joined to one; refused files stay in their place.

    Two records are branches of a loop if their file names differ in 'heating' and 'cooling' only, and they have no
    times or the user said that there are branches. Raises Faults.
    """
    records: list[Record] = [one for one in found if isinstance(one, Record)]
    senses = {id(record): branch_in_name(Path(record.source).stem)[0] for record in records}
    named: dict[Path, dict[str, Record]] = {}
    for record in records:
        sense, base = branch_in_name(Path(record.source).stem)
        if sense and (record.times != "file" or order.branches):
            named.setdefault(Path(record.source).with_name(base or "loop"), {}).setdefault(sense, record)
    pairs: list[list[Record]] = [list(both.values()) for both in named.values() if len(both) == 2]
    single = [record for record in records if not _is_loop(record)]
    if order.branches and not pairs and len(found) == len(records) > 1 and single:
        if len(single) == len(records) == 2 and set(senses.values()) not in ({"heating"}, {"cooling"}):
            pairs = [single]
        elif len(records) == 2 or any(record.times == "file" for record in single):
            text = "expected one of heating and one of cooling, or names of columns that say which is which"
            raise fault("--branches", ", ".join(record.source for record in records), text)
    joined: list[Any] = []
    for one in found:
        pair = next((pair for pair in pairs if any(one is each for each in pair)), None)
        if not isinstance(one, Record):
            joined.append(one)
        elif pair is None:
            joined.append(one if order.reversed else _in_time(one, senses[id(one)]))
        elif one is pair[0]:
            joined.append(join_loop(pair, [senses[id(record)] for record in pair]))
    return joined


def join_loop(branches: Sequence[Record], senses: Sequence[str]) -> Record:
    """Return two branches in one record, each in the direction of its sense ('' if that is not known), the second
    behind the first. The one that was taken first is first if both have times."""
    one, other = senses
    if not one and not other:
        one = _direction(branches[0]["temperature_degC"])
    one, other = (own or SENSES[SENSES.index(of) - 1] for own, of in ((one, other), (other, one)))
    first, second = _in_time(branches[0], one), _in_time(branches[1], other)
    if second["time_s"][-1] < first["time_s"][0]:
        first, second, one = second, first, other
    begin, end = float(second["time_s"][0]), float(first["time_s"][-1])
    shift_s = end + float(np.median(np.diff(first["time_s"]))) - begin if begin <= end else 0.0
    shifted = "; its times shifted behind the first" * (shift_s != 0.0)
    timed = shifted if first.times == "file" else "; no times, so no rates"
    note = f"branches of a loop taken one after the other, {one} first{timed}"
    columns, others = first.raw_columns(), dict(second.raw_columns())
    others |= {name: values + shift_s for name, values in others.items() if f"_{name}".endswith("_time_s")}
    both = [name for name in first.text_columns if name in second.text_columns]
    files = dict.fromkeys([first.source, second.source])
    return without_false_readings(
        replace(
            first,
            columns={name: np.concatenate([columns[name], others[name]]) for name in columns if name in others},
            text_columns={name: [*first.text_columns[name], *second.text_columns[name]] for name in both},
            raw_temperature_degC=None,
            source=" + ".join([first.source, *(Path(name).name for name in list(files)[1:])]),
            notes=tuple(dict.fromkeys([*first.notes, *second.notes, note])),
        )
    )


def _in_time(record: Record, sense: str) -> Record:
    """Return a branch without times in the order in which it was taken, as its name says."""
    if not sense or record.times == "file" or _is_loop(record) or _direction(record["temperature_degC"]) == sense:
        return record
    note = f"its name says {sense}, and its rows go the other way: they are reversed"
    return _reordered(record, np.arange(record.rows)[::-1], note)


def _reordered(record: Record, rows: NDArray[np.intp], note: str) -> Record:
    """Return a record with its rows in another order; the times stay as they are."""
    columns = record.raw_columns()
    return without_false_readings(
        replace(
            record,
            columns={name: values if name == "time_s" else values[rows] for name, values in columns.items()},
            text_columns={name: [values[k] for k in rows] for name, values in record.text_columns.items()},
            raw_temperature_degC=None,
            notes=(*record.notes, note),
        )
    )


def _direction(degC: Array) -> str:
    """Return 'heating' if a branch's temperature is higher at its end than at its begin, else 'cooling'."""
    finite = degC[np.isfinite(degC)]
    part = max(1, int(END_SHARE * finite.size))
    rises = finite.size > 1 and float(np.mean(finite[-part:])) > float(np.mean(finite[:part]))
    return "heating" if rises else "cooling"


def _is_loop(record: Record) -> bool:
    """Return True if the temperature goes there and back again."""
    degC = record.columns.get("temperature_degC", np.empty(0))
    finite = degC[np.isfinite(degC)]
    return abs(float(finite[-1] - finite[0])) < 0.5 * float(np.ptp(finite)) if finite.size else True
