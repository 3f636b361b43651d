"""JSON from other programs, checked: UTF-8, finite numbers, text that can be shown and stored. Import-light.

Python's reader accepts more: halves of surrogate pairs, which no file and no database stores; the words NaN and
Infinity; integers and depths at which it raises something else than a ValueError.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from typing import Any

DEEPEST = 50  # lists and objects inside each other
LARGEST = 2**63
SHOWN = 80  # characters of a name in a message


class _NotFinite(ValueError):
    """NaN or Infinity."""


def parsed_json(content: bytes | str) -> Any:
    """Return the value. Raises ValueError with what is expected."""
    try:
        text = content.decode("utf-8") if isinstance(content, bytes) else content
        value = json.loads(text, parse_constant=_refuse)
    except UnicodeDecodeError as error:
        raise ValueError(f"byte {error.start}: expected UTF-8 text") from None
    except RecursionError:
        raise ValueError(f"nested too deeply; expected at most {DEEPEST} levels") from None
    except json.JSONDecodeError as error:
        raise ValueError(f"character {error.pos}: expected JSON") from None
    except _NotFinite:
        raise
    except ValueError:
        raise ValueError("expected numbers of fewer digits") from None
    for place, what in unusable_values(value, DEEPEST, finite=True):
        raise ValueError(f"{place}: {what}" if place else what)
    return value


def _refuse(word: str) -> Any:
    raise _NotFinite(f"{word}: expected a finite number")


def unusable_values(content: Any, deepest: int, finite: bool) -> Iterator[tuple[str, str]]:
    """Yield the place of each value that cannot be shown or stored, and what is expected there. finite: numbers have to
    be."""
    left: list[tuple[str, Any, int]] = [("", content, 0)]
    while left:
        place, value, depth = left.pop()
        if depth > deepest:
            yield place[:SHOWN], f"nested too deeply; expected at most {deepest} levels"
        elif isinstance(value, dict):
            for key, inner in value.items():
                if not usable(key):
                    yield place, f"{key[:SHOWN]!r}: expected a key of valid Unicode without the character NUL"
                left.append((f"{place}.{key}" if place else key, inner, depth + 1))
        elif isinstance(value, list):
            left += [(f"{place}[{k}]", inner, depth + 1) for k, inner in enumerate(value)]
        elif isinstance(value, str) and not usable(value):
            yield place, "expected text of valid Unicode without the character NUL"
        elif isinstance(value, int) and not -LARGEST <= value < LARGEST:
            yield place, "expected an integer of at most 64 bits"
        elif finite and isinstance(value, float) and not math.isfinite(value):
            yield place, "expected a finite number"


def usable(text: str) -> bool:
    """Return True if a text can be shown and stored: no half of a surrogate pair, no NUL."""
    try:
        text.encode("utf-8")
    except UnicodeEncodeError:
        return False
    return "\0" not in text


def finite(value: Any) -> Any:
    """Return the value with null in place of nan and infinities, for the daemon's answers.

    Files keep infinities as text (`rig.records.run_folder.plain_json`): they say at which end an instrument was beyond
    its range. Readers of an answer want a number or none.
    """
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: finite(entry) for key, entry in value.items()}
    return [finite(entry) for entry in value] if isinstance(value, (list, tuple)) else value
