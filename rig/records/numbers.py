"""Fields of a text file as numbers: decimal comma or point, thousands, overload, a unit within the field.

'1,234' is a thousand or one and a bit. The rest of the file decides if one of its numbers can be read in one way only
('0,5', '12,34', '1.234,5'); otherwise the user is asked for --decimal.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from compensator.hysteresis.functions import Array
from rig.records.units import UNITS, parse_unit

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
