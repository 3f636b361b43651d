"""Texts of configurations: without secrets, with another model; and the files that a configuration names."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import tomli_w

from rig.config.toml_file import parsed_toml, read_toml
from rig.core.faults import Faults

SECRET_KEYS = ("token", "metrics_token", "webhook")  # of [serve]; who has a webhook's address can use it
PATH_KEYS = (("experiment", "target"), ("experiment", "learned"), ("simulation", "film", "model"))
OTHER_TABLES = ("serve", "sweep", "epics")  # not of the experiment; [serve] may hold secrets


def without_secrets(text: str) -> str:
    """Return the text of a configuration without the secrets of [serve], for people and run folders. Raises Faults.

    If they cannot be cut out by whole lines (an inline table, a secret that a comment repeats), the text is written
    anew from its TOML tables, without its comments.
    """
    raw = parsed_toml(text, Path("text"))
    table = raw.get("serve")
    values = [table[key] for key in SECRET_KEYS if key in table] if isinstance(table, dict) else []
    if not isinstance(table, dict) or not values:
        return text
    spellings = {spelling for key in SECRET_KEYS for spelling in (key, f"serve.{key}", f'"{key}"', f"'{key}'")}
    cut = "".join(line for line in text.splitlines(keepends=True) if line.partition("=")[0].strip() not in spellings)
    wanted = {**raw, "serve": {key: value for key, value in table.items() if key not in SECRET_KEYS}}
    try:
        if parsed_toml(cut, Path("text")) == wanted and not any(str(value) in cut for value in values):
            return cut
    except Faults:
        pass  # a secret of several lines: a part of it is left
    return tomli_w.dumps(wanted)


def configuration_with_model(path: Path, model: Path) -> str:
    """Return the text of a configuration with another model and no laws to compare with. Raises Faults.

    Its paths are whole, so that the text may be stored anywhere.
    """
    folder = path.parent
    raw = {name: table for name, table in read_toml(path).items() if name not in OTHER_TABLES}
    raw["experiment"] = {**_table(raw.get("experiment")), "model": str(model.absolute()), "compare": []}
    for *tables, key in PATH_KEYS:
        inner = raw
        for name in tables:
            inner = _table(inner.get(name))
        if key in inner:
            inner[key] = _whole_path(inner[key], folder)
    simulation = _table(raw.get("simulation"))
    if isinstance(simulation.get("effect_files"), list):
        simulation["effect_files"] = [_whole_path(name, folder) for name in simulation["effect_files"]]
    for role in ("controller", "meter"):
        table = _table(_table(raw.get("bench")).get(role))
        if ".py:" in str(table.get("driver")):
            table["driver"] = _whole_path(table["driver"], folder)
    return tomli_w.dumps(raw)


def _table(value: Any) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}  # the schema refuses anything else


def _whole_path(name: Any, folder: Path) -> Any:
    return str((folder / name).absolute()) if isinstance(name, str) else name  # a profile in words is no path


def digest_named_files(tables: Any, folder: Path) -> dict[str, str]:
    """Return a digest of each file that a text in TOML tables names, by that text; "bath.py:JulaboBath" names bath.py.

    Two configurations with the same words and another target.csv beside them differ. Files that a TOML file among them
    names are included.
    """
    found: dict[str, str] = {}
    seen: set[Path] = set()
    left = [("", text, folder) for text in _texts(tables)]
    while left:
        source, text, where = left.pop(0)
        for name in (text, text.rpartition(":")[0]):
            path = where / name
            try:
                if not name or path in seen or not path.is_file():
                    continue
                found[f"{source} {name}"] = hashlib.sha256(path.read_bytes()).hexdigest()
                seen.add(path)
                inner = read_toml(path) if path.suffix == ".toml" else {}
            except (OSError, ValueError, Faults):  # no name of a file, or a file that its reader refuses
                continue
            left[:0] = [(f"{source} {name}", each, path.parent) for each in _texts(inner)]
    return found


def _texts(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, (dict, list, tuple)):
        for inner in value.values() if isinstance(value, dict) else value:
            yield from _texts(inner)
