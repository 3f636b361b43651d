"""Fields of a text file as times: ISO dates, dates in other orders, a clock's time of the day, elapsed h:mm:ss.

All become seconds from the first row. 03/04/2026 is read in both orders; where both give the same seconds, or one of
them would go back or leave a gap of days where the other leaves none, there is no question, else it is asked for:
`time_s=Date@dmy` or `@mdy`. A clock that goes back by more than half a day has passed midnight.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import date, datetime

import numpy as np

from compensator.hysteresis.functions import Array
from rig.core.clock import DAY_S

ORDERS = ("ymd", "dmy", "mdy")
SUMMER = "dst"  # local time, in which an hour comes twice at the end of summer time
LAYOUTS = (*ORDERS, "hh:mm", "mm:ss", SUMMER, *(f"{order}+{SUMMER}" for order in ORDERS))
LONGEST = 60  # characters of a time
HOUR_STEPS = 3.0  # usual steps by which a clock's hour may be off: rows are not read on the second
HOUR_S = 3600.0  # after which minutes and seconds begin again
MONTHS = {"jan": 1, "feb": 2, "mar": 3, "apr": 4, "may": 5, "jun": 6, "jul": 7, "aug": 8, "sep": 9, "oct": 10}
MONTHS |= {"nov": 11, "dec": 12, "mai": 5, "okt": 10, "dez": 12, "mrz": 3, "mär": 3}
# names of columns that have the fraction of a second, and what is a second's part in them
PARTS = {
    **dict.fromkeys(("ms", "msec", "msecs", "millis", "millisecond", "milliseconds", "millisec", "milli"), 1e-3),
    **dict.fromkeys(("us", "usec", "usecs", "microsecond", "microseconds", "tv_usec", "micros"), 1e-6),
    **dict.fromkeys(("ns", "nsec", "nsecs", "nanosecond", "nanoseconds", "nanosec", "tv_nsec"), 1e-9),
    **dict.fromkeys(("fractional seconds", "fractional second", "fraction", "frac", "fraction of second"), 1.0),
    **dict.fromkeys(("fractional_seconds", "subsec", "subseconds", "sub-seconds", "frac sec", "seconds fraction"), 1.0),
}
UNPADDED = ", milliseconds without leading zeros,"
CLOCK = r"(\d{1,3}):(\d{2})(?::(\d{2})(?:[.,:](\d{1,9}))?|([.,]\d{1,9}))?\s*([AaPp]\.?[Mm]\.?)?"
DATE = r"(\d{1,4})([-/. ])\s*(\d{1,2}|[^\W\d_]{3,9})\.?\2\s*(\d{1,4})"
STAMP = re.compile(rf"(?:[^\W\d_]{{2,3}},?\s+)?{DATE}(?:[T ,]\s*{CLOCK})?")
ALONE = re.compile(rf"{CLOCK}")
# ways of writing that become the one above: digits alone, the clock first, another sign behind the date or within the
# clock, and C's asctime
COMPACT = re.compile(r"((?:19|20)\d\d)([01]\d)([0-3]\d)[T _-]?([0-2]\d)([0-5]\d)([0-5]\d)([.,]\d{1,9})?")
CLOCK_FIRST = re.compile(
    r"(\d{1,2}:\d\d:\d\d(?:[.,]\d{1,9})?(?: ?[AaPp][Mm])?)[ ,;_-]+(\d{1,4}([-/.])\d{1,2}\3\d{1,4})"
)
OTHER_SIGNS = re.compile(
    r"(\d{1,4}([-/. ])(?:\d{1,2}|[^\W\d_]{3,9})\2\d{1,4})\s*[-_/;|T ,:]\s*"
    r"(\d{1,2})([:.h-])(\d\d)(?:[:.m-](\d\d))?s?((?:[.,:]\d{1,9})?)((?: ?[AaPp][Mm])?)"
)
ASCTIME = re.compile(r"[^\W\d_]{3} ([^\W\d_]{3}) +(\d{1,2}) (\d\d:\d\d:\d\d) (\d{4})")


@dataclass(frozen=True)
class Times:
    """seconds: from the first row, nan where the field is empty; said: how they were read, in words."""

    seconds: Array
    said: str


class Unclear(ValueError):
    """Times that can be read in more than one way; layouts: those to choose from."""

    def __init__(self, text: str, layouts: Sequence[str] = ()) -> None:
        self.layouts = tuple(layouts)
        super().__init__(text)


def time_like(text: str) -> bool:
    """Whether a field is a date, a clock's time, or both."""
    text = straight(text)
    if not text[:1].isalnum() or len(text) > LONGEST or not any(c in text for c in ":-/. "):
        return False
    if ALONE.fullmatch(text):
        return True
    return STAMP.fullmatch(text) is not None or _iso(text) is not None


