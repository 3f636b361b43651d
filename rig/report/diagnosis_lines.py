"""The whole diagnosis for a terminal, a line for each thing that it says."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rig.report.diagnosis_records import held_out_lines, record_lines, room_line, warning_line
from rig.report.diagnosis_words import (
    assumed_lines,
    gain_line,
    judged_channels,
    left_over,
    limit_lines,
    mixing_in_words,
    not_named,
    parameters,
    plate_lines,
    sentence,
    told_by,
)

if TYPE_CHECKING:
    from sim.diagnosis.result import Diagnosis


def lines(diagnosis: Diagnosis) -> list[str]:
    """What `peltier diagnose` prints."""
    out = [sentence(diagnosis), *(f"  assumed: {text}" for text in assumed_lines(diagnosis))]
    for f in diagnosis.findings:
        other = f"; or {', '.join(f.indistinguishable_from)}" if f.indistinguishable_from else ""
        evidence = f"evidence {f.evidence:.4g}, false alarms at most {f.false_alarm:.2g}"
        out.append(f"  {f.name}: {parameters(f)}; {evidence}{other}")
    if diagnosis.record.joined.size:
        out += [f"record: {text}" for text in record_lines(diagnosis)]
    out += [gain_line(*one) for one in judged_channels(diagnosis)]
    out += [f"held out: {text}" for text in held_out_lines(diagnosis)]
    out += plate_lines(diagnosis)
    out += [f"rooms: {text}" for text in room_line(diagnosis)]
    if diagnosis.film is not None:
        film = diagnosis.film
        form, operators = film["memoryless"], film["operators"]
        out.append(f"film: D(T) of the form {form}, operators with weight: {operators}{told_by(film)}")
        out += [f"film: {text}" for text in [mixing_in_words(diagnosis)] if text]
    out += [f"not named: {text}" for text in not_named(diagnosis)]
    out += limit_lines(diagnosis)
    out += [f"left: {text}" for text in left_over(diagnosis)]
    out += [f"warning: {warning_line(diagnosis, caution)}" for caution in diagnosis.warnings]
    out += [f"next: {text}" for text in diagnosis.next_experiment]
    return out
