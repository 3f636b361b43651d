"""Units of a record's columns, and fields of a text file as numbers: decimal sign, thousands, overload, own units.

A spelling of a unit is accepted only if it has one meaning: 'mohm' stands for milliohms and for megohms alike, and the
user has to name it. '1,234' is a thousand or one and a bit. The rest of the file decides if one of its numbers can be
read in one way only ('0,5', '12,34', '1.234,5'); otherwise the user is asked for --decimal.
"""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, partial
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from compensator.hysteresis.functions import Array

Conversion = Callable[[Array], Array]


def _divide(factor: float, offset: float, at_zero: float, x: Array) -> Array:
    """Return factor / x + offset, and at_zero where x is 0 (no conductance: a resistance beyond the range)."""
    with np.errstate(divide="ignore"):
        return np.where(x == 0.0, at_zero, factor / x + offset)


def _raise_to(base: float, x: Array) -> Array:
    """Return the resistance of which x is the logarithm; infinite if no float can hold it."""
    with np.errstate(over="ignore", under="ignore"):
        return np.asarray(base**x, dtype=np.float64)


def _factors(**by_unit: float) -> dict[str, Conversion]:
    return {unit: lambda x, factor=factor: x * factor for unit, factor in by_unit.items()}  # type: ignore[misc]


# the ending of our column's name -> unit -> conversion to ours
UNITS: Mapping[str, Mapping[str, Conversion]] = {
    "s": _factors(s=1.0, ms=1e-3, us=1e-6, ns=1e-9, min=60.0, h=3600.0, d=86400.0),
    "degC": {
        "degC": lambda x: x,
        "K": lambda x: x - 273.15,
        "mK": lambda x: x * 1e-3 - 273.15,
        "degF": lambda x: (x - 32.0) / 1.8,
        "1/K": partial(_divide, 1.0, -273.15, np.nan),  # the axis of an Arrhenius plot
        "1000/K": partial(_divide, 1e3, -273.15, np.nan),
    },
    "ohm": {
        **_factors(ohm=1.0, mohm=1e-3, kohm=1e3, Mohm=1e6, Gohm=1e9),
        "log10ohm": partial(_raise_to, 10.0),
        "lnohm": partial(_raise_to, float(np.e)),
        **{unit: partial(_divide, 10.0**k, 0.0, np.inf) for unit, k in {"S": 0, "mS": 3, "uS": 6, "nS": 9}.items()},
    },
    "A": {
        **_factors(A=1.0, mA=1e-3, uA=1e-6, nA=1e-9),
        "duty": lambda x: x,
        "percent": lambda x: x / 100.0,
        "pwm255": lambda x: x / 255.0,
    },
}
DRIVE_SHARES = ("duty", "percent", "pwm255")  # of full drive: not amperes
CONDUCTANCES = ("S", "mS", "uS", "nS")
LOGARITHMS = ("log10ohm", "lnohm")
RECIPROCALS = ("1/K", "1000/K")  # of a temperature

