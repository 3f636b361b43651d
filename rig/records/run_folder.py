"""The run folder: start, rows and stop of a run, while it is written, and as it is read later.

    DIR.part/ while the run goes on, DIR/ when it is complete
    run.json        start (settings, versions, instruments, limits) and stop (why the run ended)
    config.toml     the configuration as it was
    record.csv, record.nc     rows; NetCDF-3
    events.jsonl    what happened, a line each
    report.html, figures/

A run.json without "stop" is of a run that crashed without a guard; otherwise the guard has written it.
"""

from __future__ import annotations

import datetime
import json
import math
import os
import platform
import secrets
from array import array
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property
from importlib import metadata
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from compensator.hysteresis.functions import Array
from rig.core.faults import Faults, fault
from rig.core.file_writing import naming_file, replacing, write_text
from rig.core.json_text import parsed_json
from rig.drivers.controller import OF_FULL_DRIVE
from rig.version import __version__, source_digest

FORMAT = "peltier-run/1"
PREDICTED = "predicted.csv"  # in a calibration's folder: its model's prediction of every row


def default_folder(name: str, root: Path = Path("runs")) -> Path:
    """Return runs/2026-11-21/20261121T031037Z_<name>_<id>; the date is the local one, the time UTC."""
    now = datetime.datetime.now(datetime.UTC)
    day = now.astimezone().date().isoformat()
    return root / day / f"{now:%Y%m%dT%H%M%SZ}_{name}_{secrets.token_hex(3)}"


def part_of(path: Path) -> Path:
    """Return the name of a run folder while the run goes on."""
    return path.with_name(path.name + ".part")


def final_path(path: Path) -> Path:
    """Return the whole path that a file in a run folder has when the run, and the runs around it, are over."""
    return Path(*(part.removesuffix(".part") for part in path.absolute().parts))


def check_free(path: Path) -> None:
    """Raise Faults if a run folder cannot get this name at the end of its run."""
    if not path.name:
        raise fault(path, "--out", "is there already; expected a new folder")
    part = part_of(path)
    try:
        for each in (path, part):
            if each.is_symlink():  # a link cannot be replaced by the folder
                raise fault(each, "--out", "is a link; expected a new folder")
        if path.exists() and (not path.is_dir() or any(path.iterdir())):
            raise fault(path, "--out", "exists and is not empty; expected a new folder")
        if part.exists():
            raise fault(part, "--out", "is of a run that did not finish, its rows are in it; move or delete it first")
    except OSError as error:
        raise fault(path, "--out", f"cannot be made: {error.strerror}") from None


@contextmanager
def prepared_folder(path: Path) -> Iterator[None]:
    """Make a run folder and those around it, and remove at the end those that are empty. Raises Faults if the name is
    taken or the folder cannot be made."""
    check_free(path)
    part = part_of(path)
    made = [part, *(parent for parent in part.parents if not parent.exists())]
    try:
        part.mkdir(parents=True)
    except OSError as error:
        raise fault(path, "--out", f"cannot be made: {error.strerror}") from None
    try:
        yield
    finally:
        with suppress(OSError):  # the first that is gone or not empty
            for folder in made:
                folder.rmdir()


def software_versions() -> dict[str, str]:
    """Return the versions of what computes a run, by package."""
    found = {"peltier-rig": __version__, "sources": source_digest(), "python": platform.python_version()}
    for name in ("numpy", "scipy", "numba", "control", "pyserial"):
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "not installed"
    return found


class PackedRows:
    """Rows of `width` values as tuples, eight bytes a value: a week at 10 Hz has six million rows.

    The first row gives the kind of each column: words (each kept once), whole numbers, or numbers. Values come out as
    they went in: a number has the same bits, and so the same text.

    words: of each column of words, with the numbers that stand for them.
    """

    def __init__(self, width: int) -> None:
        self._width, self._values = width, array("d")
        self._whole: set[int] = set()  # columns of whole numbers
        self.words: dict[int, dict[str, int]] = {}

    def __len__(self) -> int:
        return len(self._values) // self._width

    def __iter__(self) -> Iterator[tuple[Any, ...]]:
        return map(self.__getitem__, range(len(self)))

    def __getitem__(self, index: int) -> tuple[Any, ...]:
        """Return a row by its number, or counted from the end. Raises IndexError."""
        begin = self._width * range(len(self))[index]
        values: list[Any] = self._values[begin : begin + self._width].tolist()
        for k in self._whole:
            values[k] = int(values[k]) if values[k].is_integer() else values[k]
        for k, words in self.words.items():
            values[k] = list(words)[int(values[k])]
        return tuple(values)

    def append(self, values: Sequence[Any]) -> None:
        """Add a row. Raises ValueError if it has another number of values."""
        if len(values) != self._width:
            raise ValueError(f"a row of {len(values)} values, expected {self._width}")
        if not self._values:
            self._whole = {k for k, value in enumerate(values) if isinstance(value, int)}
            self.words = {k: {} for k, value in enumerate(values) if isinstance(value, str)}
        row = list(values)
        for k, words in self.words.items():
            row[k] = words.setdefault(row[k], len(words))
        self._values.extend(array("d", row))  # all at once: a signal's exception breaks no row in two

    def numbers(self, k: int) -> Array:
        """Return a column as numbers; of words those that stand for them."""
        return np.asarray(self._values)[k :: self._width].copy()

    def column(self, k: int) -> np.ndarray[Any, np.dtype[Any]]:
        numbers = self.numbers(k)
        if k in self.words:
            return np.take(np.array(list(self.words[k])), numbers.astype(np.intp))
        return numbers.astype(np.int64) if k in self._whole and np.all(numbers % 1.0 == 0.0) else numbers


