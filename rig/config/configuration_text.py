"""The secrets of [serve] taken out of a configuration's text, before anybody is shown it or a run folder keeps it."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import tomli_w

from rig.config.toml_file import parsed_toml, read_toml
from rig.core.faults import Faults

SECRET_KEYS = ("token", "metrics_token", "webhook")  # a webhook's address is all that its receiver asks for


def without_secrets(text: str) -> str:
    """The text of a configuration without the secrets that TOML finds in it, as it was otherwise. Raises Faults.

    Where they cannot be cut out by whole lines (an inline table, a secret that a comment repeats), the text is written
    anew from what TOML makes of it, without its comments.
    """
    raw = parsed_toml(text, Path("text"))
    table = raw.get("serve")
    values = [table[key] for key in SECRET_KEYS if key in table] if isinstance(table, dict) else []
    if not isinstance(table, dict) or not values:
        return text
    cut = "".join(line for line in text.splitlines(keepends=True) if line.partition("=")[0].strip() not in _spellings())
    wanted = {**raw, "serve": {key: value for key, value in table.items() if key not in SECRET_KEYS}}
    try:
        if parsed_toml(cut, Path("text")) == wanted and not any(str(value) in cut for value in values):
            return cut
    except Faults:
        pass  # a secret of several lines: the cut left a part of it
    return tomli_w.dumps(wanted)


def _spellings() -> set[str]:
    """How a line with a secret may begin."""
    plain = {f"{table}{key}" for table in ("", "serve.") for key in SECRET_KEYS}
    return plain | {f'"{key}"' for key in SECRET_KEYS} | {f"'{key}'" for key in SECRET_KEYS}


FILES = (("experiment", "target"), ("experiment", "learned"), ("simulation", "film", "model"))
LEFT_OUT = ("serve", "sweep", "epics")  # they say nothing of an experiment, and [serve] may hold secrets


def extended_configuration(path: Path, model: Path) -> str:
    """The configuration at `path` with this model in experiment.model and no laws to compare with. Raises Faults."""
    raw = {name: table for name, table in read_toml(path).items() if name not in LEFT_OUT}
    raw["experiment"] = {**_table(raw.get("experiment")), "model": str(model.absolute()), "compare": []}
    for place in FILES:
        _make_whole(raw, place, path.parent)
    simulation = _table(raw.get("simulation"))
    if isinstance(simulation.get("effect_files"), list):
        simulation["effect_files"] = [_whole(name, path.parent) for name in simulation["effect_files"]]
    for role in ("controller", "meter"):
        table = _table(_table(raw.get("bench")).get(role))
        if ".py:" in str(table.get("driver")):
            table["driver"] = _whole(table["driver"], path.parent)
    return tomli_w.dumps(raw)


def _table(value: Any) -> dict[str, Any]:
    """What is no table is left for the schema to refuse."""
    return value if isinstance(value, dict) else {}


def _make_whole(raw: dict[str, Any], place: tuple[str, ...], folder: Path) -> None:
    *tables, key = place
    inner = raw
    for name in tables:
        inner = _table(inner.get(name))
    if key in inner:
        inner[key] = _whole(inner[key], folder)


def _whole(name: Any, folder: Path) -> Any:
    """A path from a configuration in a folder; what is no text (a profile in words) stays."""
    return str((folder / name).absolute()) if isinstance(name, str) else name


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
