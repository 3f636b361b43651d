"""What tests of the reader share: a text as a record, or what is said of a text that cannot be read."""

from __future__ import annotations

from pathlib import Path

import pytest

from rig.core.faults import Faults
from rig.records.branches import RowOrder
from rig.records.column_names import ColumnMapping
from rig.records.record import Record
from rig.records.record_file import read_record

NEEDS = ("temperature_degC",)


def read(path: Path, text: str | bytes, *columns: str, decimal: str = "", order: RowOrder | None = None) -> Record:
    """Return the record of a text, as a verb reads it."""
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_record(path, [ColumnMapping.parse(column) for column in columns], NEEDS, decimal, order=order)


def refusal(path: Path, text: str | bytes, *columns: str) -> str:
    """Return what is said of a text that is refused: lines that name the file."""
    with pytest.raises(Faults) as found:
        read(path, text, *columns)
    assert all(str(path) in line and "\n" not in line for line in found.value.lines)
    return str(found.value)
