"""A record in memory: columns by name, with units in the names."""

from __future__ import annotations

import hashlib
import math
import pickle
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from compensator.hysteresis.functions import Array
from rig.core.faults import fault
from rig.core.python_words import in_python
from rig.records.film_output import RISING_RESISTANCE, column_of, in_decades, is_negative, unit_of
from rig.records.thermometer_faults import FalseReadings, false_lines, without

if TYPE_CHECKING:
    from rig.records.branches import Rows

__all__ = ["Record", "Refused", "content_digest", "unit_of"]


@dataclass(frozen=True)
class Refused:
    """A file that could not be read as a record, in its place among others. source: as it was named; faults: why, a
    line each."""

    source: str
    faults: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Record:
    """Columns by name, each of the shape (rows,); drive: the unit of a current_A that is a share of full drive.

    said: what was taken for what, and what was left, a line each; empty where the names are ours. times: "file" where
    it has times, "period" where somebody typed how far apart its rows are, "rows" where only their order is known: of
    both no rates are reported. left_out: the rows in which the thermometer is not believed
    (`rig.records.thermometer_faults`): `temperature_degC` is nan there; as_read_degC: the temperatures with them, None
    where all are believed.
    """

    columns: dict[str, Array]
    source: str = "record"
    drive: str | None = None
    text_columns: dict[str, list[str]] = field(default_factory=dict)
    said: tuple[str, ...] = ()
    left_out: tuple[FalseReadings, ...] = ()
    as_read_degC: Array | None = None
    times: str = "file"

    @classmethod
    @in_python()
    def from_arrays(
        cls,
        columns: Mapping[str, Any],
        column: Iterable[str] = (),
        needs: Iterable[str] = (),
        source: str = "arrays",
        rows: Rows | None = None,
    ) -> Record:
        """A record of numpy arrays, or of anything that becomes one, by name. Raises Faults.

        Names are read as those of a file: ours, or plain ones such as 'T [K]'. column: of names that are not plain,
        as 'resistance_ohm=R@kohm'. needs: columns that have to be there, besides time_s. Times may be datetime64. rows:
        what is known of the order of the rows (`rig.records.branches.Rows`).
        """
        from rig.records.column_names import ColumnMapping
        from rig.records.conversion import record_of
        from rig.records.table import array_table

        return record_of(array_table(columns, source), [ColumnMapping.parse(text) for text in column], needs, rows=rows)

    @classmethod
    @in_python()
    def from_frame(
        cls,
        frame: Any,
        column: Iterable[str] = (),
        needs: Iterable[str] = (),
        source: str = "data frame",
        rows: Rows | None = None,
    ) -> Record:
        """A record of a pandas DataFrame, or of what has its `columns`, `index` and `[name]`. Raises as `from_arrays`.

        An index of dates (or one with a name that is not a column's) is a column too.
        """
        from rig.records.table import columns_of_frame

        return cls.from_arrays(columns_of_frame(frame), column, needs, source, rows)

    def to_frame(self) -> Any:
        """Return a pandas DataFrame with the columns, text columns too. Raises Faults where pandas is not installed."""
        try:
            from pandas import DataFrame
        except ImportError:
            text = "is not installed; `pip install pandas` has it, and the columns are arrays in record.columns"
            raise fault("to_frame", "pandas", text) from None
        return DataFrame({**self.columns, **self.text_columns})

    def __repr__(self) -> str:
        """A line for the record and one for each column: how many readings it has, and between what."""
        lines = [f"Record of {self.source}: {self.rows} rows"]
        for name, values in self.columns.items():
            read = np.asarray(values, dtype=np.float64)
            read = read[np.isfinite(read)]
            span = f"{read.min():.6g} to {read.max():.6g}" if read.size else "no readings"
            few = f", {read.size} readings" if 0 < read.size < self.rows else ""
            lines.append(f"  {name}: {span}{few}")
        lines += [f"  {name}: text" for name in self.text_columns]
        if self.drive is not None:
            lines.append(f"  current_A is a share of full drive ({self.drive})")
        return "\n".join(lines)

    @property
    def rows(self) -> int:
        """How many rows there are."""
        return int(self.columns["time_s"].size)

    def has(self, name: str) -> bool:
        """Whether a column is there and holds at least one finite value."""
        return name in self.columns and bool(np.any(np.isfinite(self.columns[name])))

    def has_output(self, name: str = "minus_log10_ohm") -> bool:
        """Whether the film's output is there."""
        return self.has(column_of(name, self.columns))

    def left_out_lines(self) -> list[str]:
        """Return a sentence for each value that the thermometer is not believed."""
        return false_lines(self.left_out, self["time_s"])

    def left_out_document(self) -> list[dict[str, Any]]:
        """Return the same for the JSON."""
        return [{"record": self.source, **one.document(self["time_s"])} for one in self.left_out]

    def as_read(self) -> dict[str, Array]:
        """Return the columns with the readings of the thermometer that are not believed."""
        return self.columns if self.as_read_degC is None else {**self.columns, "temperature_degC": self.as_read_degC}

    def of_rows(self, order: NDArray[np.intp]) -> Record:
        """Return the record with its rows in another order, each once; the times stay where they are."""
        place, left_out = np.argsort(order), []
        for one in self.left_out:
            rows = np.sort(place[one.first : one.last + 1])
            for part in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1):
                left_out.append(replace(one, first=int(part[0]), last=int(part[-1])))
        return replace(
            self,
            columns={name: values if name == "time_s" else values[order] for name, values in self.columns.items()},
            text_columns={name: [values[k] for k in order] for name, values in self.text_columns.items()},
            left_out=tuple(sorted(left_out, key=lambda one: one.first)),
            as_read_degC=None if self.as_read_degC is None else self.as_read_degC[order],
        )

    def followed_by(self, other: Record, later_s: float) -> Record:
        """Return the record with the rows of another one below its own, of the columns that both have; the other's
        times are later_s later than it says."""
        columns, others = self.as_read(), dict(other.as_read())
        others |= {name: values + later_s for name, values in others.items() if f"_{name}".endswith("_time_s")}
        joined = {name: np.concatenate([columns[name], others[name]]) for name in columns if name in others}
        texts = {
            name: [*values, *other.text_columns[name]]
            for name, values in self.text_columns.items()
            if name in other.text_columns
        }
        moved = (replace(one, first=one.first + self.rows, last=one.last + self.rows) for one in other.left_out)
        left_out, as_read = (*self.left_out, *moved), None
        if left_out and "temperature_degC" in joined:
            as_read = joined["temperature_degC"]
            joined["temperature_degC"] = without(as_read, left_out)
        return replace(self, columns=joined, text_columns=texts, left_out=left_out, as_read_degC=as_read)

    def __getitem__(self, name: str) -> Array:
        return self.columns[name]

    def output(self, name: str = "minus_log10_ohm") -> Array:
        """The film's output: -log10(R / 1 ohm) or "log10_ohm", nan where there is no finite reading > 0; or a column of
        that name, or with "minus_" before it its negative."""
        column = self.columns[column_of(name, self.columns)]
        if not in_decades(name):
            return -column if is_negative(name, self.columns) else column
        good = np.isfinite(column) & (column > 0.0)
        output = np.full(column.size, math.nan)
        output[good] = np.log10(column[good])
        return output if name == RISING_RESISTANCE else -output


def content_digest(record: Record | Refused) -> str:
    """By which a record is known among many, whatever its name and place are: twelve hexadecimal digits that another
    content changes. What a refused one holds is why."""
    holds = record.faults if isinstance(record, Refused) else (record.columns, record.drive)
    return hashlib.sha256(pickle.dumps(holds)).hexdigest()[:12]
