"""Column names: which of our columns a name stands for, in which unit, and the --column option that says so.

A name is clear if every word is known and its unit fits: 'T [K]', 'Widerstand (kOhm)', 't / min', 'Input A (K)',
'R_ohm'. A name with an unknown word ('R_heater'), without a unit ('R'), or with a unit that contradicts it
('Conductance (Ohm)') is not clear: the user is asked about such a column, it is never taken silently.
"""

from __future__ import annotations

import re
import shlex
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass, replace

from rig.core.faults import fault
from rig.core.reading import OF_A_RECORD
from rig.records.numbers import (
    CONDUCTANCES,
    LOGARITHMS,
    OTHER_UNITS,
    UNITS,
    is_foreign_unit,
    normalize_text,
    parse_typed_unit,
    parse_unit,
)
from rig.records.times import LAYOUTS

_QUANTITIES = {
    "time": "time zeit temps tiempo tempo elapsed timestamp datetime date datum uhrzeit clock heure t 時間 时间 時刻",
    "temperature": "temp temperature temperatur temperatura thermometer thermocouple tc pt rtd pv T θ ϑ Θ 温度",
    "resistance": "resistance res widerstand resistencia resistenza R 抵抗 電気抵抗 电阻",
    "conductance": "conductance leitwert conductancia conduttanza G",
    "current": "current strom courant corriente corrente I 電流 电流",
    "drive": "output out duty pwm drive stellgrosse mv co op",
}
_ROLES = {
    "setpoint": "sp set setpoint soll sollwert target consigne",
    "sink": "sink heatsink kuhlkorper",
    "ambient": "ambient room umgebung raum ambiante",
    "meter": "excitation probe test source sense bias messstrom",
}
_NEUTRAL_WORDS = (
    "sample film dut device sensor input channel ch chan kanal voie bridge measured measurement meas actual act ist "
    "istwert value val reading avg average mean rel relative w wire four two dmm meter ohmmeter smu keithley thermo "
    "plate stage object peltier tec vo vo2 unix epoch stamp point heat the of in since start total process sheet "
    "branch curve"
)
_NEUTRAL = frozenset(_NEUTRAL_WORDS.split())
_QUANTITY_OF = {word: quantity for quantity, words in _QUANTITIES.items() for word in words.split()}
_ROLE_OF = {word: role for role, words in _ROLES.items() for word in words.split()}
_ENDING = {"time": "s", "temperature": "degC", "resistance": "ohm", "conductance": "ohm", "current": "A", "drive": "A"}
_OURS = {
    ("time", ""): "time_s",
    ("temperature", ""): "temperature_degC",
    ("temperature", "setpoint"): "setpoint_degC",
    ("temperature", "sink"): "sink_degC",
    ("temperature", "ambient"): "ambient_degC",
    ("resistance", ""): "resistance_ohm",
    ("resistance", "setpoint"): "target_ohm",
    ("conductance", ""): "resistance_ohm",
    ("conductance", "setpoint"): "target_ohm",
    ("current", ""): "current_A",
    ("current", "meter"): "meter_current_A",
    ("drive", ""): "current_A",
}
_RECIPROCAL = re.compile(r"(?:(1000|1e3|10\^?3|1)\s*/\s*(?:T|[Tt]emp\w*)|T\s*\^?[-−]1)\b(.*)")  # of an Arrhenius plot
_LOGARITHM = re.compile(r"(?i)\b(log_?10|lg|log|ln)\b\s*_?\s*[(|]?\s*(R\b|resistance|Ω|ohm)")
_LONGEST_NAME = 80  # characters of a column that is named by its name and not by its number


@dataclass(frozen=True)
class Meaning:
    """A name's meaning.

    ours: our column, None if it is not known. unit: of `UNITS`, None if none is named or it can be one of several.
    certain: the column can be taken without asking. doubt: why not, for people. has_unit: the file names some unit.
    units: those to choose from, if the name leaves several.
    """

    ours: str | None
    unit: str | None = None
    certain: bool = False
    doubt: str = ""
    has_unit: bool = False
    units: tuple[str, ...] = ()


def interpret_name(name: str, unit_below: str = "") -> Meaning:
    """Return the meaning of a column's name; unit_below: from the line of units below the names, if there is one."""
    name = _cleaned(name)
    if name in OF_A_RECORD or not (name or unit_below):
        return Meaning(name or None)
    if _LOGARITHM.search(name):
        return _logarithm(name)
    if match := _RECIPROCAL.fullmatch(name):
        thousand = match[1] not in (None, "1") or re.search(r"10\^?[-−]3|\bk", match[2] + unit_below) is not None
        unit = "1000/K" if thousand else "1/K"
        return Meaning("temperature_degC", unit, False, "1/K is a reciprocal temperature", True)
    words, unit, loose = split_unit(name)
    if unit and unit_below and parse_unit(unit) != parse_unit(unit_below):
        return replace(_interpret(words, unit), certain=False, doubt=f"two units, {unit!r} and {unit_below!r}")
    meaning = _interpret(words, unit or unit_below)
    return replace(meaning, certain=False) if loose else meaning


