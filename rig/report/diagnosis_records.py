"""Which records a diagnosis is of, and which were held out: names, rows, rooms, errors, a line for each."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rig.report.diagnosis_words import channels_of, file_names, listed, number
from sim.diagnosis.report.plate_numbers import ROOM_DEGC

if TYPE_CHECKING:
    from sim.diagnosis.report.caution import Caution
    from sim.diagnosis.result import Diagnosis, HeldOutRecord

MOST_NAMED = 4  # records in a title


def record_names(diagnosis: Diagnosis) -> list[str]:
    """The files that were diagnosed, as one where they are several; with their folders where names are alike."""
    return file_names(list(diagnosis.sources))


def together(diagnosis: Diagnosis) -> str:
    """The same in a line: of many the first ones, and how many more."""
    names = record_names(diagnosis)
    more = len(names) - MOST_NAMED
    return listed([*names[:MOST_NAMED], f"{more} more"] if more > 0 else names)


def record_lines(diagnosis: Diagnosis) -> list[str]:
    """The rows of each record: how many, over how long, how far apart, with how many gaps."""
    record, lines = diagnosis.record, []
    names = record_names(diagnosis) if record.joined.size else list(diagnosis.sources)
    for name, part in zip(names, record.parts, strict=True):
        time = record.file_s[part]
        length_s = float(time[-1] - time[0])
        length = f"{length_s / 3600.0:.2g} h" if length_s >= 3600.0 else f"{length_s:.0f} s"
        gaps = record.gaps_in(part).size
        text = f"{name}: {time.size} rows over {length}, one each {record.interval_of(part):.3g} s"
        lines.append(f"{text}, {gaps} gap{'s' * (gaps > 1)}" if gaps else text)
    return lines


def room_line(diagnosis: Diagnosis) -> list[str]:
    """Of several records each one's room; nothing of one, whose room is among the plate's numbers."""
    if len(diagnosis.rooms_degC) < 2:
        return []
    rooms = zip(record_names(diagnosis), diagnosis.rooms_degC, strict=True)
    return [f"{', '.join(f'{name} {number(room)} degC' for name, room in rooms)}"]


def held_out_lines(diagnosis: Diagnosis) -> list[str]:
    """The extended model's error on each of the other records, in the rows that judge, and the room found there."""
    lines = []
    for name, held in zip(file_names([one.source for one in diagnosis.elsewhere]), diagnosis.elsewhere, strict=True):
        errors = [
            f"{what} {number(held.errors[key][0])} {unit} ({held.errors[key][1]} rows)"
            for key, (what, unit) in channels_of(diagnosis).items()
            if key in held.errors
        ]
        room = [] if held.ambient_degC is None else [f"with a room of {number(held.ambient_degC)} degC{_doubt(held)}"]
        lines.append(f"{name}: {', '.join([*(errors or ['its rows decide, and judge nothing']), *room])}")
    return lines


def _doubt(held: HeldOutRecord) -> str:
    """Of a room that its first rows hardly tell, or that does what the model lacks."""
    assert held.ambient_degC is not None
    return "" if ROOM_DEGC[0] <= held.ambient_degC <= ROOM_DEGC[1] else ", which is none"


def warning_line(diagnosis: Diagnosis, caution: Caution) -> str:
    """A warning, with the record that it is about, where there are several, and from when to when."""
    of = "" if caution.record is None else f"{record_names(diagnosis)[caution.record - 1]}: "
    when = ""
    if caution.from_s is not None and caution.to_s is not None:
        when = f" (from {caution.from_s:.0f} to {caution.to_s:.0f} s)"
    return f"{of}{caution.text}{when}"
