"""The clock while the computer sleeps, readings without a number, missing packages, and readers who have gone."""

from __future__ import annotations

import math
import os
import shlex
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest

from rig.core.clock import RealClock
from rig.core.errors import (
    Corrupt,
    InstrumentError,
    Overrange,
    TimedOut,
)
from rig.core.reading import Quality, Reading, missing
from rig.core.requirements import PACKAGES, to_install
from tests.rig.small import write_bench


@pytest.mark.parametrize(
    ("reading", "error"),
    [
        (Reading(math.inf, 0.0, Quality.OVERRANGE), Overrange),
        (missing(0.0), TimedOut),
        (Reading(1.0, 0.0, Quality.STALE), TimedOut),
        (Reading(-1.0, 0.0, Quality.INVALID), Corrupt),
    ],
)
def test_no_number_is_an_error_of_the_tree(reading: Reading, error: type[InstrumentError]) -> None:
    with pytest.raises(error):
        reading.number()
    assert Reading(2.0, 0.0).number() == Reading(2.0, 0.0, Quality.SETTLING).number() == 2.0


@pytest.mark.skipif(not hasattr(time, "CLOCK_BOOTTIME"), reason="only Linux tells how long it slept")
def test_the_real_clock_goes_on_while_the_computer_sleeps(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, whole = RealClock(), time.clock_gettime
    before_s = clock.now_s()
    slept_s = {time.CLOCK_BOOTTIME: 3600.0}  # what the kernel adds to this clock, and to no monotonic one
    monkeypatch.setattr(time, "clock_gettime", lambda which: whole(which) + slept_s.get(which, 0.0))
    assert clock.now_s() >= before_s + 3600.0
    began_s = time.monotonic()
    clock.sleep_until_s(before_s + 1800.0)  # has passed meanwhile
    assert time.monotonic() < began_s + 60.0


PROJECT = Path(__file__).resolve().parents[3] / "pyproject.toml"


def test_the_packages_are_those_of_the_project() -> None:
    extras = tomllib.loads(PROJECT.read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    assert {name: list(packages) for name, packages in PACKAGES.items()} == {name: extras[name] for name in PACKAGES}
    assert shlex.split(to_install("files")) == [sys.executable, "-m", "pip", "install", "openpyxl>=3.1"]


pytestmark = pytest.mark.skipif(os.name != "posix", reason="descriptors are closed before a program begins")
Begun = Callable[[], None]


def nobody_reads(*descriptors: int) -> Begun:
    """Each is a pipe whose reader has gone."""

    def begin() -> None:
        for descriptor in descriptors:
            reader, writer = os.pipe()
            os.dup2(writer, descriptor)
            os.close(reader)
            os.close(writer)

    return begin


def closed(*descriptors: int) -> Begun:
    """As `>&-` does."""

    def begin() -> None:
        for descriptor in descriptors:
            os.close(descriptor)

    return begin


def short_bench(folder: Path) -> Path:
    return write_bench(folder, target='["start 20 kohm", "hold 1 s"]')


def run(path: Path, begun: Begun) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "rig", "run", str(path), "--out", str(path.parent / "run")]
    return subprocess.run(command, capture_output=True, text=True, preexec_fn=begun, timeout=120.0)


@pytest.mark.parametrize(
    "begun",
    [nobody_reads(1, 2), *(pytest.param(closed(*streams), marks=pytest.mark.long) for streams in ((0, 1, 2), (1,)))],
)
def test_a_run_goes_on(tmp_path: Path, begun: Begun) -> None:
    done = run(short_bench(tmp_path), begun)
    assert done.returncode == 0
    assert (tmp_path / "run" / "report.html").exists()


@pytest.mark.long
def test_what_stdout_does_not_take_is_told_on_stderr(tmp_path: Path) -> None:
    done = run(short_bench(tmp_path), nobody_reads(1))
    assert "output off, confirmed by the controller" in done.stderr
    assert f"report: {tmp_path / 'run' / 'report.html'}" in done.stderr


def test_a_fault_keeps_its_status(tmp_path: Path) -> None:
    path = write_bench(tmp_path)
    path.write_text(path.read_text() + "[no_such_table]\n")
    assert run(path, nobody_reads(1, 2)).returncode == 2