def contradicting_unit(name: str, unit_below: str, ending: str) -> str:
    """Return the unit in a name, or below it, if our columns with this ending cannot have it; else ''."""
    if name in OF_A_RECORD:
        return ""
    name = _cleaned(name)
    if _RECIPROCAL.fullmatch(name):
        return "1/K"
    unit = split_unit(name)[1] or unit_below
    if not unit and (match := re.fullmatch(r".*?(?:[_/(\[{<]|\s)\s*([^\s_/()\[\]{}<>]+)[)\]}>]?", name)):
        unit = match[1] if match[1] in OTHER_UNITS else ""
    return unit if unit and is_foreign_unit(unit, ending) else ""


def _cleaned(name: str) -> str:
    return normalize_text(name.strip().strip("\"'")[:200])[:200]


def split_unit(name: str) -> tuple[str, str, bool]:
    """Split a name into words and unit ('' if there is none): 'T [K]', 'T / K', 'T_K', 'Temp degC'; and return True if
    the unit is a letter behind words that name no quantity, as in 'y_C' or 'Input_A', and may be something else."""
    if match := re.fullmatch(r"(.*?)\s*[\[({<]([^\[\](){}<>]*)[\])}>]\s*", name):
        return match[1], match[2], False
    if (match := re.fullmatch(r"(.*?)\s*(?:/|,|;|\bin\b)\s*(\S{1,12})", name)) and parse_unit(match[2]) is not None:
        return match[1], match[2], False
    if match := re.fullmatch(r"(.*?)([_\s]+)([^\s_]+)", name):
        # A single letter after a blank is a channel's ('Input A'); after an underscore it may be a unit ('T_K').
        letter = len(match[3]) == 1 and "_" in match[2]
        written = match[3].upper() if letter and match[3] in "ckf" else match[3]
        unit = parse_unit(written)
        quantities, roles, _ = _classify(match[1])
        fits = letter and unit is not None and all(_ENDING[name] == unit[0] for name in quantities)
        if unit is not None and (len(match[3]) > 1 or fits):
            return match[1], written, letter and (written != match[3] or not (quantities or roles))
    if parse_unit(name) is not None and (len(name) > 1 or name in ("s", "K")):
        return "", name, False
    return name, "", False


def _classify(words: str) -> tuple[set[str], set[str], list[str]]:
    """Return the quantities and the roles that words name, and the unknown words."""
    quantities, roles, unknown = set(), set(), []
    for word in re.findall(r"[^\W\d_]+", re.sub(r"([a-z])([A-Z])", r"\1 \2", words)):
        bare = "".join(c for c in unicodedata.normalize("NFKD", word) if not unicodedata.combining(c))
        key = word if len(word) == 1 else unicodedata.normalize("NFC", bare.lower()).replace("ß", "ss")
        if key in _QUANTITY_OF:
            quantities.add(_QUANTITY_OF[key])
        elif key in _ROLE_OF:
            roles.add(_ROLE_OF[key])
        elif key not in _NEUTRAL and not (len(word) == 1 and word in "ABCDW"):
            unknown.append(word)
    return quantities, roles, unknown


def _interpret(words: str, unit_text: str) -> Meaning:
    quantities, roles, unknown = _classify(words)
    has_unit = bool(unit_text.strip())
    found = parse_unit(unit_text) if unit_text else None
    if quantities == {"time"} and found is not None and found[1] in CONDUCTANCES:
        found = "s", str(found[1]).lower()  # 'Time (mS)' is in milliseconds, not millisiemens
    if found is None:
        ours = _our_column(quantities, roles) if not unknown else None
        if ours is None:
            return Meaning(None)
        return Meaning(ours, None, False, f"unit {unit_text!r} is unknown" if has_unit else "", has_unit)
    ending, unit = found
    of_conductance, percent = unit in CONDUCTANCES, unit == "percent"
    if not quantities:
        by_ending = {"s": "time", "degC": "temperature", "ohm": "resistance", "A": "current"}
        quantities = {"drive" if percent else "conductance" if of_conductance else by_ending[ending]}
        unknown += ["percent"] * percent
    elif quantities == {"drive", "current"} or (quantities == {"drive"} and ending == "A"):
        quantities = {"drive" if percent else "current"}
    elif ending == "ohm" and quantities == {"resistance" if of_conductance else "conductance"}:
        text = f"the name says {next(iter(quantities))}, the unit {unit_text}"
        other = "ohm" if of_conductance else "S"
        return Meaning("resistance_ohm", unit, False, text, True, (str(unit), other))
    ours = _our_column(quantities, roles)
    if ours is None or _ENDING[next(iter(quantities))] != ending:
        return Meaning(None, None, False, "", True)
    doubt = f"unit {unit_text!r} can be milliohms or megohms" if unit is None else ""
    return Meaning(ours, unit, not unknown and unit is not None, doubt, True, () if unit else ("Mohm", "mohm"))