class RunFolder:
    """Writer of one run folder; `flush` brings rows to the file, `finish` completes the folder.

    A folder that is deleted meanwhile is written again at the next flush, from the rows in memory: a file that has been
    deleted would accept rows without an error.

    begun_s: begin of each phase, s of the run.
    """

    def __init__(self, path: Path, start: dict[str, Any], configuration_text: str, columns: list[str]) -> None:
        self.path = path
        self.part = part_of(path)
        self.part.mkdir(parents=True, exist_ok=True)
        self.columns = columns
        self.rows = PackedRows(len(columns))
        self.begun_s: dict[str, float] = {}
        self._kept = {"config.toml": configuration_text}  # texts by the names of their files
        self._event_lines: list[str] = []
        self._open()
        start = {"at": datetime.datetime.now(datetime.UTC).isoformat(), "versions": software_versions(), **start}
        self.document: dict[str, Any] = {"format": FORMAT, "start": start}
        self._write_document()

    def _open(self) -> None:
        self._record: TextIO = (self.part / "record.csv").open("w", encoding="utf-8", newline="")
        self._record.write(",".join(self.columns) + "\n")
        self._record.writelines(map(_csv_line, self.rows))
        self._events: TextIO = (self.part / "events.jsonl").open("w", encoding="utf-8")
        self._events.writelines(self._event_lines)
        for name, text in self._kept.items():
            write_text(self.part / name, text)

    def row(self, values: tuple[Any, ...]) -> None:
        """Add a row, in the order of the columns; nan becomes an empty field."""
        self.rows.append(values)
        with naming_file(self.part / "record.csv"):
            self._record.write(_csv_line(self.rows[-1]))

    def flush(self) -> None:
        self._rewrite_if_deleted()
        for file, name in ((self._record, "record.csv"), (self._events, "events.jsonl")):
            with naming_file(self.part / name):
                file.flush()

    def event(self, time_s: float, kind: str, text: str, **more: Any) -> None:
        if kind == "phase":
            self.begun_s[text] = time_s
        self._event_lines.append(json.dumps({"time_s": time_s, "event": kind, "text": text, **more}) + "\n")
        self._events.write(self._event_lines[-1])

    def column(self, name: str) -> np.ndarray[Any, np.dtype[Any]]:
        return self.rows.column(self.columns.index(name))

    def note(self, **more: Any) -> None:
        """Add what is known later (instruments, models, design) to the start of run.json."""
        self.document["start"].update(more)
        self._write_document()

    def result(self, **more: Any) -> None:
        """Add results (scores, designs) to run.json."""
        self.document.setdefault("result", {}).update(more)
        self._write_document()

    def keep(self, name: str, text: str) -> None:
        """Write a file that the run depends on, so that the folder is complete without others."""
        write_text(self.part / name, text)
        self._kept[name] = text

    def stop(self, reason: str, **more: Any) -> None:
        """Write why the run ended; then all rows and run.json are on disk."""
        at = datetime.datetime.now(datetime.UTC).isoformat()
        self.document["stop"] = {"at": at, "reason": reason, "rows": len(self.rows), **more}
        self._rewrite_if_deleted()
        self._write_document()
        self.flush()

    def finish(self) -> Path:
        """Close the files, write record.nc, rename the folder, and return its path."""
        self.abandon()
        write_netcdf(self.part / "record.nc", self.columns, self.rows)
        if self.path.exists():
            self.path.rmdir()
        self.part.rename(self.path)
        return self.path

    def abandon(self) -> None:
        """Close both files, even if the disk is full; the folder stays a .part."""
        try:
            with naming_file(self.part / "record.csv"):
                self._record.close()
        finally:
            with naming_file(self.part / "events.jsonl"):
                self._events.close()

    def _rewrite_if_deleted(self) -> None:
        if os.fstat(self._record.fileno()).st_nlink > 0:
            return
        for file in (self._record, self._events):
            with suppress(OSError):
                file.close()
        self.part.mkdir(parents=True, exist_ok=True)
        self._open()
        self._write_document()
        self.event(self.rows[-1][0] if self.rows else 0.0, "deleted", "the run's folder was deleted, and written again")

    def _write_document(self) -> None:
        with replacing(self.part / "run.json") as new:
            new.write_text(plain_json(self.document) + "\n", encoding="utf-8")


