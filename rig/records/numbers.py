"""Fields of a text file as numbers: decimal comma or point, thousands, overflow, units within the field.

'1,234' is a thousand or one and a bit. Which, the rest of the file tells where any of its numbers is written in a way
that leaves no choice ('0,5', '12,34', '1.234,5'); where none is, it is asked for with --decimal.
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
from rig.records.units import UNITS, spelled

MISSING = frozenset(("", "nan", "na", "n/a", "#n/a", "#na", "null", "none", "-", "--", "---", "nd", "n.d.", "1.#qnan"))
MISSING |= {"#div/0!", "#value!", "#num!", "#ref!", "#name?", "#null!", "#nv", "#wert!", "#zahl!"}  # formulas of Excel
BEYOND = frozenset(("ol", "o.l", "o.l.", "ovld", "ovrflw", "overload", "overflow", "over", "overrange", "1.#inf", "∞"))
BEYOND |= {"inf", "infinity"}
OVERFLOW = (9.89e37, 1.0e38)  # IEEE 488.2's infinity is 9.9E37, its not-a-number 9.91E37; meters send them as readings
NOT_A_NUMBER = (9.905e37, 9.915e37)
OVERLOAD_OHM = (0.9e9, 1.0e30)  # within, a power of ten or all nines is what older bench meters send for overload
OVERLOAD_FACTOR = 30.0  # and far above every reading: the next range would have shown those
LONGEST = 400  # characters of a number: a double written out in full has 327
EVIDENCE_ROWS = 2000
PLAIN = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
COMMA = re.compile(r"[-+]?(\d+,\d*|,\d+)([eE][-+]?\d+)?")
GROUPS = {  # thousands in groups, by the sign before the decimals
    ".": re.compile(r"[-+]?\d{1,3}([,' ]\d{3})+(\.\d*)?([eE][-+]?\d+)?"),
    ",": re.compile(r"[-+]?\d{1,3}([.' ]\d{3})+(,\d*)?([eE][-+]?\d+)?"),
}
OPEN = re.compile(r"[-+]?[1-9]\d{0,2}[.,]\d{3}")  # 1,234: a thousand, or one and a bit
WITH_UNIT = re.compile(r"([-+]?[\d.,' ]*\d[.,]?(?:[eE][-+]?\d+)?)\s*([^\d\s.,+\-][^\d]{0,11})")


class Undecided(ValueError):
    """A column whose commas or points may stand before decimals or between thousands."""


@dataclass(frozen=True)
class Signs:
    """How a file writes decimals: '.' or ',', '' where nothing in it tells. points_open: a point may part thousands.
    asked: somebody typed it."""

    decimal: str = "."
    points_open: bool = False
    asked: bool = False


@dataclass
class Numbers:
    """values; ending: the unit they are in now, where fields had units of their own; said: what was read as what."""

    values: Array
    ending: str | None = None
    said: list[str] = field(default_factory=list)


def tidied(text: str) -> str:
    """A field with one kind of minus and blank, none behind its sign, and E before its exponent."""
    text = text.strip().strip('"').strip()
    if not text.isascii():
        text = text.replace("\u2212", "-").replace("\u00a0", " ").replace("\u202f", " ").replace("\u2009", " ")
        text = text.replace("\u2019", "'")
    if text[:1] in ("+", "-"):
        text = text[0] + text[1:].lstrip()
    if "D" in text or "d" in text:
        text = re.sub(r"(?<=[\d.])[dD](?=[-+]?\d)", "E", text)
    return text


def number_like(text: str) -> bool:
    """Whether a field is a number, in whatever way of writing, or a number with a unit."""
    if len(text) > LONGEST:
        return False
    text = tidied(text)
    if PLAIN.fullmatch(text) or COMMA.fullmatch(text) or GROUPS["."].fullmatch(text) or GROUPS[","].fullmatch(text):
        return True
    match = WITH_UNIT.fullmatch(text)
    return match is not None and spelled(match[2]) is not None and number_like(match[1])


def blank_like(text: str) -> bool:
    """Whether a field says that there is no reading, or one beyond the range."""
    low = text.strip().strip('"').lower()
    return low in MISSING or low in BEYOND


def signs_of(columns: Iterable[Sequence[str]], separator: str) -> Signs:
    """How a file writes decimals, from those of its numbers that can be read in one way only."""
    votes = set().union(*(_votes(islice(column, EVIDENCE_ROWS)) for column in columns))
    several = len(votes) > 1
    decimal = votes.pop() if len(votes) == 1 else ""
    return Signs(decimal, decimal == "," or several or (not decimal and separator == ";"))


def _votes(fields: Iterable[str]) -> set[str]:
    """The decimal signs of the numbers that leave no choice."""
    votes = set()
    for text in fields:
        points, commas = text.count("."), text.count(",")
        if not (points or commas) or ":" in text or not number_like(text):
            continue
        if points and commas:
            votes.add("." if text.rfind(".") > text.rfind(",") else ",")
        elif points + commas > 1:
            votes.add("," if points else ".")
        elif not OPEN.fullmatch(tidied(text)):
            votes.add("." if points else ",")
        if len(votes) == 2:
            break
    return votes


def read_numbers(fields: Sequence[str], signs: Signs, ending: str | None = None) -> Numbers:
    """Fields as numbers. Raises ValueError where a field is none, Undecided where its sign may be either.

    ending: the unit that our column's name ends in, None for a column of theirs; fields that have units of their own
    (as a handheld meter's log) become that unit.
    """
    if signs.decimal != "," or not signs.asked:
        try:  # the plain way, and nearly every file's
            values = np.array([float(text) if text else math.nan for text in fields])
        except ValueError:
            pass
        else:
            if signs.points_open and any("." in text for text in fields):
                _sign_of(fields, signs)
            return within_range(values, ending)
    return _one_by_one(fields, signs, ending)


def _sign_of(fields: Sequence[str], signs: Signs) -> str:
    """The decimal sign of a column: as was typed, as it shows itself, or as the rest of the file does."""
    if signs.asked:
        return signs.decimal
    votes = _votes(fields)
    if len(votes) == 1:
        return votes.pop()
    commas = any("," in text for text in fields)
    if votes or (commas and not signs.decimal) or (not commas and signs.points_open and any("." in t for t in fields)):
        raise Undecided(next(text for text in fields if "," in text or "." in text))
    return signs.decimal or "."


def within_range(values: Array, ending: str | None, said: Sequence[str] = ()) -> Numbers:
    """A meter's sentinels among the numbers: beyond the range, or no reading."""
    said = list(said)
    if ending is not None and values.size:
        size = np.abs(values)
        none = (size > NOT_A_NUMBER[0]) & (size < NOT_A_NUMBER[1])
        large = (size >= OVERFLOW[0]) & (size <= OVERFLOW[1]) & ~none
        if np.any(large) or np.any(none):
            said.append(f"9.9E37 as beyond the range or no reading ({int(np.sum(large | none))} rows)")
            values = np.where(large, np.inf, values)  # the sign follows the input's, and says nothing of a resistance
            values[none] = math.nan
    return Numbers(values, None, said)


def beyond_as_a_number(ohm: Array) -> NDArray[np.bool_]:
    """The rows in which a meter wrote its overload as a number: 1E+9 or 9.99999E+9, far above all that it read."""
    finite = np.abs(ohm[np.isfinite(ohm)])
    largest = float(np.max(finite, initial=0.0))
    below = finite[finite < largest]
    low, high = OVERLOAD_OHM
    if not low <= largest <= high or not below.size or largest < OVERLOAD_FACTOR * float(np.max(below)):
        return np.zeros(ohm.size, dtype=np.bool_)
    digits = f"{largest:.5e}".partition("e")[0].replace(".", "")
    code = digits in ("100000", "999999") or digits.rstrip("0") in ("99", "999", "9999", "99999")
    return np.asarray((np.abs(ohm) == largest) & code, dtype=np.bool_)


def _one_by_one(fields: Sequence[str], signs: Signs, ending: str | None) -> Numbers:
    """Field by field, in every way of writing."""
    first = next((text for text in fields if not blank_like(text)), "")
    if first and not number_like(first):  # a column of words is known by its first
        raise ValueError(first)
    sign = _sign_of(fields, signs)
    values = np.full(len(fields), math.nan)
    endings: set[str] = set()
    beyond = 0
    for k, raw in enumerate(fields):
        text = tidied(raw) if len(raw) <= LONGEST else raw
        low = text.lower()
        if low in MISSING:
            continue
        if low.lstrip("+-") in BEYOND:
            values[k] = -math.inf if low.startswith("-inf") else math.inf
            beyond += "inf" not in low
            continue
        unit = None
        if not PLAIN.fullmatch(text) and len(text) <= LONGEST and (match := WITH_UNIT.fullmatch(text)):
            unit, text = spelled(match[2]), match[1].strip()
            if unit is None or unit[1] is None or (ending is not None and unit[0] != ending):
                raise ValueError(raw)
        number = number_of(text, sign)
        values[k] = number if unit is None else float(UNITS[unit[0]][str(unit[1])](np.array([number]))[0])
        endings.add(unit[0] if unit is not None else "")
    if endings - {""} and len(endings) > 1:
        raise ValueError("numbers with a unit and numbers without one")
    numbers = within_range(values, ending, [f"fields such as OL as beyond the range ({beyond} rows)"] if beyond else [])
    numbers.ending = next(iter(endings - {""}), None)
    return numbers


def number_of(text: str, sign: str) -> float:
    """A number whose decimals follow the sign. Raises ValueError."""
    if len(text) > LONGEST:
        raise ValueError(text[:20] + "...")
    if GROUPS[sign].fullmatch(text):
        text = re.sub("[,' ]" if sign == "." else "[.' ]", "", text).replace(",", ".")
    elif sign == "," and COMMA.fullmatch(text):
        text = text.replace(",", ".")
    if not PLAIN.fullmatch(text):
        raise ValueError(text)
    return float(text)
