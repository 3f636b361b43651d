"""The output lock between jobs and the controller: STOP passes it at any moment, and no job after that.

A job's thread and STOP share one wire. Every exchange holds the lock. STOP closes it to jobs, waits for the exchange
under way, and commands the output off, whatever the job's thread is doing. At its next call the job gets the exception
with which the lock was closed. Whichever of the two has the lock first then commands "off", once for both: a second
"off" would feed the dead man of a controller that does not obey.

Each job has a pass of its own. If a job's thread does not end (it computes while the instruments are gone), the job is
ended without it and its pass becomes void: the thread reaches neither the instruments nor the guard any more, which may
belong to another job by then.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, cast

from rig.core.clock import Clock
from rig.drivers.controller import TemperatureController
from rig.drivers.meter import ResistanceMeter
from rig.guard.pipe import Guard
from rig.safety.switching_off import command_off, confirmed_by

PATIENCE_S = 5.0  # for the exchange under way; longer than any write or read time-out
# allowed while the lock is closed: switching off, to its verdict; and the answer of a meter that was asked before
ALWAYS_OPEN = {"off", "close", "status", "read_current", "finish_reading"}


@dataclass(frozen=True)
class Off:
    """Result of switching off: confirmed by the controller or not, duration (s), and the evidence."""

    confirmed: bool
    took_s: float
    confirmed_by: str | None = None


class JobPass:
    """One job's permission. void: why it has none any more; off_confirmed: its result of "off" then."""

    def __init__(self, lock: OutputLock) -> None:
        self._lock = lock
        self.void: BaseException | None = None
        self.off_confirmed = False

    def check(self) -> None:
        """Raise the reason why the pass is void, or the lock closed."""
        self.check_void()
        self._lock.check()

    def check_void(self) -> None:
        if self.void is not None:
            raise self.void


class OutputLock:
    """The lock, the controller behind it, and why it is closed."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._now_s = clock
        self._lock = threading.RLock()
        self._closing = threading.Lock()
        self._controller: TemperatureController | None = None
        self._off: tuple[BaseException, bool] | None = None  # why it was closed, and the result of "off" since
        self.closed: BaseException | None = None
        self.changed = threading.Event()  # wakes a sleeping job

    def attach(self, controller: TemperatureController | None) -> None:
        """Set the controller on which STOP acts; None if there is none."""
        with self._lock:
            self._controller = controller

    def stop(self, why: BaseException) -> Off:
        """Close the lock and command the output off, from any thread; the first reason stays."""
        begin = self._now_s()
        with self._closing:
            first = self.closed is None
            closed = self.closed = why if self.closed is None else self.closed
        self.changed.set()
        confirmed, evidence = False, None
        if self._lock.acquire(timeout=PATIENCE_S):
            try:
                if self._controller is not None:
                    off = self._since(closed) if first else None  # of a job that had the lock before
                    confirmed = command_off(self._controller)[0] if off is None else off
                    self._off = closed, confirmed
                    evidence = confirmed_by(self._controller) if confirmed else None
            finally:
                self._lock.release()
        return Off(confirmed, self._now_s() - begin, evidence)

    def open(self) -> None:
        with self._closing:
            self.closed = None
            self.changed.clear()

    def check(self) -> None:
        if self.closed is not None:
            raise self.closed

    def controller_for_job(self, controller: TemperatureController, by: JobPass) -> TemperatureController:
        locked = _Locked(controller, self._lock, by.check, by.check_void)
        vars(locked)["off"] = lambda: self._off_by_job(controller, by)
        return cast(TemperatureController, locked)

    def _off_by_job(self, controller: TemperatureController, by: JobPass) -> bool:
        """Return the result of the "off" since the lock was closed; without one command it now, also for a STOP that
        waits for the lock meanwhile."""
        with self._lock:
            if by.void is not None:
                return by.off_confirmed
            off = self._since(self.closed)
            if off is None:
                off, _ = command_off(controller)
                if self.closed is not None:
                    self._off = self.closed, off
            return off

    def _since(self, closed: BaseException | None) -> bool | None:
        """Return the result of the "off" since the lock was closed for this reason; None if there was none."""
        return self._off[1] if self._off is not None and self._off[0] is closed else None

    def controller_when_idle(self, controller: TemperatureController) -> TemperatureController:
        """Return the controller as the idle loop uses it: one exchange at a time, the lock open or closed."""
        return cast(TemperatureController, _Locked(controller, self._lock, _always, _always))

    def meter_for_job(self, meter: ResistanceMeter, by: JobPass) -> ResistanceMeter:
        """Return the meter as a job may use it. It has a wire of its own, so that STOP need not wait for a reading."""
        return cast(ResistanceMeter, _Locked(meter, None, by.check, by.check_void))

    def guard_for_job(self, guard: Guard, by: JobPass) -> Guard:
        """Return the guard as a job may use it: a job whose pass is void reports nothing."""
        return cast(Guard, _ReportsWhileValid(guard, by))


class StoppableClock:
    """A clock whose sleeper STOP wakes. latest_s: by how much sleepers were late."""

    def __init__(self, clock: Clock, lock: OutputLock, by: JobPass) -> None:
        self._clock, self._lock, self._pass = clock, lock, by
        self.latest_s = 0.0

    def now_s(self) -> float:
        return self._clock.now_s()

    def sleep_until_s(self, time_s: float) -> None:
        """Sleep. Raises the reason why the lock is closed, or the pass void."""
        self._pass.check()
        remaining_s = time_s - self._clock.now_s()
        if remaining_s > 0.0 and self._lock.changed.wait(remaining_s):
            self._pass.check()
            self._clock.sleep_until_s(time_s)
        self.latest_s = max(self.latest_s, self._clock.now_s() - time_s)


def _always() -> None:
    """Let everybody pass."""


class _ReportsWhileValid:
    """A guard that hears from a job while its pass is valid."""

    def __init__(self, guard: Guard, by: JobPass) -> None:
        self._guard, self._pass = guard, by

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._guard, name)
        if not callable(value):
            return value
        return lambda *args, **more: value(*args, **more) if self._pass.void is None else None


class _Locked:
    """An instrument whose every method first holds the lock (None: no lock) and calls a check; the methods of
    `ALWAYS_OPEN` call check_off."""

    def __init__(self, instrument: Any, lock: Any, check: Callable[[], None], check_off: Callable[[], None]) -> None:
        self._instrument, self._lock = instrument, lock if lock is not None else contextlib.nullcontext()
        self._check, self._check_off = check, check_off

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._instrument, name)
        if not callable(value):
            return value
        check = self._check_off if name in ALWAYS_OPEN else self._check

        def checked(*args: Any, **more: Any) -> Any:
            with self._lock:
                check()
                return value(*args, **more)

        self.__dict__[name] = checked
        return checked
