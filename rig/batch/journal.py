"""The journal of many cases, a line of JSON each as soon as it ends, and the table that is made of the lines.

    DIR/cases.jsonl    {"case": identity, "values": result, "seconds": duration} in the order of their ends
    DIR/NAME.csv       the table: a row a case, in the order of their numbers, the same bits whoever computed it
    DIR/NAME.nc        the same as NetCDF-3, which xarray opens
    DIR/times.csv      number, seconds

A process that is killed leaves at most its last line unfinished: it is no line, and its case is computed again.
"""

from __future__ import annotations

import json
import math
import os
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from rig.core.faults import fault
from rig.core.file_writing import naming_file, replacing
from rig.records.record_file import write_columns

LINES, TIMES = "cases.jsonl", "times.csv"
LOST = "lost"  # the status of a case whose process died: it is tried again when the command is given again
TABLE_EVERY_S = 5.0  # a table of 10,000 rows is written in a tenth of a second
Row = dict[str, Any]
Cell = str | float | int | list[str]  # of text lines: one of JSON's lists in the journal, one text in the table


def is_of_many(folder: Path | None) -> bool:
    """Return True if a folder has a journal of cases."""
    return folder is not None and (folder / LINES).is_file()


class Journal:
    """The results of cases in a folder. name: of the table. identities: by number, the columns that identify each case,
    its number first. others: number of earlier lines that are of none of these cases, and are left alone."""

    def __init__(self, folder: Path, name: str, identities: Mapping[int, Row], same: Sequence[str] = ()) -> None:
        """Continue the journal in a folder. same: the columns by which an earlier line is one of these cases, whatever
        its number; lines of other cases are then left alone if they have the same "of". Without it a line has to be the
        case of its number. Raises Faults for other lines, and if it cannot be read or written."""
        self._same, self.others = tuple(same), 0
        self._numbers = {self._key(identity): number for number, identity in identities.items()}
        self._of = {identity.get("of") for identity in identities.values()}
        self.folder, self._name, self._identities = folder, name, identities
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._path = folder / LINES
            self._lines = self._path.open("a", encoding="utf-8")
        except OSError as error:
            raise fault(folder, "", f"cannot be written: {error.strerror}") from None
        try:
            self._take_alone()
            self.done = self._read()
        except BaseException:
            self._lines.close()
            raise
        self._written_s = time.monotonic()

    def add(self, number: int, values: Mapping[str, Cell], seconds: float) -> None:
        """Add the result of a case."""
        self.done[number] = (dict(values), seconds)
        line = {"case": self._identities[number], "values": values, "seconds": round(seconds, 3)}
        with naming_file(self._path):
            self._lines.write(json.dumps(line) + "\n")
            self._lines.flush()
        if time.monotonic() - self._written_s > TABLE_EVERY_S:
            self.write_table()

    def note(self, number: int, values: Mapping[str, Cell]) -> None:
        """Add a case of which nothing can be computed as it is: a row of the table, and no line, so that it is tried
        when the command is given again."""
        self.done[number] = (dict(values), 0.0)

    def case(self, number: int) -> Row:
        """Return the identity of a case."""
        return self._identities[number]

    @property
    def count(self) -> int:
        """Number of cases."""
        return len(self._identities)

    def missing(self) -> list[int]:
        """Return the cases that are still to be computed: without a line, or lost with their process."""
        return [n for n in self._identities if n not in self.done or self.done[n][0].get("status") == LOST]

    def rows(self) -> list[Row]:
        """Return identity and result of each case, in the order of their numbers."""
        return [{**self._identities[number], **self.done[number][0]} for number in sorted(self.done)]

    def write_table(self) -> None:
        """Write the table as far as it is."""
        write_table(self.folder / f"{self._name}.csv", self.rows())
        with replacing(self.folder / TIMES) as path:
            times = "".join(f"{number},{self.done[number][1]!r}\n" for number in sorted(self.done))
            path.write_text(f"number,seconds\n{times}", encoding="utf-8")
        self._written_s = time.monotonic()

    def close(self) -> None:
        """Write the table, also as NetCDF, and close the lines."""
        with naming_file(self._path):
            self._lines.close()
        self.write_table()
        with replacing(self.folder / f"{self._name}.nc") as path:
            write_netcdf(path, self.rows())

    def _take_alone(self) -> None:
        """Lock the lines until they are closed: whoever computed into the same folder meanwhile would compute all of it
        again, and cut off a line that is just being written. Raises Faults."""
        if os.name == "nt":
            return
        import fcntl

        try:
            fcntl.flock(self._lines, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            text = "another process is computing into it; wait for its end, or give another DIR"
            raise fault(self.folder, "", text) from None
        except OSError:  # a network's file system that locks nothing: nobody is kept out
            return

    def _read(self) -> dict[int, tuple[Row, float]]:
        """Read the finished lines; cut off an unfinished last one."""
        content = self._path.read_bytes()
        whole = content[: content.rfind(b"\n") + 1]
        if whole != content:
            os.truncate(self._path, len(whole))
        found = {}
        for k, line in enumerate(whole.decode("utf-8", "replace").splitlines(), 1):
            try:
                entry = json.loads(line)
                number, values, seconds = int(entry["case"]["number"]), dict(entry["values"]), float(entry["seconds"])
            except (ValueError, KeyError, TypeError):
                raise fault(self._path, f"line {k}", "is damaged; expected a line of a journal of cases") from None
            ours = self._number_of(number, entry["case"])
            if ours is None:
                self.others += 1
            else:
                found[ours] = (values, seconds)
        return found

    def _key(self, case: Row) -> tuple[Any, ...]:
        return tuple(case.get(name) for name in self._same)

    def _number_of(self, number: int, case: Row) -> int | None:
        """Return the number of a line's case now; None if it is none of these and may be left alone. Raises Faults."""
        if not self._same and self._identities.get(number) == case:
            return number
        if self._same and (not self._of or case.get("of") in self._of):
            return self._numbers.get(self._key(case))
        text = "is of other cases, of files with other contents, or of another version"
        raise fault(self._path, f"number {number}", f"{text}; expected the DIR of these, or a new one")


def files_of(name: str) -> list[str]:
    """Return the names of the files of a journal with a table `name`."""
    return [LINES, TIMES, f"{name}.csv", f"{name}.nc"]


def cases_in(folder: Path) -> list[Row]:
    """Return the identities of a journal's cases, in the order of its lines, without damaged ones."""
    try:
        lines = (folder / LINES).read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return []
    found = []
    for line in lines:
        try:
            case = json.loads(line)["case"]
        except (ValueError, KeyError, TypeError):
            continue
        if isinstance(case, dict):
            found.append(case)
    return found


def write_table(path: Path, rows: list[Row]) -> None:
    """Write rows as CSV; a cell that a row does not have is empty."""
    write_columns(path, _columns(rows))


def _columns(rows: list[Row]) -> dict[str, list[Any]]:
    """Return the columns of rows, in the order in which they first occur; "" for a cell that a row does not have."""
    names = dict.fromkeys(name for row in rows for name in row)
    cells = {name: [row.get(name, "") for row in rows] for name in names}
    return {name: [" / ".join(c) if isinstance(c, list) else c for c in column] for name, column in cells.items()}


def write_netcdf(path: Path, rows: list[Row]) -> None:
    """Write rows as NetCDF-3: a dimension `case`, numbers as doubles, text as characters (which xarray joins)."""
    from scipy.io import netcdf_file

    with netcdf_file(path, "w") as file:
        setattr(file, "history", b"peltier-rig")  # noqa: B010 - an attribute of the file, not of the class
        file.createDimension("case", len(rows))
        for name, column in _columns(rows).items():
            if all(value == "" or isinstance(value, (int, float)) for value in column):
                variable = file.createVariable(name, "f8", ("case",))
                variable[:] = np.array([math.nan if value == "" else float(value) for value in column])
                continue
            texts = [str(value).encode() for value in column]
            length = max(1, max((len(text) for text in texts), default=1))
            file.createDimension(f"{name}_length", length)
            characters = file.createVariable(name, "S1", ("case", f"{name}_length"))
            characters[:] = np.array([list(text.ljust(length, b"\0")) for text in texts], "u1").view("S1")
