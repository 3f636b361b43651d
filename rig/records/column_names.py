"""What a column's name says: which of our columns it is, in which unit, and whether that is plain.

Plain is a name of which every word is known, with a unit that goes with it: 'T [K]', 'Widerstand (kOhm)', 't / min',
'Input A (K)', 'R_ohm'. A name with a word that nobody here knows ('R_heater'), without a unit ('R'), or with a unit
that contradicts it ('Conductance (Ohm)') is not plain: such a column is asked for, never taken.
"""

from __future__ import annotations

import re
import shlex
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass, replace

from rig.core.columns import OF_A_RECORD
from rig.core.faults import fault
from rig.records.times import LAYOUTS
from rig.records.units import CONDUCTANCES, OTHER_UNITS, UNITS, asked_unit, foreign, spelled, straightened

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
_NEUTRAL = (
    "sample film dut device sensor input channel ch chan kanal voie bridge measured measurement meas actual act ist "
    "istwert value val reading avg average mean rel relative w wire four two dmm meter ohmmeter smu keithley thermo "
    "plate stage object peltier tec vo vo2 unix epoch stamp point heat the of in since start total process sheet "
    "branch curve"
)
QUANTITY = {word: quantity for quantity, words in _QUANTITIES.items() for word in words.split()}
ROLE = {word: role for role, words in _ROLES.items() for word in words.split()}
NEUTRAL = frozenset(_NEUTRAL.split())
ENDING = {"time": "s", "temperature": "degC", "resistance": "ohm", "conductance": "ohm", "current": "A", "drive": "A"}
OURS = {
    ("time", ""): "time_s",
    ("temperature", ""): "temperature_degC",
    ("temperature", "setpoint"): "setpoint_degC",
    ("temperature", "sink"): "sink_degC",
    ("temperature", "ambient"): "ambient_degC",
    ("resistance", ""): "resistance_ohm",
    ("resistance", "setpoint"): "target_ohm",
    ("current", ""): "current_A",
    ("current", "meter"): "meter_current_A",
    ("drive", ""): "current_A",
}


@dataclass(frozen=True)
class Meaning:
    """ours: our column that this one may be, or None. unit: as in `rig.records.units.UNITS`, None where it is not said.
    plain: it can be taken. doubt: what speaks against it, in words. said: whether the file says any unit at all."""

    ours: str | None
    unit: str | None = None
    plain: bool = False
    doubt: str = ""
    said: bool = False


NOTHING = Meaning(None)
RECIPROCAL = re.compile(
    r"(?:(1000|1e3|10\^?3|1)\s*/\s*(?:T|[Tt]emp\w*)|T\s*\^?[-−]1)\b(.*)"
)  # as Arrhenius plots have it


def meaning_of(name: str, below: str = "") -> Meaning:
    """What a name says, with the unit that stands below it, where there is a line of units."""
    name = straightened(name.strip().strip("\"'")[:200])[:200]
    if not name or name in OF_A_RECORD:
        return Meaning(name) if name else NOTHING
    if re.search(r"(?i)\b(log_?10|lg|log|ln)\b\s*_?\s*[(|]?\s*(R\b|resistance|Ω|ohm)", name):
        return _logarithm(name)
    if match := RECIPROCAL.fullmatch(name):
        thousand = match[1] not in (None, "1") or re.search(r"10\^?[-−]3|\bk", match[2] + below) is not None
        return Meaning("temperature_degC", "1000/K" if thousand else "1/K", False, "1/K is no temperature", True)
    words, bracket = divided(name)
    unit = bracket or below
    if bracket and below and spelled(bracket) != spelled(below):
        return replace(_meant(words, bracket), plain=False, doubt=f"two units, {bracket!r} and {below!r}")
    return _meant(words, unit)


def other_unit(name: str, below: str, ending: str) -> str:
    """The unit that a name says, or the line below it, where it is one that a column of ours that ends so cannot have;
    '' where there is none."""
    if name in OF_A_RECORD:
        return ""
    name = straightened(name.strip().strip("\"'")[:200])[:200]
    if RECIPROCAL.fullmatch(name):
        return "1/K"
    unit = divided(name)[1] or below
    if not unit and (match := re.fullmatch(r".*?(?:[_/(\[{<]|\s)\s*([^\s_/()\[\]{}<>]+)[)\]}>]?", name)):
        unit = match[1] if match[1] in OTHER_UNITS else ""
    return unit if unit and foreign(unit, ending) else ""


def divided(name: str) -> tuple[str, str]:
    """A name in its words and its unit: 'T [K]', 'T / K', 'T_K', 'Temp degC'; the unit is empty where none is seen."""
    if match := re.fullmatch(r"(.*?)\s*[\[({<]([^\[\](){}<>]*)[\])}>]\s*", name):
        return match[1], match[2]
    if (match := re.fullmatch(r"(.*?)\s*(?:/|,|;|\bin\b)\s*(\S{1,12})", name)) and spelled(match[2]) is not None:
        return match[1], match[2]
    if match := re.fullmatch(r"(.*?)([_\s]+)([^\s_]+)", name):
        unit = spelled(match[3])
        alone = len(match[3]) == 1  # a letter alone after a blank is a channel's, 'Input A', but for the degrees'
        if unit is not None and (not alone or ("_" in match[2] and _goes_with(match[1], unit[0]))):
            return match[1], match[3]
    if spelled(name) is not None and (len(name) > 1 or name in ("s", "K")):
        return "", name
    return name, ""


