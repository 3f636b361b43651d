"""From a file's table to a record: which column is taken for which of ours, what that is worth, what has to be asked.

What somebody typed with --column comes first, then our own names, then names that are plain
(`rig.files.column_meaning`). What was taken for what is told in a line. Where a column that is needed, or one that
looks as if it held the resistance, is not plain, the file is refused with the line to type.
"""

from __future__ import annotations

from collections.abc import Iterable

from rig.core.faults import Faults
from rig.files.asked_columns import ask
from rig.files.column_mapping import ColumnMapping
from rig.files.converted_columns import converted
from rig.files.record import Record
from rig.files.table import Table
from rig.files.taking import Taking, take_own, take_plain, take_typed


def record_of(
    table: Table, mappings: Iterable[ColumnMapping] = (), needs: Iterable[str] = (), flags: bool = True
) -> Record:
    """The record in a table. Raises Faults, a line for each, with what to type, where there are flags to type."""
    mappings = list(mappings)
    taking = Taking(table, flags)
    take_typed(taking, mappings)
    take_own(taking)
    if taking.faults:
        raise Faults(taking.faults)
    take_plain(taking)
    ask(taking, ["time_s", *(name for name in needs if name != "time_s")])
    if taking.faults:
        raise Faults(taking.faults)
    return converted(taking)
