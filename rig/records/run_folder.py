"""The run folder: a run is a document of start, rows and stop.

    DIR.part/ while it runs, DIR/ when it is whole
    run.json        start (settings, versions, instruments, limits) and stop (why it ended)
    config.toml     the configuration as it was
    record.csv, record.nc     rows; NetCDF-3
    events.jsonl    what happened, a line each
    report.html, figures/

A run.json without "stop" is of a run that crashed and had no guard; with one, the guard has written it.
"""

from __future__ import annotations

import datetime
import json
import math
import os
import platform
import secrets
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from rig.core.faults import fault
from rig.core.file_writing import naming, replaced, write_text
from rig.version import __version__, source_digest

PREDICTED = "predicted.csv"  # in a calibration's folder: what its model says of every row


def default_folder(name: str, root: Path = Path("runs")) -> Path:
    """runs/2026-11-21/20261121T031037Z_<name>_<id>: the date is the local one, the time UTC."""
    now = datetime.datetime.now(datetime.UTC)
    day = now.astimezone().date().isoformat()
    return root / day / f"{now:%Y%m%dT%H%M%SZ}_{name}_{secrets.token_hex(3)}"


def part_of(path: Path) -> Path:
    """Where a run folder is while it is not whole."""
    return path.with_name(path.name + ".part")


def at_its_end(path: Path) -> Path:
    """The whole path that what is in a run folder has once the run is over, and the runs around it."""
    whole = path.absolute()
    return Path(*(part.removesuffix(".part") for part in whole.parts))


def check_free(path: Path) -> None:
    """Raises Faults where no run folder can have this name at the end of its run."""
    if not path.name:
        raise fault(path, "--out", "is there already; expected a new folder")
    part = part_of(path)
    try:
        if path.is_symlink() or part.is_symlink():  # the folder gets its name at the end, and no link can be replaced
            raise fault(path if path.is_symlink() else part, "--out", "is a link; expected a new folder")
        if path.exists() and (not path.is_dir() or any(path.iterdir())):
            raise fault(path, "--out", "exists and is not empty; expected a new folder")
        if part.exists():
            raise fault(part, "--out", "is of a run that did not finish, its rows are in it; move or delete it first")
    except OSError as error:
        raise fault(path, "--out", f"cannot be made: {error.strerror}") from None


@contextmanager
def prepared_folder(path: Path) -> Iterator[None]:
    """Room for a run folder and those inside it, given back at the end where nothing was written into it.

    Raises Faults where the folder is taken or cannot be made.
    """
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
        with suppress(OSError):  # the first that is gone or has something in it ends it
            for folder in made:
                folder.rmdir()


def versions() -> dict[str, str]:
    """Versions of what computed the run."""
    found = {"peltier-rig": __version__, "sources": source_digest(), "python": platform.python_version()}
    for name in ("numpy", "scipy", "numba", "control", "pyserial"):
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "not installed"
    return found