def _our_column(quantities: set[str], roles: set[str]) -> str | None:
    one = len(quantities) == 1 and len(roles) <= 1
    return _OURS.get((next(iter(quantities)), next(iter(roles), ""))) if one else None


def _logarithm(name: str) -> Meaning:
    """Interpret 'log10(R/Ohm)', 'lg R', 'ln R'; a bare 'log' may have either base, and the user is asked."""
    if re.search(r"(?i)k\s*(Ω|ohm)|M\s*(Ω|ohm)|siemens", name):
        return Meaning("resistance_ohm", None, False, "the logarithm is of another unit than ohms", True)
    if re.search(r"(?i)\bln\b", name):
        return Meaning("resistance_ohm", "lnohm", True, "", True)
    if re.search(r"(?i)\b(log_?10|lg)", name):
        return Meaning("resistance_ohm", "log10ohm", True, "", True)
    return Meaning("resistance_ohm", None, False, "the logarithm's base is not given", True, LOGARITHMS)


def unit_ending(ours: str) -> str:
    """Return the unit that our column's name ends in; a second drive has the units of a current."""
    return "A" if ours == "input_2" else ours.rpartition("_")[2]


@dataclass(frozen=True)
class ColumnMapping:
    """The source of one of our columns: --column OURS=THEIRS[|OTHER...][@UNIT].

    theirs: the file's name for it; '#3' is its third column; of several with '|' the first that the file has.
    unit: as in `rig.records.numbers.UNITS`. unit_typed: the user typed it. layout: of dates, such as 'dmy'.
    """

    ours: str
    theirs: str
    unit: str
    unit_typed: bool = False
    layout: str | None = None

    @classmethod
    def parse(cls, text: str) -> ColumnMapping:
        """Return the mapping that the user typed. Raises Faults."""
        ours, equals, rest = text.partition("=")
        ours = ours.strip()
        if not equals or not ours or not rest.strip():
            raise fault("--column", repr(text), "expected OURS=THEIRS[@UNIT], as in temperature_degC=T_K@K")
        ending, (theirs, at, typed) = unit_ending(ours), rest.rpartition("@")
        if ours not in OF_A_RECORD and at:
            known = ", ".join(OF_A_RECORD)
            raise fault("--column", repr(text), f"{ours!r} is none of {known}, so it has no unit to convert")
        if not at:
            return cls(ours, rest, ending)
        if ours == "time_s" and typed in LAYOUTS:
            return cls(ours, theirs, "s", True, typed)
        unit = parse_typed_unit(typed, ending)
        if unit is None or not theirs:
            known = ", ".join([*UNITS[ending], *(LAYOUTS if ours == "time_s" else ())])
            raise fault("--column", repr(text), f"unit {typed!r} is none of {known}")
        return cls(ours, theirs, unit, True)

    @property
    def is_row_number(self) -> bool:
        """True for time_s=row: the times are the numbers of the rows."""
        return self.ours == "time_s" and self.theirs.strip() == "row" and not self.unit_typed

    def find(self, names: Sequence[str]) -> int | None:
        """Return the index of the file's column; None if the file has no such column."""
        stripped = [name.strip() for name in names]
        for theirs in (self.theirs, *self.theirs.split("|")):
            for choices, name in ((list(names), theirs), (stripped, theirs.strip())):
                if name in choices:
                    return choices.index(name)
            number = re.fullmatch(r"\s*#(\d{1,5})\s*", theirs)
            if number is not None and 1 <= int(number[1]) <= len(names):
                return int(number[1]) - 1
        return None


def column_option(ours: str, names: Sequence[str], index: int, unit: str | None = None) -> str:
    """Return the --column option that takes a file's column, quoted for a shell."""
    name = names[index]
    odd = not name.isprintable() or "@" in name or "|" in name or list(names).count(name) > 1
    theirs = f"#{index + 1}" if odd or not 0 < len(name) <= _LONGEST_NAME else name
    return f"--column {shlex.quote(f'{ours}={theirs}' + (f'@{unit}' if unit else ''))}"
