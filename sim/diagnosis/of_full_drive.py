"""A diagnosis of a record whose current is a share of the full drive: what has A in its name is in shares of that."""

from __future__ import annotations

from dataclasses import replace

from sim.diagnosis.report.caution import Caution
from sim.diagnosis.result import Diagnosis

SHARE = "share_of_full_drive"


def of_full_drive(found: Diagnosis, drive: str | None) -> Diagnosis:
    """The same with a warning of it, and without usual sizes in ampere beside numbers that are none. drive: the unit of
    the record's current_A where it is a share, else None."""
    if drive is None or found.record.current_A is None:
        return found
    text = (
        f"A stands for the full drive here: current_A is a share of it ({drive}). What is in A is a share, too, and "
        "what is per A is per full drive"
    )
    limits = [replace(limit, met=None) if limit.parameter.endswith("_A") else limit for limit in found.limits]
    return replace(found, warnings=[Caution(SHARE, text), *found.warnings], limits=limits, drive=drive)