def _csv_line(values: tuple[Any, ...]) -> str:
    return ",".join(["" if v != v else str(v) for v in values]) + "\n"


def plain_json(value: Any) -> str:
    """Return a value as JSON text; numbers read back to the same bits, nan is null, infinities are "inf", "-inf"."""
    return json.dumps(_plain(value), indent=2)


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if isinstance(value, (np.ndarray, np.floating, np.integer, np.bool_)):
        return _plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else ("inf" if value > 0 else "-inf")
    return str(value) if isinstance(value, Path) else value


def write_netcdf(path: Path, columns: list[str], rows: PackedRows) -> None:
    """Write columns as NetCDF-3, which xarray, MATLAB and Origin open; the unit is the ending of the name.

    Words become numbers with the CF attributes flag_values and flag_meanings.
    """
    from scipy.io import netcdf_file

    with netcdf_file(path, "w") as file:
        setattr(file, "history", b"peltier-rig")  # noqa: B010 - an attribute of the file, not of the class
        axis = columns[0]  # the time is its own coordinate
        file.createDimension(axis, len(rows))
        for k, name in enumerate(columns):
            words = rows.words.get(k)
            variable = file.createVariable(name, "f8" if words is None else "i4", (axis,))
            variable[:] = rows.numbers(k)
            if words is None:
                setattr(variable, "units", name.rpartition("_")[2].encode())  # noqa: B010
            else:
                setattr(variable, "flag_values", np.arange(len(words), dtype=np.int32))  # noqa: B010
                setattr(variable, "flag_meanings", " ".join(words).encode())  # noqa: B010


@dataclass(frozen=True)
class FinishedRun:
    """A run that came to its end; at: its begin, UTC; rig: its controller, with the serial number if it has one."""

    folder: Path
    at: datetime.datetime
    rig: str

    @property
    def record(self) -> Path:
        return self.folder / "record.csv"


def find_runs(folder: Path) -> list[FinishedRun]:
    """Return the runs below a folder that came to their end, in the order of time; runs inside another (its
    calibration) too. Raises Faults if there are none."""
    if not folder.is_dir():
        raise fault(folder, "", "no such folder; expected one with run folders in it")
    paths = [path for path in folder.rglob("run.json") if not any(part.endswith(".part") for part in path.parts)]
    found = [run for path in paths if (run := _finished_run(path)) is not None]
    if not found:
        raise fault(folder, "", "no run folder in it that came to its end; expected some with run.json and record.csv")
    return sorted(found, key=lambda run: (run.at, str(run.folder)))


def _finished_run(path: Path) -> FinishedRun | None:
    try:
        document: Any = json.loads(path.read_bytes())
        start = document["start"]
        at = datetime.datetime.fromisoformat(start["at"])
        if document["format"] != FORMAT or document["stop"]["reason"] != "done":
            return None
        controller = dict(start["instruments"]["controller"])
    except (OSError, ValueError, KeyError, TypeError):
        return None
    at = (at if at.tzinfo is not None else at.replace(tzinfo=datetime.UTC)).astimezone(datetime.UTC)
    words = [str(controller.get(key) or "") for key in ("maker", "model", "serial_number")]
    return FinishedRun(path.parent, at, " ".join(word for word in words if word))


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
        return self._given if self._given is not None else _columns_on_disk(self.part / "record.csv")

    @property
    def rows(self) -> int:
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
    from rig.records.record_file import read_record, read_run_table

    with suppress(OSError):  # told by what reads it then
        if (table := read_run_table(path)) is not None and {column.name for column in table.columns} >= set(NEEDED):
            return {column.name: np.asarray(column.fields) for column in table.columns}
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
        if not folder.is_dir():
            early = bool(folder.name) and part_of(folder).is_dir()
            hint = f"; did you mean {part_of(folder)}, of a run that ended early?" if early else ""
            raise fault(folder, "", f"no such folder; expected a run folder{hint}")
        text = file.read_bytes()
    except FileNotFoundError:
        whole = "whole " if (folder / "run.json.new").exists() else ""
        raise fault(folder, "", f"no {whole}run.json; expected a run folder") from None
    except (OSError, ValueError) as error:  # ValueError: a NUL in a path
        raise fault(file, "", f"cannot be read: {getattr(error, 'strerror', None) or error}") from None
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
    for inner in (f"{name}{ending}" for name in (CALIBRATION, *laws) for ending in ("", ".part")):
        if (folder / inner / "run.json").is_file():
            with suppress(Faults):
                found[inner] = recorded_run(folder / inner)
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
