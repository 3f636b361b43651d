"""Clocks, the real one while the computer sleeps too; readings and the numbers in them; one tree of errors."""

from __future__ import annotations

import math
import time

import pytest

from rig.core.clock import RealClock, VirtualClock
from rig.core.errors import (
    Corrupt,
    Disconnected,
    InstrumentError,
    OutOfStep,
    Overrange,
    PortHeld,
    Refused,
    RigError,
    TimedOut,
)
from rig.core.reading import Quality, Reading, missing


def test_virtual_time_passes_only_by_sleeping() -> None:
    clock = VirtualClock(5.0)
    assert clock.now_s() == 5.0
    clock.sleep_until_s(8.0)
    clock.sleep_until_s(7.0)
    assert clock.now_s() == 8.0


def test_real_time() -> None:
    clock = RealClock()
    begin_s = clock.now_s()
    clock.sleep_until_s(begin_s + 0.01)
    clock.sleep_until_s(begin_s - 1.0)
    assert 0.01 <= clock.now_s() - begin_s < 0.5


def test_reading() -> None:
    assert Reading(1.0, 2.0).is_number
    assert Reading(1.0, 2.0, Quality.SETTLING).is_number
    for quality in (Quality.OVERRANGE, Quality.INVALID, Quality.STALE, Quality.MISSING):
        assert not Reading(1.0, 2.0, quality).is_number
    assert math.isnan(missing(3.0).value)
    with pytest.raises(AttributeError):
        Reading(1.0, 2.0).value = 3.0  # type: ignore[misc]


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


def test_one_error_tree() -> None:
    for error in (TimedOut("x"), Corrupt("x"), OutOfStep("x"), Refused(5, "no"), Disconnected("x")):
        assert isinstance(error, InstrumentError)
    assert issubclass(InstrumentError, RigError)
    assert not isinstance(PortHeld("p"), InstrumentError)
    assert str(PortHeld("/dev/x", 12, "cat")) == "/dev/x is held by process 12 (cat)"
    assert str(Refused(5, "no")) == "no (error 5)"


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