class RunFolder:
    """Writes one run folder. Rows reach the file at every flush; `finish` makes the folder whole. A folder that is
    deleted meanwhile is written again with the next flush, from memory, where rows stay until the end: files without a
    name would take rows without a word.

    begun_s: when each phase has begun, s of the run.
    """

    def __init__(self, path: Path, start: dict[str, Any], configuration_text: str, columns: list[str]) -> None:
        self.path = path
        self.part = part_of(path)
        self.part.mkdir(parents=True, exist_ok=True)
        self.columns = columns
        self.rows = PackedRows(len(columns))
        self.begun_s: dict[str, float] = {}
        self._kept = {"config.toml": configuration_text}  # texts by the names of their files
        self._lines: list[str] = []  # of the events
        self._open()
        self.document: dict[str, Any] = {
            "format": "peltier-run/1",
            "start": {
                "at": datetime.datetime.now(datetime.UTC).isoformat(),
                "versions": versions(),
                **start,
            },
        }
        self._write_document()

    def _open(self) -> None:
        """The files, with all that they have to have by now."""
        self._record: TextIO = (self.part / "record.csv").open("w", encoding="utf-8", newline="")
        self._record.write(",".join(self.columns) + "\n")
        self._record.writelines(map(_csv_line, self.rows))
        self._events: TextIO = (self.part / "events.jsonl").open("w", encoding="utf-8")
        self._events.writelines(self._lines)
        for name, text in self._kept.items():
            write_text(self.part / name, text)

    def row(self, values: tuple[Any, ...]) -> None:
        """One row, in the order of the columns; nan becomes an empty field."""
        self.rows.append(values)
        with naming(self.part / "record.csv"):
            self._record.write(_csv_line(self.rows[-1]))

    def flush(self) -> None:
        self._write_again_if_deleted()
        with naming(self.part / "record.csv"):
            self._record.flush()
        with naming(self.part / "events.jsonl"):
            self._events.flush()

    def event(self, time_s: float, kind: str, text: str, **more: Any) -> None:
        """Something that happened, at a time of the run."""
        if kind == "phase":
            self.begun_s[text] = time_s
        self._lines.append(json.dumps({"time_s": time_s, "event": kind, "text": text, **more}) + "\n")
        self._events.write(self._lines[-1])

    def column(self, name: str) -> np.ndarray[Any, np.dtype[Any]]:
        """A column of the rows so far."""
        return self.rows.column(self.columns.index(name))

    def note(self, **more: Any) -> None:
        """Add to the start of the document what is known only later (instruments, models, design)."""
        self.document["start"].update(more)
        self._write_document()

    def result(self, **more: Any) -> None:
        """What came out of the run: scores, designs."""
        self.document.setdefault("result", {}).update(more)
        self._write_document()

    def keep(self, name: str, text: str) -> None:
        """A file that the run depends on, so that the folder stands alone."""
        write_text(self.part / name, text)
        self._kept[name] = text

    def stop(self, reason: str, **more: Any) -> None:
        """Why the run ended, and its results; all rows and the document are on disk after this."""
        self.document["stop"] = {
            "at": datetime.datetime.now(datetime.UTC).isoformat(),
            "reason": reason,
            "rows": len(self.rows),
            **more,
        }
        self._write_again_if_deleted()
        self._write_document()
        self.flush()

    def finish(self) -> Path:
        """Close the files, write record.nc, and give the folder its name."""
        self.abandon()
        write_netcdf(self.part / "record.nc", self.columns, self.rows)
        if self.path.exists():
            self.path.rmdir()
        self.part.rename(self.path)
        return self.path

    def abandon(self) -> None:
        """Close the files, of a run that stays a .part too; a full disk that refuses the rows leaves none open."""
        try:
            with naming(self.part / "record.csv"):
                self._record.close()
        finally:
            with naming(self.part / "events.jsonl"):
                self._events.close()

    def _write_again_if_deleted(self) -> None:
        """All that was in the folder is known still."""
        if os.fstat(self._record.fileno()).st_nlink > 0:
            return
        with suppress(OSError):
            self._record.close()
        with suppress(OSError):
            self._events.close()
        self.part.mkdir(parents=True, exist_ok=True)
        self._open()
        self._write_document()
        self.event(self.rows[-1][0] if self.rows else 0.0, "deleted", "the run's folder was deleted, and written again")

    def _write_document(self) -> None:
        with replaced(self.part / "run.json") as new:
            new.write_text(json.dumps(_plain(self.document), indent=2) + "\n", encoding="utf-8")


def _csv_line(values: tuple[Any, ...]) -> str:
    """A row; nan becomes an empty field."""
    return ",".join(["" if v != v else str(v) for v in values]) + "\n"


def _plain(value: Any) -> Any:
    """The value as JSON knows it: not-a-number and infinity become null and text."""
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, (np.floating, np.integer, np.bool_)):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else ("inf" if value > 0 else "-inf")
    if isinstance(value, Path):
        return str(value)
    return value


def plain_json(value: Any) -> str:
    """The value as JSON text; numbers read back to the same bits."""
    return json.dumps(_plain(value), indent=2)


def write_netcdf(path: Path, columns: list[str], rows: PackedRows) -> None:
    """The columns as NetCDF-3, which xarray, MATLAB and Origin open; the unit is the name's ending.

    A column of words becomes numbers with the CF attributes flag_values and flag_meanings.
    """
    from scipy.io import netcdf_file

    with netcdf_file(path, "w") as file:
        setattr(file, "history", b"peltier-rig")  # noqa: B010 - an attribute of the file, not of the class
        axis = columns[0]  # the time: its own coordinate
        file.createDimension(axis, len(rows))
        for k, name in enumerate(columns):
            words = rows.words(k)
            if words is not None:
                flags = file.createVariable(name, "i4", (axis,))
                flags[:] = rows.numbers(k).astype(np.int32)
                setattr(flags, "flag_values", np.arange(len(words), dtype=np.int32))  # noqa: B010
                setattr(flags, "flag_meanings", " ".join(words).encode())  # noqa: B010
                continue
            variable = file.createVariable(name, "f8", (axis,))
            variable[:] = rows.numbers(k)
            setattr(variable, "units", name.rpartition("_")[2].encode())  # noqa: B010


