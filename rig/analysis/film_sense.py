"""The film's output, in the sense in which it rises with temperature."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from rig.core.faults import Faults
from rig.records.film_output import FALLING_RESISTANCE, column_of, other_sign
from rig.records.record_file import Record
from sim.inference.readings.output_sense import output_falls


def rising(records: Sequence[Record], output: str, say: Callable[[str], None]) -> str:
    """The output, or its negative where it falls as temperature rises. Raises Faults for one that no record has."""
    if output != FALLING_RESISTANCE and not any(record.has_output(output) for record in records):
        raise Faults([_missing(record, output) for record in records])
    pairs = [(r["temperature_degC"], r.output(output)) for r in records if r.has_output(output)]
    if not output_falls(pairs):
        return output
    other = other_sign(output)
    say(f"film: {output} falls as temperature rises: the model's output is {other}")
    return other


def _missing(record: Record, output: str) -> str:
    name = column_of(output, record.columns)
    what = f"no finite number in {record.rows} rows" if name in record.columns else "no such column"
    return f"{record.source}: --output {output}: {name}: {what}; there are {', '.join(record.columns)}"
