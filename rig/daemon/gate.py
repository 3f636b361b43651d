"""The gate between experiments and the controller: STOP passes it at any moment, nothing else after.

A job's thread and STOP share one wire. Every exchange holds the gate's lock; STOP closes the gate, waits for the
exchange that is under way, and commands the output off there and then, whatever the job's thread is doing. At its next
call the job finds the gate closed and ends by the exception that the gate was closed with. Whichever of the two is
first at the lock then commands "off", once for both: a second one would feed the dead man of a controller that does not
obey.

Each job has a pass of its own. A job whose thread does not end (it computes while the instruments are gone) is left to
itself, and its pass is void: whatever that thread does when it awakes reaches neither the instruments, which another
job may have by then, nor the guard.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, cast

from rig.core.clock import Clock
from rig.drivers.controller import TemperatureController
from rig.drivers.meter import ResistanceMeter
from rig.guard.line import Guard
from rig.safety.switching_off import confirmed_by

PATIENCE_S = 5.0  # for the exchange under way; longer than any write or read time-out
# what switching off needs, to its verdict; and the answer that a meter was asked for before
ALWAYS_OPEN = {"off", "close", "status", "read_current", "finish_reading"}


@dataclass(frozen=True)
class Off:
    """What switching off gave: whether the controller confirmed it, how long it took (s), on what "confirmed" rests."""

    confirmed: bool
    took_s: float
    confirmed_by: str | None = None


class Pass:
    """One job's way through the gate. void: why there is none any more; off_confirmed: what it is told of the output
    then."""

    def __init__(self, gate: Gate) -> None:
        self._gate = gate
        self.void: BaseException | None = None
        self.off_confirmed = False

    def check(self) -> None:
        """Raises what the pass is void for, or the gate was closed with."""
        self.check_void()
        self._gate.check()

    def check_void(self) -> None:
        """Raises what the pass is void for."""
        if self.void is not None:
            raise self.void


class Gate:
    """The lock, the controller behind it, and why it is closed."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._now_s = clock
        self._lock = threading.RLock()
        self._closing = threading.Lock()
        self._controller: TemperatureController | None = None
        self._off: tuple[BaseException, bool] | None = None  # what it was closed with, and what "off" gave since
        self.closed: BaseException | None = None
        self.changed = threading.Event()  # wakes who sleeps at the gate

    def attach(self, controller: TemperatureController | None) -> None:
        """The controller that STOP acts on from now on; None where there is none."""
        with self._lock:
            self._controller = controller

    def stop(self, why: BaseException) -> Off:
        """Close the gate and command the output off, from any thread; the first reason stays."""
        begin = self._now_s()
        with self._closing:
            first = self.closed is None
            closed = self.closed = why if self.closed is None else self.closed
        self.changed.set()
        confirmed, rests_on = False, None
        if self._lock.acquire(timeout=PATIENCE_S):
            try:
                if self._controller is not None:
                    off = self._since(closed) if first else None  # a job's, that was before at the lock
                    confirmed = self._controller.off() if off is None else off
                    self._off = closed, confirmed
                    rests_on = confirmed_by(self._controller) if confirmed else None
            finally:
                self._lock.release()
        return Off(confirmed, self._now_s() - begin, rests_on)

    def open(self) -> None:
        """Let a job pass."""
        with self._closing:
            self.closed = None
            self.changed.clear()

    def check(self) -> None:
        """Raises what the gate was closed with."""
        if self.closed is not None:
            raise self.closed

    def controller_for_jobs(self, controller: TemperatureController, by: Pass) -> TemperatureController:
        """The controller as a job sees it."""
        gated = _Gated(controller, self._lock, by.check, by.check_void)
        vars(gated)["off"] = lambda: self._off_of_a_job(controller, by)
        return cast(TemperatureController, gated)

    def _off_of_a_job(self, controller: TemperatureController, by: Pass) -> bool:
        """What the "off" gave that has been commanded since the gate was closed; without one it is commanded now, and
        is that of a STOP, too, which waits for the lock meanwhile."""
        with self._lock:
            if by.void is not None:
                return by.off_confirmed
            off = self._since(self.closed)
            if off is None:
                off = controller.off()
                if self.closed is not None:
                    self._off = self.closed, off
            return off

    def _since(self, closed: BaseException | None) -> bool | None:
        """What "off" gave since the gate was closed with that; None where none was commanded."""
        return self._off[1] if self._off is not None and self._off[0] is closed else None

    def controller_for_idling(self, controller: TemperatureController) -> TemperatureController:
        """The controller as the idle loop sees it: one exchange at a time, the gate open or closed."""
        return cast(TemperatureController, _Gated(controller, self._lock, _pass, _pass))

    def meter_for_jobs(self, meter: ResistanceMeter, by: Pass) -> ResistanceMeter:
        """The meter as a job sees it. It has a wire of its own, so that STOP need not wait for a reading."""
        return cast(ResistanceMeter, _Gated(meter, None, by.check, by.check_void))

    def guard_for_jobs(self, guard: Guard, by: Pass) -> Guard:
        """The guard as a job sees it: told nothing by one whose pass is void."""
        return cast(Guard, _Told(guard, by))


class StoppableClock:
    """A clock whose sleeper STOP wakes; it also knows how late the last sleepers were."""

    def __init__(self, clock: Clock, gate: Gate, by: Pass, real: bool) -> None:
        self._clock, self._gate, self._pass, self._real = clock, gate, by, real
        self.latest_s = 0.0

    def now_s(self) -> float:
        """Seconds of the clock below."""
        return self._clock.now_s()

    def sleep_until_s(self, time_s: float) -> None:
        """Sleep. Raises what the gate is closed with, or the pass void for."""
        self._pass.check()
        remaining_s = time_s - self._clock.now_s()
        if remaining_s <= 0.0 or not self._real:
            self._clock.sleep_until_s(time_s)
        elif self._gate.changed.wait(remaining_s):
            self._pass.check()
            self._clock.sleep_until_s(time_s)
        self.latest_s = max(self.latest_s, self._clock.now_s() - time_s)


def _pass() -> None:
    """The gate of those who may always."""


class _Told:
    """A guard that hears a job as long as its pass is good."""

    def __init__(self, guard: Guard, by: Pass) -> None:
        self._guard, self._pass = guard, by

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._guard, name)
        if not callable(value):
            return value
        return lambda *args, **more: value(*args, **more) if self._pass.void is None else None


class _Gated:
    """An instrument whose every method first asks the gate and holds the lock. check_off: asked by the methods of
    `ALWAYS_OPEN`."""

    def __init__(self, instrument: Any, lock: Any, check: Callable[[], None], check_off: Callable[[], None]) -> None:
        self._instrument, self._lock, self._check, self._check_off = instrument, lock, check, check_off

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._instrument, name)
        if not callable(value):
            return value
        check, lock = (self._check_off if name in ALWAYS_OPEN else self._check), self._lock

        def passed(*args: Any, **more: Any) -> Any:
            if lock is None:
                check()
                return value(*args, **more)
            with lock:
                check()
                return value(*args, **more)

        self.__dict__[name] = passed
        return passed
