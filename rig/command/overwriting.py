"""What a verb reads is not what it writes, and neither is what a run has written: a record that was measured once is
not replaced by what was made of it, nor by anything else."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rig.core.faults import Faults

WRITTEN = ("out", "json", "report")
DOCUMENT = "run.json"  # what tells a run's folder from others
# What a run's folder has from its run (rig/records/run_folder.py): measured once, or said of what was. A file of
# another name beside these is whoever's it was, and may be written again.
OF_A_RUN = frozenset(
    (DOCUMENT, "record.csv", "record.nc", "events.jsonl", "config.toml", "target.csv", "learned.csv", "predicted.csv")
) | {"model.toml", "MODEL.toml", "report.html"}


def refuse_overwriting(options: argparse.Namespace) -> None:
    """Raises Faults where a file to be written is one of those to be read, or a run's, or is named twice."""
    given = vars(options)
    written = {name: Path(given[name]) for name in WRITTEN if given.get(name) not in (None, "-", "")}
    read = [path for name, value in given.items() if name not in WRITTEN for path in _files(value)]
    faults = [
        f"{path}: --{name}: is what is read; expected another file"
        for name, path in written.items()
        if _is_file(path) and any(path.samefile(other) for other in read)
    ]
    faults += [
        f"{path}: --{name}: belongs to the run in {path.parent}; expected another file"
        for name, path in written.items()
        if path.name in OF_A_RUN and _is_file(path) and _is_file(path.parent / DOCUMENT)
    ]
    if "report" in written and _is_file(written["report"] / DOCUMENT):
        faults.append(f"{written['report']}: --report: is a run's folder; expected another, such as one inside it")
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
