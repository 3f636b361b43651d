"""Which files tables of TOML name, and what is in them: two configurations with the same words and another target.csv
beside them are two."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rig.core.faults import Faults
from rig.files.toml_text import read_toml


def contents_named(tables: Any, folder: Path) -> dict[str, str]:
    """A digest of the content of every file that a text in the tables names, beside `folder`, by that text; those that
    a TOML file among them names as well. "bath.py:JulaboBath" names bath.py."""
    found: dict[str, str] = {}
    _collect(tables, folder, "", found, set())
    return found


def _collect(tables: Any, folder: Path, of: str, found: dict[str, str], seen: set[Path]) -> None:
    """of: the file that names these, as it was named; seen: files that were met, which may name one another."""
    for text in _texts(tables):
        for name in (text, text.rpartition(":")[0]):
            path = folder / name
            try:
                if not name or path in seen or not path.is_file():
                    continue
                found[f"{of} {name}"] = hashlib.sha256(path.read_bytes()).hexdigest()
            except (OSError, ValueError):  # a text that is no name of a file
                continue
            seen.add(path)
            if path.suffix == ".toml":
                try:
                    inner = read_toml(path)
                except Faults:  # whoever needs it says so
                    continue
                _collect(inner, path.parent, f"{of} {name}", found, seen)


def _texts(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        for inner in value.values():
            yield from _texts(inner)
    elif isinstance(value, (list, tuple)):
        for inner in value:
            yield from _texts(inner)
