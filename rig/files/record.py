"""A record in memory: columns by name, with units in the names."""

from __future__ import annotations

import hashlib
import math
import pickle
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from compensator.hysteresis.functions import Array
from rig.files.film_output import RISING_RESISTANCE, column_of, in_decades, is_negative, unit_of
from rig.files.thermometer_faults import FalseReadings, false_lines

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

    said: what was taken for what, and what was left, a line each; empty where the names are ours. left_out: the rows in
    which the thermometer is not believed (`rig.files.thermometer_faults`): `temperature_degC` is nan there;
    as_read_degC: the temperatures with them, None where all are believed.
    """

    columns: dict[str, Array]
    source: str = "record"
    drive: str | None = None
    text_columns: dict[str, list[str]] = field(default_factory=dict)
    said: tuple[str, ...] = ()
    left_out: tuple[FalseReadings, ...] = ()
    as_read_degC: Array | None = None

    @classmethod
    def from_arrays(
        cls, columns: Mapping[str, Any], column: Iterable[str] = (), needs: Iterable[str] = (), source: str = "arrays"
    ) -> Record:
        """A record of numpy arrays, or of anything that becomes one, by name. Raises Faults.

        Names are read as those of a file: ours, or plain ones such as 'T [K]'. column: what --column would be given,
        as 'resistance_ohm=R@kohm'. needs: columns that have to be there, besides time_s. Times may be datetime64.
        """
        from rig.files.array_table import array_table
        from rig.files.column_mapping import ColumnMapping
        from rig.files.taken_columns import record_of

        return record_of(array_table(columns, source), [ColumnMapping.parse(text) for text in column], needs)

    @classmethod
    def from_frame(
        cls, frame: Any, column: Iterable[str] = (), needs: Iterable[str] = (), source: str = "data frame"
    ) -> Record:
        """A record of a pandas DataFrame, or of what has its `columns`, `index` and `[name]`. Raises as `from_arrays`.

        An index of dates (or one with a name that is not a column's) is a column too.
        """
        from rig.files.array_table import columns_of_frame

        return cls.from_arrays(columns_of_frame(frame), column, needs, source)

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
