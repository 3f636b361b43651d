"""Clocks. Only `rig` has one; everything below is given times.

Clock
|- RealClock      monotonic seconds of this computer
`- VirtualClock   seconds that pass only when somebody sleeps
"""

from __future__ import annotations

import time
from typing import Final, Protocol

DAY_S: Final = 86400.0  # without leap seconds, as Unix time counts


class Clock(Protocol):
    """Seconds since an arbitrary moment, never backwards."""

    def now_s(self) -> float:
        """Time now, s."""

    def sleep_until_s(self, time_s: float) -> None:
        """Return at `time_s` or, where it has passed, at once."""


class RealClock:
    """The computer's clock since its start: it neither jumps with daylight saving nor with network time.

    On Linux it goes on while the computer sleeps (CLOCK_BOOTTIME, clock_gettime(2)), as heat in a plate does: the tick
    after a sleep is late, and trips. CLOCK_MONOTONIC stands still meanwhile, and would let a run go on as if nothing
    had been.
    """

    def now_s(self) -> float:
        """Seconds since some moment before the program began."""
        return _since_start_s()

    def sleep_until_s(self, time_s: float) -> None:
        remaining_s = time_s - _since_start_s()
        if remaining_s > 0.0:
            time.sleep(remaining_s)


def _since_start_s() -> float:
    return time.clock_gettime(time.CLOCK_BOOTTIME) if hasattr(time, "CLOCK_BOOTTIME") else time.monotonic()


class VirtualClock:
    """Time that advances only by sleeping, so that a simulated hour takes no longer than its arithmetic."""

    def __init__(self, start_s: float = 0.0) -> None:
        self._now_s = start_s

    def now_s(self) -> float:
        return self._now_s

    def sleep_until_s(self, time_s: float) -> None:
        """Jump to `time_s`; never backwards."""
        if time_s > self._now_s:
            self._now_s = time_s
