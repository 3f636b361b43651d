"""The real clock counts what a plate lives through, the computer's sleep as well."""

from __future__ import annotations

import time

import pytest

from rig.core.clock import RealClock


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
