"""Fields of a text file as times: dates in any order, ISO times, a clock's time of the day, elapsed h:mm:ss.

All become seconds from the first row. 03/04/2026 is read in both orders: if both give the same seconds, or one goes
back in time or leaves a gap of days that the other does not, the order is known; otherwise the user is asked for
`time_s=Date@dmy` or `@mdy`. A clock that goes back by more than half a day has passed midnight.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from datetime import date, datetime
from functools import lru_cache

import numpy as np

from compensator.hysteresis.functions import Array
from rig.core.clock import DAY_S
from rig.records.numbers import BadField

ORDERS = ("ymd", "dmy", "mdy")
SUMMER_TIME = "dst"  # local time: one hour comes twice when summer time ends
LAYOUTS = (*ORDERS, "hh:mm", "mm:ss", SUMMER_TIME, *(f"{order}+{SUMMER_TIME}" for order in ORDERS))
LONGEST = 60  # characters of a time
CHANGE_TOLERANCE = 3.0  # median steps by which a change of the clock may differ from an hour
HOUR_S = 3600.0  # after which a clock of minutes and seconds begins again
# by the first letters of their names, English and German
MONTHS = {"jan": 1, "feb": 2, "mar": 3, "apr": 4, "may": 5, "jun": 6, "jul": 7, "aug": 8, "sep": 9, "oct": 10}
MONTHS |= {"nov": 11, "dec": 12, "mai": 5, "okt": 10, "dez": 12, "mrz": 3, "mär": 3}
# names of columns that hold the fraction of a second -> seconds of 1 in them
SECOND_FRACTIONS = {
    **dict.fromkeys(("ms", "msec", "msecs", "millis", "millisecond", "milliseconds", "millisec", "milli"), 1e-3),
    **dict.fromkeys(("us", "usec", "usecs", "microsecond", "microseconds", "tv_usec", "micros"), 1e-6),
    **dict.fromkeys(("ns", "nsec", "nsecs", "nanosecond", "nanoseconds", "nanosec", "tv_nsec"), 1e-9),
    **dict.fromkeys(("fractional seconds", "fractional second", "fraction", "frac", "fraction of second"), 1.0),
    **dict.fromkeys(("fractional_seconds", "subsec", "subseconds", "sub-seconds", "frac sec", "seconds fraction"), 1.0),
}
_CLOCK = r"(\d{1,3}):(\d{2})(?::(\d{2})(?:[.,:](\d{1,9}))?|([.,]\d{1,9}))?\s*([AaPp]\.?[Mm]\.?)?"
_DATE = r"(\d{1,4})([-/. ])\s*(\d{1,2}|[^\W\d_]{3,9})\.?\2\s*(\d{1,4})"
_STAMP = re.compile(rf"(?:[^\W\d_]{{2,3}},?\s+)?{_DATE}(?:[T ,]\s*{_CLOCK}(Z|[+-]\d\d(?::?\d\d)?)?)?")
_CLOCK_ALONE = re.compile(_CLOCK)
_DATE_ANYWHERE = re.compile(rf"(?<![\d:]){_DATE}(?!\d)")
_CLOCK_BESIDE_DATE = re.compile(r"(\d{1,2})[:.h-](\d\d)(?:[:.m-](\d\d))?s?((?:[.,:]\d{1,9})?) ?((?:[AaPp]\.?[Mm]\.?)?)")
_DIGITS = re.compile(r"((?:19|20)\d\d)([01]\d)([0-3]\d)[T _-]?([0-2]\d)([0-5]\d)([0-5]\d)([.,]\d{1,9})?")
_ASCTIME = re.compile(r"[^\W\d_]{3} ([^\W\d_]{3}) +(\d{1,2}) (\d\d:\d\d:\d\d) (\d{4})")  # of C's asctime
UNPADDED = ", milliseconds without leading zeros,"
AS_OTHERS = "expected a time as in the other rows"
Match = re.Match[str]


@dataclass(frozen=True)
class Times:
    """Seconds from the first row (nan: an empty field); note: how they were read."""

    seconds: Array
    note: str


class _Unclear(Exception):
    """Times that can be read in several ways; layouts: the ways to choose from."""

    def __init__(self, text: str, layouts: Sequence[str] = ()) -> None:
        self.layouts = tuple(layouts)
        super().__init__(text)


def is_time(text: str) -> bool:
    """Return True if a field is a date, a clock's time, or both."""
    text = normalize_time(text)
    if not text[:1].isalnum() or len(text) > LONGEST or not any(c in text for c in ":-/. "):
        return False
    return _CLOCK_ALONE.fullmatch(text) is not None or _STAMP.fullmatch(text) is not None


