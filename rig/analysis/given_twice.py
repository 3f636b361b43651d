"""A record that is given twice tells nothing new: held out, it would judge the fit to itself."""

from __future__ import annotations

from collections.abc import Sequence

from rig.core.faults import Faults
from rig.records.record import Record, content_digest


def require_different(records: Sequence[Record]) -> None:
    """Raises Faults, a line for each record that holds the same as one before it, whatever their names are."""
    digests, lines = [content_digest(record) for record in records], []
    for k, record in enumerate(records):
        first = records[digests.index(digests[k])].source
        if digests.index(digests[k]) < k:
            same = "is given twice" if first == record.source else f"holds the same as {first}"
            lines.append(f"{record.source}: {same}; expected each record once, fitted or held out")
    if lines:
        raise Faults(lines)