_SYMBOLS = {"Ω": "ohm", "Ohm": "ohm", "kΩ": "kohm", "kOhm": "kohm", "MΩ": "Mohm", "MOhm": "Mohm", "GΩ": "Gohm"}
_SYMBOLS |= {"°C": "degC", "°F": "degF", "μA": "uA", "μS": "uS", "μs": "us", "%": "percent"}
_LATEX = {r"\Omega": "Ω", r"\omega": "Ω", r"^\circ": "°", r"^{\circ}": "°", r"\circ": "°", r"\degree": "°"}
_LATEX |= {r"\mu": "μ", r"\mathrm": "", r"\rm": "", "$": "", "{": "", "}": "", "\\": ""}
_TIME_WORDS = {
    "s": "s sec secs second seconds sek sekunde sekunden seconde secondes segundos secondi 秒",
    "ms": "ms msec msecs millisecond milliseconds millisekunden",
    "us": "us μs usec microsecond microseconds",
    "ns": "ns nsec nanosecond nanoseconds",
    "min": "min mins minute minutes minuten minutos minuti 分",
    "h": "h hr hrs hour hours std stunde stunden heure heures horas ore",
    "d": "d day days tag tage jour jours",
}
_TIMES = {word: unit for unit, words in _TIME_WORDS.items() for word in words.split()}
_OHM_PREFIX = {"": "ohm", "m": "mohm", "k": "kohm", "K": "kohm", "kilo": "kohm", "M": "Mohm", "mega": "Mohm"}
_OHM_PREFIX |= {"Mega": "Mohm", "Kilo": "kohm", "meg": "Mohm", "Meg": "Mohm", "G": "Gohm", "milli": "mohm"}
_SMALL_PREFIX = {"": "", "m": "m", "μ": "u", "u": "u", "n": "n", "milli": "m", "micro": "u", "nano": "n"}
_SIEMENS = ("1/Ω", "Ω^-1", "Ω-1", "1/Ohm", "1/ohm", "Ohm^-1", "ohm^-1", "A/V")
# units of quantities that none of our columns has: a name that ends in one is of that quantity
_OTHER = "V mV uV μV kV W mW kW Hz kHz MHz Pa hPa kPa MPa bar mbar Torr nm um μm mm cm counts LSB dB dBm ppm"
OTHER_UNITS = frozenset(_OTHER.split())


def normalize_text(text: str) -> str:
    """Return a text with one spelling of what looks the same: signs of units, full-width letters, LaTeX."""
    text = unicodedata.normalize("NFKC", text)
    if "\\" in text or "$" in text:
        for written, meant in _LATEX.items():
            text = text.replace(written, meant)
    return text.replace("º", "°").strip()


def is_foreign_unit(text: str, ending: str) -> bool:
    """Return True if a unit is of another quantity than our columns with this ending: 'V', 'K/min', '1/K', 'Ohm cm'."""
    found = parse_unit(text)
    if found is not None:
        return found[0] != ending
    text = normalize_text(text)
    parts = [part for part in re.split(r"[/·*⋅\s]|\^?-\d", text) if part]
    known = any(parse_unit(part) is not None or part in OTHER_UNITS for part in parts)
    return text in OTHER_UNITS or (known and parts != [text])


@lru_cache(maxsize=4096)
def parse_unit(text: str) -> tuple[str, str | None] | None:
    """Return the ending of our column's name and the unit that a spelling stands for, as in ("ohm", "kohm").

    The unit is None if the spelling has several meanings; the result is None if it is no unit of `UNITS`.
    """
    if len(text) > 60:
        return None
    text = re.sub(r"[\s.]", "", normalize_text(text)).strip("[](){}<>")
    if not text or len(text) > 24:
        return None
    if re.fullmatch(r"(?=[av]).*[a-z]dc", text.lower()):  # 'Amp DC', 'Volt DC': meters write so into their buffers
        text = text[:-2]
    low = text.lower()
    if low in ("mohm", "mohms") and (text.islower() or text.isupper()):
        return "ohm", None
    text = re.sub(r"/(?:sq|square|□)$", "", text)  # a sheet resistance, ohms per square, is a resistance
    if match := re.fullmatch(r"(.*?)(?:Ω|[Oo]hms?|OHMS?)", text):
        unit = _OHM_PREFIX.get(match[1].rstrip("-"))
        return ("ohm", unit) if unit else None
    if (match := re.fullmatch(r"(.*?)(?:S|[Ss]iemens|mhos?)", text)) and match[1] in _SMALL_PREFIX:
        return "ohm", f"{_SMALL_PREFIX[match[1]]}S"
    if text in _SIEMENS:
        return "ohm", "S"
    if (match := re.fullmatch(r"(.*?)(?:A|[Aa]mps?|[Aa]mperes?)", text)) and match[1] in _SMALL_PREFIX:
        return "A", f"{_SMALL_PREFIX[match[1]]}A"
    if low in ("%", "percent", "pct", "prozent"):
        return "A", "percent"
    if text in ("log10ohm", "lg(Ω)", "log10(Ω)", "log10(Ohm)", "log10(ohm)"):
        return "ohm", "log10ohm"
    if text == "mK":
        return "degC", "mK"
    match = re.fullmatch(r"(degrees?|deg_?|grad|°|o)?(C|celsius|K|kelvin|F|fahrenheit)", text, re.IGNORECASE)
    if match is not None and (match[1] is not None or text not in "ckf"):  # a small letter alone is something else
        return "degC", {"c": "degC", "k": "K", "f": "degF"}[match[2][0].lower()]
    return ("s", _TIMES[low]) if low in _TIMES and text != "MS" else None


