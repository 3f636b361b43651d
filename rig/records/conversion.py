"""From a file's table to a record: which column is taken for which of ours, what that is worth, what has to be asked.

What somebody typed with --column comes first, then our own names, then names that are plain
(`rig.records.column_names`). What was taken for what is told in a line. Where a column that is needed, or one that
looks as if it held the resistance, is not plain, the file is refused with the line to type.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from compensator.hysteresis.functions import Array
from rig.core.faults import Faults, fault
from rig.records.branches import Rows, below_each_other, in_sequence, one_after_the_other
from rig.records.column_choice import Choice, Taking, ask, take_own, take_plain, take_typed
from rig.records.column_names import ColumnMapping, ending_of, meaning_of, typed
from rig.records.long_table import one_row_each_moment
from rig.records.numbers import Undecided, beyond_as_a_number, number_of, read_numbers, tidied
from rig.records.plausibility import faults_in
from rig.records.record import Record
from rig.records.table import Column, Table
from rig.records.thermometer_faults import false_readings, without
from rig.records.times import PARTS, SUMMER, Unclear, clock_alone, date_alone, hours_off, read_times, time_like
from rig.records.units import CONDUCTANCES, LOGARITHMS, SHARES, UNITS

FEW_ROWS, MOST_STEPS_BACK = 20, 0.01  # rows, and how many of more of them may follow a clock that was set
LARGEST_STEP_BACK_S = 1.0  # what a clock that is kept right over the network is set back by


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
    if faults:
        raise Faults(faults)
    table, values, texts = _in_order(taking, values, texts)
    faults = faults_in(table, values, taking.chosen, taking.names)
    if faults:
        raise Faults(faults)
    current = taking.chosen.get("current_A")
    drive = current.unit if current is not None and current.unit in SHARES else None
    read, left_out = values.get("temperature_degC"), false_readings(values)
    if read is not None and left_out:
        values["temperature_degC"] = without(read, left_out)
    as_read = read if left_out else None
    return Record(values, table.source, drive, texts, tuple(_told(taking)), tuple(left_out), as_read, table.times)


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


def _in_order(
    taking: Taking, values: dict[str, Array], texts: dict[str, list[str]]
) -> tuple[Table, dict[str, Array], dict[str, list[str]]]:
    """Without the few rows that cannot be placed in time: doubled word for word, or written before a clock that was set
    back by less than a second came to where it had been. Raises Faults where a clock went back by an hour."""
    table, time = taking.table, values["time_s"]
    if np.all(np.diff(time) > 0.0) or not np.all(np.isfinite(time)):
        return table, values, texts
    _refuse_summer_time(taking, time)
    first = _first_alike(table)
    doubled = first < np.arange(time.size)
    if np.any(doubled):
        k, more = int(np.flatnonzero(doubled)[0]), int(np.sum(doubled)) - 1
        text = f"{table.at(k)}{f' and {more} more' if more else ''} left out, the same word for word as"
        taking.said.append(f"{text} {table.at(int(first[k]))}")
    kept = np.flatnonzero(~doubled)
    behind = time[kept] <= np.concatenate([[-np.inf], np.maximum.accumulate(time[kept])[:-1]])
    back = np.diff(time[kept])
    step, back = float(np.median(back)), back[back <= 0.0]
    few = kept.size > FEW_ROWS and back.size <= max(1.0, MOST_STEPS_BACK * kept.size)
    if back.size and few and np.min(back) > -LARGEST_STEP_BACK_S:
        rows = kept[behind]
        text = f"{table.at(int(rows[0]))}{f' and {rows.size - 1} more' if rows.size > 1 else ''} left out: the clock"
        taking.said.append(
            f"{text} {f'went back by {step - np.min(back):.3g} s' if np.min(back) < 0.0 else 'stood still'}"
        )
        kept = kept[~behind]
    if kept.size == time.size:
        return table, values, texts
    values = {name: column[kept] for name, column in values.items()}
    return table.of(kept), values, {name: [column[k] for k in kept] for name, column in texts.items()}


def _first_alike(table: Table) -> NDArray[np.intp]:
    """Of each row the first that is the same word for word."""
    seen: dict[tuple[object, ...], int] = {}
    rows = zip(*(column.fields for column in table.columns), strict=True)
    return np.array([seen.setdefault(row, k) for k, row in enumerate(rows)], dtype=np.intp)


def _refuse_summer_time(taking: Taking, time: Array) -> None:
    """A clock that goes back by an hour and on as before, in a column of dates."""
    choice = taking.chosen["time_s"]
    back = np.flatnonzero(hours_off(time) > 0.0)
    if back.size != 1 or not time_like(taking.first(choice.index)):
        return
    what = typed("time_s", taking.names, choice.index, f"{choice.layout}+{SUMMER}" if choice.layout else SUMMER)
    text = f"time_s: the clock went back by 1 h (end of summer time?); expected {what}"
    raise fault(taking.table.source, taking.table.at(int(back[0])), text)


def _ours(taking: Taking, ours: str, choice: Choice) -> Array:
    """One of our columns. Raises Faults: a field that is no number or no time."""
    table, ending = taking.table, ending_of(ours)
    if ours == "time_s" and time_like(taking.first(choice.index)):
        if choice.how == "typed" and choice.unit_said and choice.layout is None:
            expected = typed(ours, taking.names, choice.index)
            text = f"{ours}: {taking.first(choice.index)[:40]!r} is a date or a clock's time, and was typed as a number"
            raise fault(table.source, table.at(0), f"{text} in {choice.unit}; expected {expected}")
        return _times(taking, choice)
    if choice.layout is not None:
        text = f"{ours}: {taking.first(choice.index)[:40]!r} was typed as a date or a clock's time ({choice.layout})"
        raise fault(table.source, table.at(0), f"{text}; expected one, or a unit such as @s")
    try:
        numbers = taking.numbers(choice.index, ending)
    except Undecided as error:
        what = " expected --decimal , or --decimal ." if taking.flags else " expected decimals with a point"
        text = f"{ours}: {str(error)[:40]!r}: a comma or point before decimals, or between thousands?"
        raise fault(table.source, _place(taking, choice, str(error)), f"{text}{what}") from None
    except ValueError:
        raise Faults([_no_numbers(taking, ours, choice)]) from None
    taking.said += [f"in {ours} {text}" for text in numbers.said]
    values = numbers.values
    if ours == "time_s" and (parts := _parts_of_seconds(taking, values, [choice.index])) is not None:
        taking.said.append(f"time_s with {parts[1]!r}")
        values = parts[0]
    if numbers.ending is None and choice.unit != ending:
        values = np.asarray(UNITS[ending][choice.unit](values), dtype=np.float64)
    if ours == "resistance_ohm" and choice.unit not in LOGARITHMS and np.any(np.isneginf(values)):
        taking.said.append(f"in {ours} -inf as beyond the range ({int(np.sum(np.isneginf(values)))} rows)")
        values = np.where(np.isneginf(values), np.inf, values)
    endless = np.isinf(numbers.values)
    if np.any(endless):
        _refuse_endless(taking, ours, choice, endless)
        if ending in ("degC", "A"):  # of a resistance alone it says something
            taking.said.append(f"in {ours} what is beyond the range as no reading ({int(np.sum(endless))} rows)")
            values = np.where(endless, np.nan, values)
    if ours == "resistance_ohm" and choice.unit not in CONDUCTANCES:
        beyond = beyond_as_a_number(values)
        if np.any(beyond):
            largest, rows = float(np.max(values[beyond])), int(np.sum(beyond))
            taking.said.append(
                f"in resistance_ohm {largest:g} ohm, far above all else, as beyond the range ({rows} rows)"
            )
            values = np.where(beyond, np.inf, values)
    return values


def _refuse_endless(taking: Taking, ours: str, choice: Choice, endless: NDArray[np.bool_]) -> None:
    """Infinity is a reading beyond the range where it was written so, not where it has too many digits."""
    table, texts = taking.table, taking.table.columns[choice.index].texts
    rows = [int(k) for k in np.flatnonzero(endless)] if texts is not None else []
    wrong = [k for k in rows if texts is not None and sum(map(str.isdigit, texts[k])) > 2 and not _sentinel(texts[k])]
    if wrong and texts is not None:
        more = f" ({len(wrong)} such fields)" if len(wrong) > 1 else ""
        text = f"{ours}: {texts[wrong[0]][:24]!r}: expected a number that a double holds{more}"
        raise fault(table.source, table.at(wrong[0]), text)


def _sentinel(text: str) -> bool:
    return re.search(r"[eE]\+?0*3[78]\b", text) is not None


def _place(taking: Taking, choice: Choice, text: str) -> str:
    texts = taking.table.columns[choice.index].texts or []
    return taking.table.at(texts.index(text)) if text in texts else taking.table.place


def _no_numbers(taking: Taking, ours: str, choice: Choice) -> str:
    """The line about the first field that is no number, and how many more there are."""
    table, wrong = taking.table, []
    sign = table.signs.decimal or "."
    for row, text in enumerate(table.columns[choice.index].texts or []):
        try:
            read_numbers([text], table.signs, ending_of(ours))
        except Undecided:
            continue
        except ValueError:
            wrong.append((row, text))
    if not wrong:
        return f"{table.source}: {ours}: some fields have a unit and some have none; expected one way of writing"
    row, text = wrong[0]
    hint = " with a point" if sign == "." and _is_number(tidied(text), ",") else ""
    more = f" ({len(wrong)} such fields, to {table.at(wrong[-1][0])})" if len(wrong) > 1 else ""
    return f"{table.source}: {table.at(row)}: {ours}: {text[:40]!r}: expected a number{hint}{more}"


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
    layout, beside, clock = choice.layout, "", None
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
    missing = np.flatnonzero(hours_off(times.seconds) < 0.0)
    if missing.size == 1 and not (layout or "").endswith(SUMMER):
        what = typed("time_s", taking.names, k, f"{layout}+{SUMMER}" if layout else SUMMER)
        text = f"an hour is missing before {table.at(int(missing[0]))}: if summer time began there, {what}"
        taking.said.append(text)
    parts = _parts_of_seconds(taking, times.seconds, [each for each in (k, clock) if each is not None])
    taking.said.append(f"{times.said}{beside}{f' with {parts[1]!r}' if parts is not None else ''}")
    return times.seconds if parts is None else parts[0]


def _parts_of_seconds(taking: Taking, seconds: Array, indices: Sequence[int]) -> tuple[Array, str] | None:
    """Full seconds with what another column says of their fractions, and its name: milliseconds, as loggers write them,
    or 'Fractional Seconds'. It stands right behind the seconds, or is the only one of its kind."""
    if np.any(seconds % 1.0):
        return None
    parts = [k for k in taking.free() if taking.names[k].strip().lower() in PARTS]
    near = [k for k in parts if k - 1 in indices] or parts
    if len(near) != 1:
        return None
    name = taking.names[near[0]].strip()
    try:
        values = PARTS[name.lower()] * taking.numbers(near[0]).values
    except ValueError:
        return None
    if values.size != seconds.size or not np.all((values >= 0.0) & (values < 1.0)):
        return None
    return np.round(seconds + values - values[0], 9), name


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


def record_of(
    table: Table,
    mappings: Iterable[ColumnMapping] = (),
    needs: Iterable[str] = (),
    flags: bool = True,
    rows: Rows | None = None,
) -> Record:
    """Return the record in a table. Raises Faults, a line for each, with what to type, where there are flags to type.

    rows: what somebody says of the order of the rows.
    """
    mappings, rows = list(mappings), rows or Rows()
    if rows.turned:
        table = table.of(range(len(table.line_of))[::-1])
    table = _reshaped(table, mappings, rows)
    table, mappings = _with_row_times(table, mappings, rows)
    taking = Taking(table, flags)
    take_typed(taking, mappings)
    take_own(taking)
    if taking.faults:
        raise Faults(taking.faults)
    take_plain(taking)
    ask(taking, ["time_s", *(name for name in needs if name != "time_s")])
    if taking.faults:
        raise Faults(taking.faults)
    return in_sequence(_converted(taking), rows)


def _reshaped(table: Table, mappings: Sequence[ColumnMapping], rows: Rows) -> Table:
    """The table with a row for each moment and a column for each quantity; the same where somebody typed names that it
    would not have then."""
    try:
        shaped = below_each_other(one_after_the_other(one_row_each_moment(table), rows.branches))
    except Faults:
        if any(each.found_in([column.name for column in table.columns]) is not None for each in mappings):
            return table
        raise
    before, after = ([column.name for column in each.columns] for each in (table, shaped))
    lost = [each for each in mappings if each.found_in(before) is not None and each.found_in(after) is None]
    return table if lost else shaped


def _with_row_times(table: Table, mappings: list[ColumnMapping], rows: Rows) -> tuple[Table, list[ColumnMapping]]:
    """With times by the rows' order, where `time_s=row` or a period was typed."""
    others = [each for each in mappings if not each.of_rows]
    if rows.period_s is None and len(others) == len(mappings):
        return table, mappings
    step, times = (1.0, "rows") if rows.period_s is None else (rows.period_s, "period")
    own = {"time_s", "resistance_time_s"}
    left = [column for column in table.columns if column.name.strip() not in own]
    names = table.names()
    timed = [k for k, each in enumerate(table.columns) if meaning_of(each.name, each.unit).ours == "time_s"]
    timed = [k for k in timed if table.times == "file" and np.any(table.columns[k].filled())]
    if any(names[k].strip() == "time_s" and _increase(table, k) for k in timed):
        text = "a period or time_s=row was typed, and the file has time_s; expected one of them"
        raise fault(table.source, table.place, text)
    time = Column("time_s", step * np.arange(len(table.line_of), dtype=np.float64))
    said = [*table.said, "rows in the order in which they were taken; no rates are reported"]
    if timed:
        said.append(f"{', '.join(repr(names[k]) for k in timed)} left: the times are those of --period or time_s=row")
    return replace(table, columns=[*left, time], said=said, times=times), others


def _increase(table: Table, k: int) -> bool:
    """Whether a column's numbers increase in each row."""
    texts = table.columns[k].texts
    try:
        values = read_numbers(texts, table.signs).values if texts is not None else table.columns[k].fields
    except ValueError:
        return False
    return bool(np.all(np.diff(np.asarray(values)) > 0.0))