def is_date(text: str) -> bool:
    """Return True if a field is a date without a time of the day."""
    match = _STAMP.fullmatch(normalize_time(text))
    return match is not None and match[5] is None


def is_clock_time(text: str) -> bool:
    """Return True if a field is a time without a date."""
    return _CLOCK_ALONE.fullmatch(text.strip().strip('"')) is not None


def normalize_time(text: str) -> str:
    """Return a date and time in one spelling: the date, a blank, and the clock with colons."""
    text = text.strip().strip('"').strip()
    if len(text) > LONGEST or _STAMP.fullmatch(text):
        return text
    if match := _DIGITS.fullmatch(text):
        return "{}-{}-{} {}:{}:{}".format(*match.groups()[:6]) + (match[7] or "")
    if match := _ASCTIME.fullmatch(text):
        return f"{match[2]}-{match[1]}-{match[4]} {match[3]}"
    if (date_found := _DATE_ANYWHERE.search(text)) is None:
        return text
    rest = text[: date_found.start()] + text[date_found.end() :]
    clock = _CLOCK_BESIDE_DATE.fullmatch(re.sub(r"(?<=\d) ?(?:UTC|GMT)$", "", rest).strip(" T,;_-/|:"))
    if clock is None:
        return text
    return f"{date_found[0]} {':'.join(filter(None, clock.groups()[:3]))}{clock[4]} {clock[5]}".strip()


def read_times(
    fields: Sequence[str], layout: str | None = None, option: Callable[[str], str] = lambda layout: layout
) -> Times:
    """Return times as seconds from the first row. Raises BadField for the first field that is no time, and for times
    that can be read in several ways.

    fields: texts, one a row, '' if there is none; layout: of `LAYOUTS`, if the user typed one, with 'dst' a change of
    summer time is taken out; option: returns what to type for a layout, for messages.
    """
    if layout is not None and layout.endswith(SUMMER_TIME):
        times = read_times(fields, layout.partition("+")[0] if "+" in layout else None, option)
        change = clock_changes(times.seconds)
        if not np.any(change):
            return times
        way = "back" if np.any(change > 0.0) else "on"
        note = f"{times.note}, an hour {way} at the change of summer time taken out"
        return Times(times.seconds + HOUR_S * np.cumsum(change), note)
    texts = [text.strip().strip('"') for text in fields]
    first = next((text for text in texts if text), "")
    if not _STAMP.fullmatch(first):
        texts = [normalize_time(text) for text in texts]
        first = next((text for text in texts if text), "")
    try:
        if _CLOCK_ALONE.fullmatch(first):
            return _clock_times(_matches(_CLOCK_ALONE, texts), layout)
        if first[:4].isdigit() and len(set(map(len, texts))) == 1:  # most are ISO times, which Python reads faster
            try:
                stamps = [datetime.fromisoformat(text) for text in texts]
                seconds = np.array([(stamp - stamps[0]).total_seconds() for stamp in stamps])
                return Times(seconds, "ISO times as seconds from the first row")
            except (ValueError, TypeError):  # no ISO times, or some with a zone and some without
                pass
        return _dated_times(_matches(_STAMP, texts), layout)
    except _Unclear as unclear:
        options = " or ".join(map(option, unclear.layouts))
        raise BadField(0, fields[0], f"{unclear}?" + (f" expected {options}" if options else "")) from None