BLOCK = 4096  # rows that are made room for at a time: half a megabyte, and no row has to move when there are more


class PackedRows:
    """Rows of `width` values, as tuples; can be appended to, counted, iterated and taken by number."""

    def __init__(self, width: int) -> None:
        self._width = width
        self._count = 0
        self._blocks: list[np.ndarray[Any, np.dtype[np.float64]]] = []
        self._whole: set[int] = set()  # columns of whole numbers
        self._words: dict[int, dict[str, int]] = {}  # of each column of words, with their numbers in the blocks

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[tuple[Any, ...]]:
        left = self._count
        for block in self._blocks:
            yield from map(self._row, block[:left].tolist())
            left -= BLOCK

    def __getitem__(self, index: int) -> tuple[Any, ...]:
        """The row of that number, or counted from the end. IndexError."""
        at = index + self._count if index < 0 else index
        if not 0 <= at < self._count:
            raise IndexError(index)
        return self._row(self._blocks[at // BLOCK][at % BLOCK].tolist())

    def append(self, values: Sequence[Any]) -> None:
        """One row more. ValueError where it is not as wide as the others."""
        if len(values) != self._width:
            raise ValueError(f"a row of {len(values)} values, expected {self._width}")
        if not self._count:
            self._whole = {k for k, value in enumerate(values) if isinstance(value, int)}
            self._words = {k: {} for k, value in enumerate(values) if isinstance(value, str)}
        packed = list(values)
        for k, words in self._words.items():
            packed[k] = words.setdefault(values[k], len(words))
        block, row = divmod(self._count, BLOCK)
        if block == len(self._blocks):
            self._blocks.append(np.empty((BLOCK, self._width)))
        self._blocks[block][row] = packed
        self._count += 1  # last: a signal's exception in between leaves no half row

    def numbers(self, k: int) -> np.ndarray[Any, np.dtype[np.float64]]:
        """A column; of words the number of each in `words`."""
        if not self._count:
            return np.empty(0)
        return np.concatenate([block[:, k] for block in self._blocks])[: self._count]

    def words(self, k: int) -> list[str] | None:
        """The words of a column by their numbers, in the order in which they came; None of a column of numbers."""
        return list(self._words[k]) if k in self._words else None

    def column(self, k: int) -> np.ndarray[Any, np.dtype[Any]]:
        """A column as an array of its own kind."""
        numbers, words = self.numbers(k), self.words(k)
        if words is not None:
            return np.take(np.array(words), numbers.astype(np.intp))
        return numbers.astype(np.int64) if k in self._whole and np.all(numbers % 1.0 == 0.0) else numbers

    def _row(self, packed: list[Any]) -> tuple[Any, ...]:
        for k in self._whole:
            if packed[k].is_integer():
                packed[k] = int(packed[k])
        for k, words in self._words.items():
            packed[k] = list(words)[int(packed[k])]
        return tuple(packed)


FORMAT = "peltier-run/1"


@dataclass(frozen=True)
class RunInFolder:
    """A run. at: when it began, UTC; rig: its controller, with the serial number where it has one."""

    folder: Path
    at: datetime.datetime
    rig: str

    @property
    def record(self) -> Path:
        """Its rows."""
        return self.folder / "record.csv"


def runs_in(folder: Path) -> list[RunInFolder]:
    """The runs that have come to their end; those that a run has inside it (its calibration) too. Raises Faults."""
    if not folder.is_dir():
        raise fault(folder, "", "no such folder; expected one with run folders in it")
    found = []
    for path in sorted(folder.rglob("run.json")):
        run = _run(path)
        if run is not None and not any(part.endswith(".part") for part in path.parts):
            found.append(run)
    if not found:
        raise fault(folder, "", "no run folder in it that came to its end; expected some with run.json and record.csv")
    return sorted(found, key=lambda run: (run.at, str(run.folder)))


def _run(path: Path) -> RunInFolder | None:
    try:
        document: Any = json.loads(path.read_bytes())
        start = document["start"]
        at = datetime.datetime.fromisoformat(start["at"])
        if document["format"] != FORMAT or document["stop"]["reason"] != "done":
            return None
        controller = dict(start["instruments"]["controller"])
    except (OSError, ValueError, KeyError, TypeError):
        return None
    if at.tzinfo is None:
        at = at.replace(tzinfo=datetime.UTC)
    words = [str(controller.get(key) or "") for key in ("maker", "model", "serial_number")]
    return RunInFolder(path.parent, at.astimezone(datetime.UTC), " ".join(word for word in words if word))
