"""Film and plate fitted to records: a film where there is temperature and output, a plate where there is current."""

from __future__ import annotations

from typing import Any

from compensator.identification.film import FilmFit, FilmRecord, identify_film_records
from compensator.identification.plate import PlateFit, PlateRecord, identify_plate_records
from rig.core.faults import Faults
from rig.files.record_file import Record


def film_fit(records: list[Record], output: str, **how: Any) -> FilmFit:
    """how: as `identify_film_records`. Readings of the resistance have their own times, where the record has them.
    Raises Faults."""
    inputs = [
        FilmRecord(
            r["time_s"],
            r["temperature_degC"],
            r.output(output),
            r.source,
            r["resistance_time_s"] if r.has("resistance_time_s") else None,
        )
        for r in records
    ]
    try:
        return identify_film_records(inputs, output_name=output, **how)
    except ValueError as error:
        raise said_of(records, error) from None


def plate_fit(records: list[Record], kind: Any = "peltier", lag: bool = False) -> PlateFit:
    """lag: whether the thermometer's lag behind the plate is fitted too. Raises Faults."""
    inputs = [PlateRecord(r["time_s"], r["temperature_degC"], r["current_A"], r.source) for r in records]
    try:
        return identify_plate_records(inputs, kind=kind, lag=lag)
    except ValueError as error:
        raise said_of(records, error) from None


def said_of(records: list[Record], error: ValueError) -> Faults:
    """The fault with the record that it is about."""
    text = str(error)
    if any(text.startswith(record.source) for record in records):
        return Faults([text])
    return Faults([f"{', '.join(record.source for record in records)}: {text}"])