def _matches(pattern: re.Pattern[str], texts: Sequence[str]) -> list[Match | None]:
    matches = [pattern.fullmatch(text) if text and len(text) <= LONGEST else None for text in texts]
    for row, (text, match) in enumerate(zip(texts, matches, strict=True)):
        if text and match is None:
            raise BadField(row, text, AS_OTHERS)
    return matches


def _seconds(matches: Sequence[Match | None], seconds_of: Callable[[Match], float]) -> Array:
    """Return the seconds of each field, nan for an empty one. Raises BadField."""
    seconds = np.full(len(matches), math.nan)
    for row, match in enumerate(matches):
        if match is not None:
            try:
                seconds[row] = seconds_of(match)
            except (ValueError, KeyError):
                raise BadField(row, match.string, AS_OTHERS) from None
    return seconds


def clock_changes(seconds: Array, change_s: float = HOUR_S) -> Array:
    """Return at each row 1 if the clock went back by change_s since the row before, -1 if it went on by so much, else
    0: the end and the begin of summer time."""
    steps = np.diff(seconds, prepend=seconds[:1])
    median = float(np.nanmedian(steps[1:])) if np.any(np.isfinite(steps[1:])) else 0.0
    within = max(CHANGE_TOLERANCE * median, 1.0)
    if not 0.0 < within < change_s / 2.0:
        return np.zeros(seconds.size)
    back = np.abs(steps + change_s - median) <= within
    return back.astype(np.float64) - (np.abs(steps - change_s - median) <= within)


def _clock_times(matches: Sequence[Match | None], layout: str | None) -> Times:
    """Return times of the day, or elapsed times."""
    known = [m for m in matches if m is not None]
    short = {m[3] is None for m in known}
    if len(short) > 1:
        raise _Unclear("times with seconds and times without")
    if short == {False}:
        unpadded = _has_unpadded_milliseconds(m[4] for m in known)
        return _unwrap(_seconds(matches, lambda m: _clock_s(m, 1, unpadded)), "a clock's times" + UNPADDED * unpadded)
    fraction = any(m[5] is not None for m in known)
    if layout is None and not fraction:
        raise _Unclear("hours and minutes, or minutes and seconds", ("hh:mm", "mm:ss"))
    if not fraction and layout != "mm:ss":
        return _unwrap(_seconds(matches, lambda m: _clock_s(m, 1)), "hours and minutes")
    raw = _seconds(matches, lambda m: 60.0 * int(m[1]) + int(m[2]) + float((m[5] or "0").replace(",", ".")))
    return _unwrap(raw, "minutes and seconds", HOUR_S)


def _has_unpadded_milliseconds(fractions: Iterable[str | None]) -> bool:
    """Return True if what follows the seconds counts milliseconds without leading zeros: 12:00:00:7 is 7 ms.

    Such counts have one to three digits, end in 0 now and then and never begin with it; decimals whose last zeros
    were left out are the other way round.
    """
    found = {fraction for fraction in fractions if fraction is not None}
    if len({len(fraction) for fraction in found}) < 2 or max(map(len, found)) > 3:
        return False
    longer = [fraction for fraction in found if len(fraction) > 1]
    return any(f.endswith("0") for f in longer) and not any(f.startswith("0") for f in longer)


def _clock_s(match: Match, group: int, unpadded: bool = False) -> float:
    """Return the seconds of a clock's time, whose first group this is."""
    hour, minute, second, fraction, _, half = match.groups()[group - 1 : group + 5]
    hours = int(hour)
    if half:
        if not 1 <= hours <= 12:
            raise ValueError(match.string)
        hours = hours % 12 + (12 if half[0] in "pP" else 0)
    if int(minute) > 59 or int(second or 0) > 60:
        raise ValueError(match.string)
    fraction = (fraction or "0").zfill(3) if unpadded else fraction or "0"
    return 3600.0 * hours + 60.0 * int(minute) + int(second or 0) + float(f"0.{fraction}")