def parse_typed_unit(text: str, ending: str) -> str | None:
    """Return the unit that the user typed after @, by name or symbol; None if it is none of this ending's."""
    unit = _SYMBOLS.get(normalize_text(text), text)
    return unit if unit in UNITS[ending] else None


MISSING = frozenset(("", "nan", "na", "n/a", "#n/a", "#na", "null", "none", "-", "--", "---", "nd", "n.d.", "1.#qnan"))
MISSING |= {"#div/0!", "#value!", "#num!", "#ref!", "#name?", "#null!", "#nv", "#wert!", "#zahl!"}  # formulas of Excel
OVERLOAD = frozenset(("ol", "o.l", "o.l.", "ovld", "ovrflw", "overload", "overflow", "over", "overrange", "1.#inf"))
OVERLOAD |= {"∞", "inf", "infinity"}
IEEE_INFINITY = (9.89e37, 1.0e38)  # IEEE 488.2's infinity is 9.9E37, its not-a-number 9.91E37; meters send both
IEEE_NOT_A_NUMBER = (9.905e37, 9.915e37)
OVERLOAD_OHM = (0.9e9, 1.0e30)  # in this range older bench meters send a power of ten or all nines for overload
OVERLOAD_FACTOR = 30.0  # above every other reading: readings in between would be in the meter's next range
LONGEST = 400  # characters of a number: a double written out in full has 327
SAMPLED_ROWS = 2000
DECIMALS = "expected --decimal , or --decimal ."
PLAIN = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
WITH_COMMA = re.compile(r"[-+]?(\d+,\d*|,\d+)([eE][-+]?\d+)?")
THOUSANDS = {  # by the decimal sign
    ".": re.compile(r"[-+]?\d{1,3}([,' ]\d{3})+(\.\d*)?([eE][-+]?\d+)?"),
    ",": re.compile(r"[-+]?\d{1,3}([.' ]\d{3})+(,\d*)?([eE][-+]?\d+)?"),
}
AMBIGUOUS = re.compile(r"[-+]?[1-9]\d{0,2}[.,]\d{3}")  # 1,234: a thousand, or one and a bit
WITH_UNIT = re.compile(r"([-+]?[\d.,' ]*\d[.,]?(?:[eE][-+]?\d+)?)\s*([^\d\s.,+\-][^\d]{0,11})")


class BadField(ValueError):
    """A field that cannot be read as it stands.

    row: its row; text: the field; expected: in words what stands there in other files.
    """

    def __init__(self, row: int, text: str, expected: str = "expected a number") -> None:
        self.row, self.text, self.expected = row, text, expected
        super().__init__(f"{text[:40]!r}: {expected}")


@dataclass(frozen=True)
class DecimalSign:
    """A file's decimal sign: '.', ',' or '' (unknown).

    ambiguous_points: a point may separate thousands. typed: the user named the sign.
    """

    sign: str = "."
    ambiguous_points: bool = False
    typed: bool = False


@dataclass
class Numbers:
    """A column's values; ending: their unit if the fields had units of their own; notes: how fields were read."""

    values: Array
    ending: str | None = None
    notes: list[str] = field(default_factory=list)


