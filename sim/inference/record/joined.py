"""Several records of one rig as one: one after the other, with time between them in which nothing is known.

Plate, film and effects are one; room and first temperatures are each record's own, and so is what the film went through
between two of them. Time goes on through all of them: a drift over hours has no place in records of different days.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from compensator.hysteresis.functions import Array
from sim.inference.record.quantity import quantity_of
from sim.inference.record.record import Record, Rows, read_columns

APART_S: Final = 60.0  # ten times the longest delay that one meets; plate, sink and lags begin anew anyway
APART_ROWS: Final = 20.0  # the same in rows of a record that was read slowly: no row is taken for a missing one
TIMES: Final = ("time_s", "resistance_time_s", "current_time_s", "meter_current_time_s")


def read_records(records: Sequence[Mapping[str, ArrayLike]], output: str, *, held_out: bool) -> Record:
    """One record, or several of one rig as one, from their columns. output: the film's, as `quantity_of` has it;
    held_out: whether every fourth block of rows is. Raises ValueError, a line a fault."""
    if len(records) == 1:
        return read_columns(records[0], held_out=held_out, quantity=quantity_of(output, records[0]))
    columns, begins = joined(records)
    record = read_columns(columns, held_out=held_out, quantity=quantity_of(output, columns), joined=begins)
    return replace(record, file_s=np.concatenate([np.asarray(one["time_s"], dtype=np.float64) for one in records]))


def joined(records: Sequence[Mapping[str, ArrayLike]]) -> tuple[dict[str, Array], Rows]:
    """The columns that any of the records has, nan where one lacks it, and the rows at which the second and later ones
    begin. Raises ValueError where one has no current and another one has."""
    found = [{name: np.asarray(values) for name, values in record.items()} for record in records]
    lines = [
        f"record {k + 1}: current_A: missing; expected it in all records or in none"
        for k, record in enumerate(found)
        if "current_A" not in record and any("current_A" in other for other in found)
    ]
    if lines:
        raise ValueError("\n".join(lines))
    sizes = [record["time_s"].size for record in found]
    begin_s, parts = 0.0, []
    for record in found:
        time = record["time_s"].astype(np.float64)
        part = {n: v.astype(np.float64) for n, v in record.items() if v.dtype.kind in "fiub" and v.size == time.size}
        part |= {name: part[name] - time[0] + begin_s for name in TIMES if name in part}
        parts.append(part)
        longest = float(np.median(np.diff(time))) if time.size > 1 else 0.0
        begin_s += float(time[-1] - time[0]) + max(APART_S, APART_ROWS * longest)
    names = dict.fromkeys(name for part in parts for name in part)
    columns = {
        n: np.concatenate([p.get(n, np.full(size, np.nan)) for p, size in zip(parts, sizes, strict=True)])
        for n in names
    }
    return columns, np.cumsum(sizes[:-1]).astype(np.int64)