def _unwrap(raw: Array, note: str, turn_s: float = DAY_S) -> Times:
    """Return times of a clock that begins again after turn_s, as seconds from the first row."""
    known = np.flatnonzero(np.isfinite(raw))
    turns = np.zeros(raw.size)
    turns[known[1:]] = np.cumsum(np.diff(raw[known]) < -turn_s / 2.0)
    passed = int(turns.max(initial=0.0))
    if passed and np.any(raw >= turn_s):
        raise _Unclear("elapsed times that go back")
    over = "midnight" if turn_s == DAY_S else "the full hour"
    often = {0: "", 1: f", once past {over}"}.get(passed, f", {passed} times past {over}")
    return Times(_from_first(raw + turn_s * turns), f"{note} as seconds from the first row{often}")


def _from_first(seconds: Array) -> Array:
    known = seconds[np.isfinite(seconds)]
    return np.round(seconds - known[0], 9) if known.size else seconds


def _dated_times(matches: Sequence[Match | None], layout: str | None) -> Times:
    """Return dates in the only order that their fields allow."""
    known = [m for m in matches if m is not None]
    if len({m[11] is None for m in known if m[5] is not None}) > 1:
        raise _Unclear("times with a zone and times without one")
    unpadded = _has_unpadded_milliseconds(m[8] for m in known)
    found: dict[str, Array] = {}
    failed: BadField | None = None
    for order in [layout] if layout in ORDERS else [order for order in ORDERS if _allows(known[0], order)]:
        try:
            found[order] = _in_order(matches, order, unpadded)
        except BadField as error:
            failed = error
    if not found:
        raise failed or BadField(0, known[0].string, AS_OTHERS)
    order = _plausible_order(found)
    text = "ISO times" if order == "ymd" and not unpadded else f"dates in the order {order}{UNPADDED * unpadded}"
    return Times(found[order], f"{text} as seconds from the first row")


def _allows(match: Match, order: str) -> bool:
    """Return True if a date's spelling allows an order: a year of four digits shows, and points separate d.m.y."""
    if len(match[1]) == 4:
        return order == "ymd"
    if len(match[4]) == 4 and order == "ymd":
        return False
    return order == "dmy" if match[2] == "." or not match[3].isdigit() else True


def _in_order(matches: Sequence[Match | None], order: str, unpadded: bool) -> Array:
    """Return seconds from the first row. Raises BadField if a date does not exist."""
    days = _seconds(matches, lambda m: _day((m[1], m[3], m[4]), order))
    clock_s = _seconds(matches, lambda m: _clock_s(m, 5, unpadded) - _zone_s(m[11]) if m[5] is not None else 0.0)
    return _from_first(DAY_S * _from_first(days) + clock_s)


@lru_cache(maxsize=1024)
def _day(fields: tuple[str, str, str], order: str) -> int:
    if not fields[1].isdigit():  # the month is a word
        fields = (fields[0], str(MONTHS[fields[1][:3].lower()]), fields[2])
        order = "ymd" if len(fields[0]) == 4 else "dmy"
    year, month, day = (int(fields[order.index(part)]) for part in "ymd")
    return date(year + 2000 if year < 100 else year, month, day).toordinal()


def _zone_s(zone: str | None) -> float:
    if zone in (None, "Z"):
        return 0.0
    digits = str(zone)[1:].replace(":", "").ljust(4, "0")
    return (-1.0 if str(zone)[0] == "-" else 1.0) * (3600.0 * int(digits[:2]) + 60.0 * int(digits[2:]))


def _plausible_order(found: dict[str, Array]) -> str:
    """Return the order of day and month that leaves no question."""
    rising = {order: s for order, s in found.items() if not np.any(np.diff(s) <= 0.0)} or found
    largest = {order: float(np.nanmax(np.diff(s), initial=0.0)) for order, s in rising.items()}
    best = min(largest, key=lambda order: largest[order])
    for order, seconds in rising.items():
        same = np.array_equal(seconds, rising[best], equal_nan=True)
        if not same and (largest[best] > DAY_S or largest[order] < largest[best] + DAY_S):
            raise _Unclear("day and month", tuple(sorted({best, order})))
    return best
