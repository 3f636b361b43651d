"""What is done of many cases, a line of JSON each as soon as it ends, and the table that is made of the lines.

    DIR/cases.jsonl    {"case": what it is, "values": what came out, "seconds": how long} in the order of their ends
    DIR/NAME.csv       the table: a row a case, in the order of their numbers, the same bits whoever computed it
    DIR/NAME.nc        the same as NetCDF-3, which xarray opens
    DIR/times.csv      number, seconds

A process that is killed leaves at most its last line unfinished: it is no line, and its case is computed again.
"""

from __future__ import annotations

import csv
import json
import math
import os
import time
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from rig.core.faults import fault
from rig.core.file_writing import naming_file, replacing

LINES, TIMES = "cases.jsonl", "times.csv"
LOST = "lost"  # the status of a case whose process died: it is tried again when the command is given again
TABLE_EVERY_S = 5.0  # a table of 10,000 rows is written in a tenth of a second
Row = dict[str, Any]
Cell = str | float | int | list[str]  # of text lines: one of JSON's lists in the journal, one text in the table


def is_of_many(folder: Path | None) -> bool:
    """Whether a folder has a journal of cases."""
    return folder is not None and (folder / LINES).is_file()


class Journal:
    """name: of the table. identities: what each case is (its number first), by number; values of text and numbers.
    others: lines of an earlier time that are no case of this time, and are left alone."""

    def __init__(self, folder: Path, name: str, identities: Mapping[int, Row], same: Sequence[str] = ()) -> None:
        """Takes up what is there. same: what of its identity makes a line a case of this time, whatever its number is;
        lines of other cases are then left alone, if they have the same "of". Without it a line has to be the case of
        its number. Raises Faults where there are others, or where it cannot be read or written."""
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
        """A case has ended."""
        self.done[number] = (dict(values), seconds)
        line = {"case": self._identities[number], "values": values, "seconds": round(seconds, 3)}
        with naming_file(self._path):
            self._lines.write(json.dumps(line) + "\n")
            self._lines.flush()
        if time.monotonic() - self._written_s > TABLE_EVERY_S:
            self.write_table()

    def note(self, number: int, values: Mapping[str, Cell]) -> None:
        """A case of which nothing can be computed as it is: a row of the table, and no line, so that it is tried when
        the command is given again."""
        self.done[number] = (dict(values), 0.0)

    def case(self, number: int) -> Row:
        """What a case is."""
        return self._identities[number]

    @property
    def count(self) -> int:
        """How many cases there are."""
        return len(self._identities)

    def missing(self) -> list[int]:
        """What is still to be done: cases without a line, and those whose process died of something else."""
        return [n for n in self._identities if n not in self.done or self.done[n][0].get("status") == LOST]

    def rows(self) -> list[Row]:
        """What each case is and what came out, in the order of their numbers."""
        return [{**self._identities[number], **self.done[number][0]} for number in sorted(self.done)]

    def write_table(self) -> None:
        """The table as far as it is."""
        write_table(self.folder / f"{self._name}.csv", self.rows())
        with replacing(self.folder / TIMES) as path:
            times = "".join(f"{number},{self.done[number][1]!r}\n" for number in sorted(self.done))
            path.write_text(f"number,seconds\n{times}", encoding="utf-8")
        self._written_s = time.monotonic()

    def close(self) -> None:
        """The table, also as NetCDF."""
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
        """The finished lines; an unfinished last one is cut off."""
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
        """The number of a line's case now; None where it is none of these and may be left alone. Raises Faults."""
        if not self._same and self._identities.get(number) == case:
            return number
        if self._same and (not self._of or case.get("of") in self._of):
            return self._numbers.get(self._key(case))
        text = "is of other cases, of files with other contents, or of another version"
        raise fault(self._path, f"number {number}", f"{text}; expected the DIR of these, or a new one")


def files_of(name: str) -> list[str]:
    """What stands in a journal's folder, its table being called `name`."""
    return [LINES, TIMES, f"{name}.csv", f"{name}.nc"]


def cases_in(folder: Path) -> list[Row]:
    """What the cases of a journal are, in the order of its lines; lines that are damaged are left out."""
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
    """CSV; a cell that a row does not have is empty."""
    with replacing(path) as new, new.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, names_of(rows), lineterminator="\n", restval="")
        writer.writeheader()
        writer.writerows({name: _in_table(cell) for name, cell in row.items()} for row in rows)


def _in_table(cell: Cell) -> str | float | int:
    return " / ".join(cell) if isinstance(cell, list) else cell


def names_of(rows: Iterable[Mapping[str, Any]]) -> list[str]:
    """Every column that a row has, in the order in which they are met."""
    return list(dict.fromkeys(name for row in rows for name in row))


def write_netcdf(path: Path, rows: list[Row]) -> None:
    """A dimension `case`; a column of numbers as doubles, one of text as characters (which xarray joins)."""
    from scipy.io import netcdf_file

    with netcdf_file(path, "w") as file:
        setattr(file, "history", b"peltier-rig")  # noqa: B010 - an attribute of the file, not of the class
        file.createDimension("case", len(rows))
        for name in names_of(rows):
            column = [_in_table(row.get(name, "")) for row in rows]
            if all(value == "" or isinstance(value, (int, float)) for value in column):
                variable = file.createVariable(name, "f8", ("case",))
                variable[:] = np.array([math.nan if value == "" else float(value) for value in column])
                continue
            texts = [str(value).encode() for value in column]
            length = max(1, max((len(text) for text in texts), default=1))
            file.createDimension(f"{name}_length", length)
            characters = file.createVariable(name, "S1", ("case", f"{name}_length"))
            characters[:] = np.array([list(text.ljust(length, b"\0")) for text in texts], "u1").view("S1")
