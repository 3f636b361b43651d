"""A run as its report sees it: its document and its rows, just recorded or read from its folder.

live_run         a run that this process has just recorded
recorded_run     a folder that was written some time: DIR, or DIR.part of a run that ended early
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from rig.core.faults import Faults, fault
from rig.core.json_text import parsed_json
from rig.drivers.controller import OF_FULL_DRIVE
from rig.records.run_folder import RunFolder, plain_json

FORMAT = "peltier-run/1"
CALIBRATION = "calibration"
LAW = "law "  # then its name: what a tracking run's document says that it is
LAWS = ("full", "pid", "feedforward", "instrument_pid")
NEEDED = ("temperature_degC", "current_A")
PHASE = "phase"


class RunRows:
    """A run as its report sees it. path: the folder that it has at its end; part: where its files are now.

    Its rows are read when they are first asked for, which raises Faults.
    """

    def __init__(self, folder: Path, document: dict[str, Any], columns: Mapping[str, Any] | None = None) -> None:
        self.path = folder.with_name(folder.name.removesuffix(".part"))
        self.part = folder
        self.document = document
        self._given = columns

    @cached_property
    def columns(self) -> Mapping[str, Any]:
        """Columns by name."""
        return self._given if self._given is not None else _columns_on_disk(self.part / "record.csv")

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self.columns["time_s"])

    def column(self, name: str) -> Any:
        """Return a column, nan in every row if the record does not have it."""
        found = self.columns.get(name)
        return found if found is not None else np.full(self.rows, np.nan)


def live_run(folder: RunFolder) -> RunRows:
    """Return a run that this process has just recorded, its document as it would be read from disk."""
    document = json.loads(plain_json(folder.document))
    return RunRows(folder.part, document, {name: folder.column(name) for name in folder.columns})


def _columns_on_disk(path: Path) -> dict[str, Any]:
    from rig.records.record_file import read_record
    from rig.records.run_table import read_run_columns

    with suppress(OSError):  # told by what reads it then
        if (columns := read_run_columns(path)) is not None and set(NEEDED) <= set(columns):
            return columns
    record = read_record(path, needs=NEEDED, options=False)
    if PHASE not in record.text_columns:
        raise fault(path, PHASE, "missing; expected the record of a run")
    return {**record.raw_columns(), **{name: np.array(texts) for name, texts in record.text_columns.items()}}


def recorded_inside(folder: Path) -> list[RunRows]:
    """Return the runs inside a folder without a run.json of its own: of a run that ended before its own law began, as
    while it calibrated. Raises Faults if one cannot be read."""
    if not folder.is_dir() or any((folder / name).exists() for name in ("run.json", "run.json.new")):
        return []
    names = [f"{name}{ending}" for name in (CALIBRATION, *LAWS) for ending in ("", ".part")]
    return [recorded_run(folder / name) for name in names if (folder / name / "run.json").is_file()]


def recorded_run(folder: Path) -> RunRows:
    """Return the run in a folder. Raises Faults if there is none."""
    file = folder / "run.json"
    try:
        there, text = folder.is_dir(), file.read_bytes() if folder.is_dir() else b""
    except FileNotFoundError:
        part = folder / "run.json.new"
        raise fault(folder, "", f"no {'whole ' if part.exists() else ''}run.json; expected a run folder") from None
    except (OSError, ValueError) as error:  # ValueError: a NUL in a path
        raise fault(file, "", f"cannot be read: {getattr(error, 'strerror', None) or error}") from None
    if not there:
        part = folder.with_name(folder.name + ".part") if folder.name else folder
        hint = f"; did you mean {part}, of a run that ended early?" if folder.name and part.is_dir() else ""
        raise fault(folder, "", f"no such folder; expected a run folder{hint}")
    try:
        document = parsed_json(text)
    except ValueError as error:
        raise fault(file, "", str(error)) from None
    if wrong := _wrong(document):
        raise fault(file, *wrong)
    return RunRows(folder, document)


def _wrong(document: Any) -> tuple[str, str] | None:
    """Return (place, what is expected) for the first missing part that a report needs, else None."""
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        return "format", f"expected {FORMAT!r}"
    start = document.get("start")
    if not isinstance(start, dict):
        return "start", "missing; expected the start of a run"
    for key, kind in (("what", str), ("at", str), ("settings", dict), ("instruments", dict)):
        if not isinstance(start.get(key), kind):
            return f"start.{key}", f"expected {'text' if kind is str else 'a table'}"
    for key in ("stop", "result"):
        if not isinstance(document.get(key, {}), dict):
            return key, "expected a table"
    return None


def inner_runs(folder: Path, settings: Mapping[str, Any]) -> dict[str, RunRows]:
    """Return the readable runs inside a run's folder, by name: its calibration, and the laws to compare with, in
    their order; those that ended early under the name of their .part."""
    experiment = settings.get("experiment")
    compared = experiment.get("compare") if isinstance(experiment, dict) else None
    laws = [name for name in compared if name in LAWS] if isinstance(compared, list) else []
    found = {}
    for name in (CALIBRATION, *laws):
        for inner in (name, f"{name}.part"):
            if (folder / inner / "run.json").is_file():
                try:
                    found[inner] = recorded_run(folder / inner)
                except Faults:
                    continue
    return found


def limit_A(run: RunRows) -> float:
    """Return the largest current, or drive, that was allowed."""
    return float(run.document["start"]["settings"]["limits"]["current_A"])


def ended_early(run: RunRows) -> bool:
    """Return True if a run has not come to its end; that of a calibration is its fit."""
    unfitted = run.document["start"]["what"] == CALIBRATION and "result" not in run.document
    return unfitted or bool(run.document.get("stop", {}).get("reason") != "done")


def drive_label(run: RunRows) -> tuple[str, str]:
    """Return name and unit of what drives the plate: ("current", "A"), or of a heater ("drive", "of full drive")."""
    unit = str(run.document["start"].get("drive_unit", "A"))
    return ("drive", unit) if unit == OF_FULL_DRIVE else ("current", unit)
