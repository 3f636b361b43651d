"""--column OURS=THEIRS[|OTHER...][@UNIT]: where one of our columns comes from, and in which unit it is there."""

from __future__ import annotations

import re
import shlex
from collections.abc import Sequence
from dataclasses import dataclass

from rig.core.columns import OF_A_RECORD
from rig.core.faults import fault
from rig.files.field_times import LAYOUTS
from rig.files.units import UNITS, asked_unit

LONGEST_NAME = 80  # of a column that is told by its name, and not by its number


def ending_of(ours: str) -> str:
    """The unit that our column's name ends in; a second drive comes in those of a current."""
    return "A" if ours == "input_2" else ours.rpartition("_")[2]


@dataclass(frozen=True)
class ColumnMapping:
    """ours: our column. theirs: what the file calls it, '#3' for its third column; with '|' the first that is there.
    unit: as in `rig.files.units.UNITS`; unit_said: whether it was typed, or is ours because nothing was. layout: of
    dates, as 'dmy'."""

    ours: str
    theirs: str
    unit: str
    unit_said: bool = False
    layout: str | None = None

    @classmethod
    def parse(cls, text: str) -> ColumnMapping:
        """From what was typed. Raises Faults."""
        ours, equals, rest = text.partition("=")
        ours = ours.strip()
        if not equals or not ours or not rest.strip():
            raise fault("--column", repr(text), "expected OURS=THEIRS[@UNIT], as in temperature_degC=T_K@K")
        if ours not in OF_A_RECORD:
            if "@" in rest:
                known = ", ".join(OF_A_RECORD)
                raise fault("--column", repr(text), f"{ours!r} is none of {known}, so it has no unit to convert")
            return cls(ours, rest, ending_of(ours))
        ending = ending_of(ours)
        theirs, at, typed = rest.rpartition("@")
        if not at:
            return cls(ours, rest, ending)
        if ours == "time_s" and typed in LAYOUTS:
            return cls(ours, theirs, "s", True, typed)
        unit = asked_unit(typed, ending)
        if unit is None or not theirs:
            known = ", ".join([*UNITS[ending], *(LAYOUTS if ours == "time_s" else ())])
            raise fault("--column", repr(text), f"unit {typed!r} is none of {known}")
        return cls(ours, theirs, unit, True)

    @property
    def of_rows(self) -> bool:
        """Whether it says that times are those of the rows' order: time_s=row."""
        return self.ours == "time_s" and self.theirs.strip() == "row" and not self.unit_said

    def found_in(self, names: Sequence[str]) -> int | None:
        """Which of a file's columns it means; None where it has none of them."""
        stripped = [name.strip() for name in names]
        for theirs in (self.theirs, *self.theirs.split("|")):
            if theirs in names:
                return list(names).index(theirs)
            if theirs.strip() in stripped:
                return stripped.index(theirs.strip())
            number = re.fullmatch(r"\s*#(\d{1,5})\s*", theirs)
            if number is not None and 1 <= int(number[1]) <= len(names):
                return int(number[1]) - 1
        return None


def typed(ours: str, names: Sequence[str], index: int, unit: str | None = None) -> str:
    """What to type so that a file's column is taken, quoted for a shell."""
    name = names[index]
    odd = (
        not name.isprintable()
        or "@" in name
        or "|" in name
        or list(names).count(name) > 1
        or not 0 < len(name) <= LONGEST_NAME
    )
    text = f"{ours}={f'#{index + 1}' if odd else name}" + (f"@{unit}" if unit else "")
    return f"--column {shlex.quote(text)}"
