"""JSON as it is taken from others: UTF-8, numbers that are numbers, text that can be shown and kept. Import-light.

Python's own reader lets more pass: halves of surrogate pairs, which no file, no database and no other program takes;
the words NaN and Infinity; integers and depths at which it raises something else than a fault.
"""

from __future__ import annotations

import json
import math
from typing import Any

DEEPEST = 50  # lists and objects inside each other
LARGEST = 2**63


def parsed_json(content: bytes | str) -> Any:
    """The value. Raises ValueError with what is expected."""
    try:
        text = content.decode("utf-8") if isinstance(content, bytes) else content
    except UnicodeDecodeError as error:
        raise ValueError(f"byte {error.start}: expected UTF-8 text") from None
    try:
        value = json.loads(text, parse_constant=_no_number)
    except RecursionError:
        raise ValueError(f"nested too deeply; expected at most {DEEPEST} levels") from None
    except json.JSONDecodeError as error:
        raise ValueError(f"character {error.pos}: expected JSON") from None
    except ValueError as error:
        raise ValueError(str(error) if isinstance(error, _NoNumber) else "expected numbers of fewer digits") from None
    _check(value)
    return value


class _NoNumber(ValueError):
    """NaN or Infinity."""


def _no_number(word: str) -> Any:
    raise _NoNumber(f"{word}: expected a finite number")


def _check(value: Any) -> None:
    left = [(value, 0)]
    while left:
        inner, depth = left.pop()
        if depth > DEEPEST:
            raise ValueError(f"nested too deeply; expected at most {DEEPEST} levels")
        if isinstance(inner, dict):
            left += [(entry, depth + 1) for pair in inner.items() for entry in pair]
        elif isinstance(inner, list):
            left += [(entry, depth + 1) for entry in inner]
        elif isinstance(inner, str) and not usable(inner):
            raise ValueError("text: expected valid Unicode without the character NUL")
        elif isinstance(inner, int) and not -LARGEST <= inner < LARGEST:
            raise ValueError("a number: expected an integer of at most 64 bits")
        elif isinstance(inner, float) and not math.isfinite(inner):
            raise ValueError("a number: expected one that is finite")


def usable(text: str) -> bool:
    """Whether text can be shown and kept: no half of a surrogate pair, no NUL."""
    try:
        text.encode("utf-8")
    except UnicodeEncodeError:
        return False
    return "\0" not in text


def finite(value: Any) -> Any:
    """The value with null for what is no finite number, however deep inside it."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: finite(entry) for key, entry in value.items()}
    return [finite(entry) for entry in value] if isinstance(value, (list, tuple)) else value
