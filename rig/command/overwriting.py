"""What a verb reads is not what it writes: a record that was measured once is not replaced by what was made of it."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rig.core.faults import Faults

WRITTEN = ("out", "json", "report")


def refuse_overwriting(options: argparse.Namespace) -> None:
    """Raises Faults where a file to be written is one of those to be read, or is named twice."""
    given = vars(options)
    written = {name: Path(given[name]) for name in WRITTEN if given.get(name) not in (None, "-", "")}
    read = [path for name, value in given.items() if name not in WRITTEN for path in _files(value)]
    faults = [
        f"{path}: --{name}: is what is read; expected another file"
        for name, path in written.items()
        if _is_file(path) and any(path.samefile(other) for other in read)
    ]
    if "out" in written and written.get("json") == written["out"]:
        faults.append(f"{written['out']}: --out and --json: the same file; expected two")
    if faults:
        raise Faults(faults)


def _files(value: Any) -> Iterator[Path]:
    """The files that are there among an option's values."""
    for one in value if isinstance(value, (list, tuple)) else [value]:
        if isinstance(one, (str, Path)) and _is_file(one):
            yield Path(one)


def _is_file(path: str | Path) -> bool:
    """Whether a file is there; a text that can be no path is none."""
    try:
        return Path(path).is_file()
    except (OSError, ValueError):
        return False
