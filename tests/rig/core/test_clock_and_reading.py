"""The real clock while the computer sleeps; readings without a number; what to type for a package that is missing."""

from __future__ import annotations

import math
import shlex
import sys
import time
import tomllib
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
