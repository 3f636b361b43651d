"""The content of a TOML file, and what else is made of a configuration's. Import-light: `peltier off` loads no more.

Refused here is what no schema could refuse: numbers of more than 64 bits, the character NUL, tables nested without end.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rig.core.faults import Faults, fault
from rig.core.json_text import SHOWN, unusable_values

MOST_BYTES = 50_000_000  # a model of 100,000 operators takes 20 MB
DEEPEST = 20  # tables and lists inside each other; a configuration needs five
SECRET_KEYS = ("token", "metrics_token", "webhook")  # of [serve]; who has a webhook's address can use it
PATH_KEYS = (("experiment", "target"), ("experiment", "learned"), ("simulation", "film", "model"))
OTHER_TABLES = ("serve", "sweep", "epics")  # not of the experiment; [serve] may hold secrets


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
    found = unusable_values(content, DEEPEST, finite=False)  # of numbers the schema says it, with all other faults
    lines = [f"{where}: {place or 'the file'}: {what}" for place, what in found]
    if lines:
        raise Faults(lines[:20])
    return content


def shown(value: object) -> str:
    """Return a value as a message shows it: its beginning, if it is long."""
    text = repr(value)
    return text if len(text) <= SHOWN else f"{text[:SHOWN]}..."


# ---- texts and digests of configurations ------------------------------------------------------------


def without_secrets(text: str) -> str:
    """Return the text of a configuration without the secrets of [serve], for people and run folders. Raises Faults.

    If they cannot be cut out by whole lines (an inline table, a secret that a comment repeats), the text is written
    anew from its TOML tables, without its comments.
    """
    import tomli_w

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
    import tomli_w

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
    import hashlib  # brings OpenSSL, for which `peltier off CONFIG` need not wait

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
