"""The content of a TOML file. Import-light, so that `peltier off` loads nothing else.

Refused here is what no schema could refuse: numbers of more than 64 bits, the character NUL, tables nested without end.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rig.core.faults import Faults, fault

MOST_BYTES = 50_000_000  # a model of 100,000 operators takes 20 MB
DEEPEST = 20  # tables and lists inside each other; a configuration needs five
SHOWN = 80  # characters of a value in a message


def read_toml(path: Path) -> dict[str, Any]:
    """Return the file's content. Raises Faults if it is missing, unreadable or no TOML."""
    return parsed_toml(read_text(path), path)


def read_text(path: Path, most_bytes: int = MOST_BYTES) -> str:
    """Return the file's text. Raises Faults if it is missing, no file, too large, or not UTF-8."""
    try:
        if path.exists() and not path.is_file():
            raise fault(path, "", "is no file")
        with path.open("rb") as file:
            content = file.read(most_bytes + 1)
        if len(content) > most_bytes:
            raise fault(path, "", f"is too large: expected at most {most_bytes // 1_000_000} MB")
        return content.decode("utf-8")
    except FileNotFoundError:
        raise fault(path, "", "no such file") from None
    except OSError as error:
        raise fault(path, "", f"cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise fault(path, f"byte {error.start}", "expected UTF-8 text") from None


def parsed_toml(text: str, where: Path) -> dict[str, Any]:
    """Return the tables in a text; where: the file, for messages. Raises Faults."""
    try:
        content = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise fault(where, "", f"is not valid TOML: {error}") from None
    except ValueError:  # Python's own bound on the digits of an integer
        raise fault(where, "", "is not valid TOML: an integer of too many digits; expected at most 64 bits") from None
    except RecursionError:
        raise fault(where, "", f"is not valid TOML: nested too deeply; expected at most {DEEPEST} levels") from None
    lines = [f"{where}: {line}" for line in _unusable_values(content)]
    if lines:
        raise Faults(lines[:20])
    return content


def _unusable_values(content: dict[str, Any]) -> Iterator[str]:
    left: list[tuple[str, Any, int]] = [("", content, 0)]
    while left:
        place, value, depth = left.pop()
        if depth > DEEPEST:
            yield f"{place[:SHOWN]}: nested too deeply; expected at most {DEEPEST} levels"
        elif isinstance(value, dict):
            for key, inner in value.items():
                if "\0" in key:
                    yield f"{place or 'the file'}: {shown(key)}: expected a key without the character NUL"
                left.append((f"{place}.{key}" if place else key, inner, depth + 1))
        elif isinstance(value, list):
            left += [(f"{place}[{k}]", inner, depth + 1) for k, inner in enumerate(value)]
        elif isinstance(value, str) and "\0" in value:
            yield f"{place}: expected text without the character NUL"
        elif isinstance(value, int) and not -(2**63) <= value < 2**63:
            yield f"{place}: an integer beyond 64 bits"


def shown(value: object) -> str:
    """Return a value as a message shows it: its beginning, if it is long."""
    text = repr(value)
    return text if len(text) <= SHOWN else f"{text[:SHOWN]}..."