def _goes_with(words: str, ending: str) -> bool:
    quantities, roles, strange = _told(words)
    if not quantities:
        return bool(roles) and not strange
    return len(quantities) == 1 and ENDING[next(iter(quantities))] == ending


def _told(words: str) -> tuple[set[str], set[str], list[str]]:
    """Quantities and roles that words name, and the words that nobody knows."""
    quantities, roles, strange = set(), set(), []
    for word in re.findall(r"[^\W\d_]+", re.sub(r"([a-z])([A-Z])", r"\1 \2", words)):
        bare = "".join(c for c in unicodedata.normalize("NFKD", word) if not unicodedata.combining(c))
        key = word if len(word) == 1 else unicodedata.normalize("NFC", bare.lower()).replace("ß", "ss")
        if key in QUANTITY:
            quantities.add(QUANTITY[key])
        elif key in ROLE:
            roles.add(ROLE[key])
        elif key not in NEUTRAL and not (len(word) == 1 and word in "ABCDW"):
            strange.append(word)
    return quantities, roles, strange


def _meant(words: str, unit_text: str) -> Meaning:
    quantities, roles, strange = _told(words)
    unit = spelled(unit_text) if unit_text else None
    if quantities == {"time"} and unit is not None and unit[0] == "ohm" and unit[1] in CONDUCTANCES:
        unit = ("s", str(unit[1]).lower())  # 'Time (mS)': no siemens is meant
    said = bool(unit_text.strip())
    if unit is None:
        return _without_unit(quantities, roles, strange, said and bool(quantities), unit_text)
    ending, name = unit
    if not quantities:
        quantities = {"drive"} if name == "percent" else {_quantity_of(ending, name)}
        if name == "percent":
            strange = strange or ["percent"]
    elif quantities == {"drive", "current"}:
        quantities = {"drive"} if name == "percent" else {"current"}
    elif quantities == {"drive"} and ending == "A" and name != "percent":
        quantities = {"current"}
    elif (quantities == {"resistance"} and name in CONDUCTANCES) or (quantities == {"conductance"} and ending == "ohm"):
        if (name in CONDUCTANCES) != (quantities == {"conductance"}):
            word = next(iter(quantities))
            return Meaning("resistance_ohm", name, False, f"the name says {word}, the unit {unit_text}", True)
        quantities = {"resistance"}
    if len(quantities) != 1 or ENDING[next(iter(quantities))] != ending:
        return Meaning(None, None, False, "", True)
    ours = _ours(next(iter(quantities)), roles)
    if ours is None:
        return Meaning(None, None, False, "", True)
    doubt = f"unit {unit_text!r} can be milliohms or megohms" if name is None else ""
    return Meaning(ours, name, not strange and name is not None, doubt, True)


def _without_unit(quantities: set[str], roles: set[str], strange: list[str], said: bool, unit_text: str) -> Meaning:
    if len(quantities) != 1 or strange:
        return NOTHING
    ours = _ours(next(iter(quantities)), roles)
    if ours is None:
        return NOTHING
    return Meaning(ours, None, False, f"unit {unit_text!r} is none that is known" if said else "", said)


def _quantity_of(ending: str, unit: str | None) -> str:
    by_ending = {"s": "time", "degC": "temperature", "ohm": "resistance", "A": "current"}
    return by_ending[ending] if unit not in CONDUCTANCES else "conductance"


def _ours(quantity: str, roles: set[str]) -> str | None:
    if len(roles) > 1:
        return None
    return OURS.get(("resistance" if quantity == "conductance" else quantity, next(iter(roles), "")))


def _logarithm(name: str) -> Meaning:
    """'log10(R/Ohm)', 'lg R', 'ln R': a logarithm of ohms. A bare 'log' is either, and has to be said."""
    if re.search(r"(?i)k\s*(Ω|ohm)|M\s*(Ω|ohm)|siemens", name):
        return Meaning("resistance_ohm", None, False, "a logarithm of something else than ohms", True)
    if re.search(r"(?i)\bln\b", name):
        return Meaning("resistance_ohm", "lnohm", True, "", True)
    if re.search(r"(?i)\b(log_?10|lg)", name):
        return Meaning("resistance_ohm", "log10ohm", True, "", True)
    return Meaning("resistance_ohm", None, False, "its logarithm's base is not said", True)


LONGEST_NAME = 80  # of a column that is told by its name, and not by its number


def ending_of(ours: str) -> str:
    """The unit that our column's name ends in; a second drive comes in those of a current."""
    return "A" if ours == "input_2" else ours.rpartition("_")[2]


@dataclass(frozen=True)
class ColumnMapping:
    """ours: our column. theirs: what the file calls it, '#3' for its third column; with '|' the first that is there.
    unit: as in `rig.records.units.UNITS`; unit_said: whether it was typed, or is ours because nothing was. layout: of
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