def date_alone(text: str) -> bool:
    """Whether a field is a date without a time of the day."""
    match = STAMP.fullmatch(straight(text))
    return match is not None and match[5] is None


def straight(text: str) -> str:
    """A date with a clock's time in the one way of writing that is read: the date, a blank, and colons."""
    text = text.strip().strip('"').strip()
    if len(text) > LONGEST or STAMP.fullmatch(text):
        return text
    text = re.sub(r"(?<=\d) ?(?:UTC|GMT)$", "", text)
    if match := COMPACT.fullmatch(text):
        return "{}-{}-{} {}:{}:{}".format(*match.groups()[:6]) + (match[7] or "")
    if match := CLOCK_FIRST.fullmatch(text):
        return f"{match[2]} {match[1]}"
    if match := ASCTIME.fullmatch(text):
        return f"{match[2]}-{match[1]}-{match[4]} {match[3]}"
    if match := OTHER_SIGNS.fullmatch(text):
        seconds = f":{match[6]}" if match[6] else ""
        return f"{match[1]} {match[3]}:{match[5]}{seconds}{match[7]}{match[8]}"
    return text


def clock_alone(text: str) -> bool:
    """Whether a field is a time without a date."""
    return ALONE.fullmatch(text.strip().strip('"')) is not None


def read_times(fields: Sequence[str], layout: str | None = None) -> Times:
    """Seconds from the first row. Raises Unclear, and ValueError with the field that is no time.

    layout: 'dmy', 'mdy', 'ymd', 'hh:mm' or 'mm:ss', where somebody typed it; 'dst', or one of the first three with
    '+dst', of local times in which an hour comes twice, or is missing.
    """
    if layout is not None and layout.endswith(SUMMER):
        return _without_summer_time(read_times(fields, layout.partition("+")[0] if "+" in layout else None))
    texts = [text.strip().strip('"') for text in fields]
    if not STAMP.fullmatch(next((text for text in texts if text), "")):
        texts = [straight(text) for text in texts]
    first = next((text for text in texts if text), "")
    if ALONE.fullmatch(first):
        return _clock_times(texts, layout)
    clocks = [STAMP.fullmatch(text) for text in texts] if len({len(text) for text in texts}) > 1 else []
    if _unpadded(m[8] for m in clocks if m is not None):
        return _dated_times(texts, layout)
    try:
        stamps = [datetime.fromisoformat(text) if text else None for text in texts]
    except ValueError:
        return _dated_times(texts, layout)
    start = next(stamp for stamp in stamps if stamp is not None)
    try:
        seconds = np.array([(s - start).total_seconds() if s is not None else math.nan for s in stamps])
    except TypeError:
        raise ValueError("times with a zone and times without one") from None
    return Times(seconds, "ISO times as seconds from the first row")


def _iso(text: str) -> datetime | None:
    if not re.match(r"\d{4}-\d", text):
        return None
    try:
        return datetime.fromisoformat(text)
    except ValueError:
        return None


def hours_off(seconds: Array, off_s: float = HOUR_S) -> Array:
    """At each row 1 where a clock went back by an hour since the row before, -1 where it went on by one more than its
    usual step, else 0: the end and the begin of summer time. off_s: another time than an hour."""
    steps = np.diff(seconds, prepend=seconds[:1])
    usual = float(np.nanmedian(steps[1:])) if np.any(np.isfinite(steps[1:])) else 0.0
    within = max(HOUR_STEPS * usual, 1.0)
    if not 0.0 < within < off_s / 2.0:
        return np.zeros(seconds.size)
    back = np.abs(steps + off_s - usual) <= within
    return back.astype(np.float64) - (np.abs(steps - off_s - usual) <= within)