def tidy_number(text: str) -> str:
    """Return a field with one kind of minus and blank, no blank behind its sign, and E before its exponent."""
    text = text.strip().strip('"').strip()
    if not text.isascii():
        text = re.sub("[\u00a0\u202f\u2009]", " ", text.replace("\u2212", "-").replace("\u2019", "'"))
    if text[:1] in ("+", "-"):
        text = text[0] + text[1:].lstrip()
    return re.sub(r"(?<=[\d.])[dD](?=[-+]?\d)", "E", text) if "D" in text or "d" in text else text


def is_number(text: str) -> bool:
    """Return True if a field is a number, in any spelling, or a number with a unit."""
    if len(text) > LONGEST:
        return False
    text = tidy_number(text)
    if any(pattern.fullmatch(text) for pattern in (PLAIN, WITH_COMMA, *THOUSANDS.values())):
        return True
    match = WITH_UNIT.fullmatch(text)
    return match is not None and parse_unit(match[2]) is not None and is_number(match[1])


def is_blank(text: str) -> bool:
    """Return True if a field stands for no reading, or for one beyond the meter's range."""
    low = text.strip().strip('"').lower()
    return low in MISSING or low in OVERLOAD


def find_decimal_sign(columns: Iterable[Sequence[str]], separator: str) -> DecimalSign:
    """Return a file's decimal sign, from those of its numbers that can be read in one way only."""
    votes = set().union(*(_votes(islice(column, SAMPLED_ROWS)) for column in columns))
    sign = next(iter(votes)) if len(votes) == 1 else ""
    return DecimalSign(sign, sign == "," or len(votes) > 1 or (not sign and separator == ";"))


def _votes(fields: Iterable[str]) -> set[str]:
    """Return the decimal signs of the numbers that can be read in one way only."""
    votes = set()
    for text in fields:
        points, commas = text.count("."), text.count(",")
        if not (points or commas) or ":" in text or not is_number(text):
            continue
        if points and commas:
            votes.add("." if text.rfind(".") > text.rfind(",") else ",")
        elif points + commas > 1:
            votes.add("," if points else ".")
        elif not AMBIGUOUS.fullmatch(tidy_number(text)):
            votes.add("." if points else ",")
        if len(votes) == 2:
            break
    return votes


def read_numbers(fields: Sequence[str], decimal: DecimalSign, ending: str | None = None) -> Numbers:
    """Return fields as numbers. Raises BadField for the first that is none, or whose decimal sign is not clear.

    ending: the unit that our column's name ends in, None for a column that is not ours. Fields that have units of
    their own, as in a handheld meter's log, are converted to that unit.
    """
    if decimal.sign != "," or not decimal.typed:
        try:  # the fast way, and nearly every file's
            values = np.array([float(text) if text else math.nan for text in fields])
        except ValueError:
            values = np.array([math.inf])
        if not np.any(np.isinf(values)):  # by a word, or by more digits than a double holds
            if decimal.ambiguous_points and any("." in text for text in fields):
                _sign_of(fields, decimal)
            return replace_sentinels(values, ending)
    return _read_each(fields, decimal, ending)


def _sign_of(fields: Sequence[str], decimal: DecimalSign) -> str:
    """Return a column's decimal sign: the one typed, the column's own, or the file's. Raises BadField."""
    if decimal.typed:
        return decimal.sign
    votes = _votes(fields)
    if len(votes) == 1:
        return votes.pop()
    commas = any("," in text for text in fields)
    points = decimal.ambiguous_points and any("." in text for text in fields)
    if votes or (not decimal.sign if commas else points):
        row = next(k for k, text in enumerate(fields) if "," in text or "." in text)
        raise BadField(row, fields[row], "a comma or point before decimals, or between thousands? " + DECIMALS)
    return decimal.sign or "."


