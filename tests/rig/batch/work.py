"""Work for the tests of many cases: importable, as what travels to another process has to be."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path
from typing import Any

from rig.batch import given
from rig.report.batch import RecordReport


def doubled(value: int) -> int:
    return 2 * value


def slow(value: int, seconds: float, marks: Path) -> int:
    """Leaves a mark with the process that computed it, so that a test can kill that one and count how often."""
    with (marks / f"{value}_{os.getpid()}_{time.monotonic_ns()}").open("w"):
        pass
    time.sleep(seconds)
    return 2 * value


def ends(marks: Path, seconds: float) -> None:
    """Leaves a mark when it begins, and another when it has not been ended before."""
    (marks / "begun").touch()
    time.sleep(seconds)
    (marks / "ended").touch()


def fails(value: int) -> int:
    raise ValueError(f"no value for {value}")


def kills_itself(value: int) -> int:
    os.kill(os.getpid(), signal.SIGKILL)
    return value


def size_of(value: Any) -> int:
    return len(given(value))


def read_from(value: Any) -> tuple[int, int]:
    """(process, identity of the object): the same object as long as it is read once."""
    return os.getpid(), id(given(value))


def refused(record: Any, *asked: Any) -> RecordReport:
    """Two faults of a record, of which one speaks of its file twice."""
    source = given(record).source
    return RecordReport(faults=(f"{source}: row 3 / {source}: row 4", f"{source}: row 9"))