def _without_summer_time(times: Times) -> Times:
    off = hours_off(times.seconds)
    count = int(np.sum(off != 0.0))
    said = f"{times.said}, an hour {'back' if np.any(off > 0.0) else 'on'} at the change of summer time taken out"
    return Times(times.seconds + HOUR_S * np.cumsum(off), said) if count else times


def _clock_times(texts: Sequence[str], layout: str | None) -> Times:
    """Times of the day, or elapsed ones."""
    matches = []
    for text in texts:
        match = ALONE.fullmatch(text) if text else None
        if text and match is None:
            raise ValueError(text)
        matches.append(match)
    short = {m[3] is None for m in matches if m is not None}
    if len(short) > 1:
        raise Unclear("times with seconds and times without")
    if short == {True}:
        return _short_times(matches, layout)
    unpadded = _unpadded(m[4] for m in matches if m is not None)
    raw = np.array([_seconds_of(m, unpadded) if m is not None else math.nan for m in matches])
    return _over_midnight(raw, f"a clock's times{UNPADDED if unpadded else ''}")


def _short_times(matches: Sequence[re.Match[str] | None], layout: str | None) -> Times:
    """Two numbers only: minutes and seconds where there are decimals, else somebody has to say."""
    fraction = any(m is not None and m[5] is not None for m in matches)
    if layout is None and not fraction:
        raise Unclear("hours and minutes, or minutes and seconds", ("hh:mm", "mm:ss"))
    if not fraction and layout != "mm:ss":
        raw = np.array([_seconds_of(m) if m is not None else math.nan for m in matches])
        return _over_midnight(raw, "hours and minutes")
    raw = np.full(len(matches), math.nan)
    for k, m in enumerate(matches):
        if m is not None:
            raw[k] = 60.0 * int(m[1]) + int(m[2]) + float((m[5] or "0").replace(",", "."))
    return _over_midnight(raw, "minutes and seconds", HOUR_S)


def _unpadded(fractions: Iterable[str | None]) -> bool:
    """Whether what stands behind full seconds counts milliseconds without leading zeros: 12:00:00:7 is 7 ms then.

    Such numbers are of one to three digits, end in 0 now and then, and never begin with it; decimals of which the last
    zeros were left out are the other way round.
    """
    told = {fraction for fraction in fractions if fraction is not None}
    if len({len(fraction) for fraction in told}) < 2 or max(map(len, told)) > 3:
        return False
    longer = [fraction for fraction in told if len(fraction) > 1]
    return any(f.endswith("0") for f in longer) and not any(f.startswith("0") for f in longer)


def _seconds_of(match: re.Match[str], unpadded: bool = False) -> float:
    """The time of the day of a clock's match, in seconds."""
    return _day_seconds(match[1], match[2], match[3], match[4], match[6], unpadded)


def _day_seconds(
    hour: str, minute: str, second: str | None, fraction: str | None, half: str | None, unpadded: bool = False
) -> float:
    hours = int(hour)
    fraction = fraction.zfill(3) if fraction is not None and unpadded else fraction
    if half:
        if not 1 <= hours <= 12:
            raise ValueError(f"{hour}:{minute} {half}")
        hours = hours % 12 + (12 if half[0] in "pP" else 0)
    if int(minute) > 59 or int(second or 0) > 60 or (half is not None and hours > 24):
        raise ValueError(f"{hour}:{minute}:{second}")
    return 3600.0 * hours + 60.0 * int(minute) + int(second or 0) + (float(f"0.{fraction}") if fraction else 0.0)