def replace_sentinels(values: Array, ending: str | None, notes: Sequence[str] = ()) -> Numbers:
    """Return numbers with a meter's codes for overload as inf, and for no reading as nan."""
    notes = list(notes)
    if ending is not None and values.size:
        size = np.abs(values)
        none = (size > IEEE_NOT_A_NUMBER[0]) & (size < IEEE_NOT_A_NUMBER[1])
        large = (size >= IEEE_INFINITY[0]) & (size <= IEEE_INFINITY[1]) & ~none
        if np.any(large | none):
            notes.append(f"9.9E37 read as beyond the range or no reading ({int(np.sum(large | none))} rows)")
            values = np.where(large, np.inf, values)  # its sign follows the input's, and is none of a resistance
            values[none] = math.nan
    return Numbers(values, None, notes)


def find_overload(ohm: Array) -> NDArray[np.bool_]:
    """Return the rows in which a meter wrote its overload as a number: 1E+9 or 9.99999E+9, far above all readings."""
    finite = np.abs(ohm[np.isfinite(ohm)])
    largest = float(np.max(finite, initial=0.0))
    below = finite[finite < largest]
    low, high = OVERLOAD_OHM
    if not low <= largest <= high or not below.size or largest < OVERLOAD_FACTOR * float(np.max(below)):
        return np.zeros(ohm.size, dtype=np.bool_)
    digits = f"{largest:.5e}".partition("e")[0].replace(".", "")
    code = digits in ("100000", "999999") or digits.rstrip("0") in ("99", "999", "9999", "99999")
    return np.asarray((np.abs(ohm) == largest) & code, dtype=np.bool_)


def _read_each(fields: Sequence[str], decimal: DecimalSign, ending: str | None) -> Numbers:
    """Return fields as numbers one by one, in any spelling."""
    first = next((k for k, text in enumerate(fields) if not is_blank(text)), None)
    if first is not None and not is_number(fields[first]):  # a column of words shows in its first
        raise BadField(first, fields[first])
    sign = _sign_of(fields, decimal)
    values = np.full(len(fields), math.nan)
    endings: dict[str, int] = {}  # of fields with units, and '' of those without, with the first row of each
    overloads = 0
    for k, raw in enumerate(fields):
        text = tidy_number(raw) if len(raw) <= LONGEST else raw
        low = text.lower()
        if low in MISSING:
            continue
        if low.lstrip("+-") in OVERLOAD:
            values[k] = -math.inf if low.startswith("-inf") else math.inf
            overloads += "inf" not in low
            continue
        unit = None
        if not PLAIN.fullmatch(text) and len(text) <= LONGEST and (match := WITH_UNIT.fullmatch(text)):
            unit, text = parse_unit(match[2]), match[1].strip()
            if unit is None or unit[1] is None or (ending is not None and unit[0] != ending):
                raise BadField(k, raw)
        try:
            number = parse_number(text, sign)
        except ValueError:
            raise BadField(k, raw) from None
        values[k] = number if unit is None else float(UNITS[unit[0]][str(unit[1])](np.array([number]))[0])
        endings.setdefault(unit[0] if unit is not None else "", k)
    if len(endings) > 1:
        row = max(endings.values())
        raise BadField(row, fields[row], "expected a unit in each field, or in none")
    notes = [f"fields such as OL read as beyond the range ({overloads} rows)"] if overloads else []
    numbers = replace_sentinels(values, ending, notes)
    numbers.ending = next(iter(endings), "") or None
    return numbers


def parse_number(text: str, sign: str) -> float:
    """Return a number with this decimal sign. Raises ValueError."""
    if len(text) > LONGEST:
        raise ValueError(text[:20] + "...")
    if THOUSANDS[sign].fullmatch(text):
        text = re.sub("[,' ]" if sign == "." else "[.' ]", "", text).replace(",", ".")
    elif sign == "," and WITH_COMMA.fullmatch(text):
        text = text.replace(",", ".")
    if not PLAIN.fullmatch(text):
        raise ValueError(text)
    number = float(text)
    if math.isinf(number):
        raise ValueError(f"{text[:20]}: more than a double holds")
    return number
