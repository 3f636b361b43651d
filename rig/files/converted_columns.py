"""Columns that were taken, in our units: numbers, times, and what their fields say beside that."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from compensator.hysteresis.functions import Array
from rig.core.faults import Faults, fault
from rig.files.column_mapping import ending_of, typed
from rig.files.credible_columns import faults_in
from rig.files.field_numbers import Undecided, beyond_as_a_number, number_of, read_numbers, tidied
from rig.files.field_times import Unclear, clock_alone, date_alone, read_times, time_like
from rig.files.record import Record
from rig.files.taking import Choice, Taking
from rig.files.thermometer_faults import false_readings, without
from rig.files.units import CONDUCTANCES, SHARES, UNITS

MOST_NUMBER_FAULTS = 5  # a column: five lines show what is wrong with it as well as a thousand


def converted(taking: Taking) -> Record:
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
    read, left_out = values.get("temperature_degC"), false_readings(values)
    if read is not None and left_out:
        values["temperature_degC"] = without(read, left_out)
    as_read = read if left_out else None
    return Record(values, taking.table.source, drive, texts, tuple(_told(taking)), tuple(left_out), as_read)


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