def _over_midnight(raw: Array, said: str, turn_s: float = DAY_S) -> Times:
    """Times of a clock that begins again, as seconds from the first row."""
    known = np.flatnonzero(np.isfinite(raw))
    steps = np.diff(raw[known])
    turns = np.zeros(raw.size)
    turns[known[1:]] = np.cumsum(steps < -turn_s / 2.0)
    passed = int(turns.max(initial=0.0))
    if passed and np.any(raw >= turn_s):
        raise Unclear("elapsed times that go back")
    seconds = raw + turn_s * turns
    if known.size:
        seconds = np.round(seconds - seconds[known[0]], 9)
    over = "midnight" if turn_s == DAY_S else "the full hour"
    return Times(
        seconds,
        f"{said} as seconds from the first row"
        + (f", once past {over}" if passed == 1 else f", {passed} times past {over}" if passed else ""),
    )


def _dated_times(texts: Sequence[str], layout: str | None) -> Times:
    """Dates in the order that the fields allow."""
    matches = []
    for text in texts:
        match = STAMP.fullmatch(text) if text and len(text) <= LONGEST else None
        if text and match is None:
            raise ValueError(text)
        matches.append(match)
    unpadded = _unpadded(m[8] for m in matches if m is not None)
    orders = [layout] if layout in ORDERS else [order for order in ORDERS if _allows(matches, order)]
    found: dict[str, Array] = {}
    failed: ValueError | None = None
    for order in orders:
        try:
            found[order] = _in_order(matches, order, unpadded)
        except ValueError as error:
            failed = error
    if not found:
        raise failed or ValueError(next(text for text in texts if text))
    order = _plain_order(found)
    said = f"dates in the order {order}{UNPADDED if unpadded else ''} as seconds from the first row"
    return Times(found[order], said)


def _allows(matches: Sequence[re.Match[str] | None], order: str) -> bool:
    """Whether the way of writing allows an order: a year of four digits stands where it stands; a point parts d.m.y."""
    first = next(m for m in matches if m is not None)
    if len(first[1]) == 4:
        return order == "ymd"
    if len(first[4]) == 4 and order == "ymd":
        return False
    return order == "dmy" if first[2] == "." or not first[3].isdigit() else True


def _in_order(matches: Sequence[re.Match[str] | None], order: str, unpadded: bool) -> Array:
    """Seconds from the first row. Raises ValueError where a date does not exist."""
    days: dict[tuple[str, str, str], int] = {}
    seconds = np.full(len(matches), math.nan)
    start: int | None = None
    for k, m in enumerate(matches):
        if m is None:
            continue
        key = (m[1], m[3], m[4])
        if key not in days:
            try:
                days[key] = _day(dict(zip(order, key, strict=True))) if m[3].isdigit() else _named_day(key)
            except ValueError:
                raise ValueError(m.string) from None
        start = days[key] if start is None else start
        clock = _day_seconds(m[5], m[6], m[7], m[8], m[10], unpadded) if m[5] is not None else 0.0
        seconds[k] = DAY_S * (days[key] - start) + clock
    known = np.flatnonzero(np.isfinite(seconds))
    return np.asarray(np.round(seconds - seconds[known[0]], 9), dtype=np.float64)


def _day(parts: dict[str, str]) -> int:
    year = int(parts["y"])
    return date(year + 2000 if year < 100 else year, int(parts["m"]), int(parts["d"])).toordinal()


def _named_day(key: tuple[str, str, str]) -> int:
    """A day whose month is a word."""
    month = MONTHS.get(key[1][:3].lower())
    if month is None:
        raise ValueError(" ".join(key))
    year, day = (key[0], key[2]) if len(key[0]) == 4 else (key[2], key[0])
    return _day({"y": year, "m": str(month), "d": day})


def _plain_order(found: dict[str, Array]) -> str:
    """The order that leaves no question. Raises Unclear."""
    rising = {order: s for order, s in found.items() if not np.any(np.diff(s) <= 0.0)} or found
    largest = {order: float(np.nanmax(np.diff(s), initial=0.0)) for order, s in rising.items()}
    best = min(largest, key=lambda order: largest[order])
    for order, seconds in rising.items():
        same = np.array_equal(seconds, rising[best], equal_nan=True)
        if not same and (largest[best] > DAY_S or largest[order] < largest[best] + DAY_S):
            raise Unclear("day and month", tuple(sorted({best, order})))
    return best
