"""What the working process tells its guard, a line of JSON at a time through a pipe.

    begun     the working process holds its `LastBreath`
    holds     before a port is opened: role, driver, port, options, dead_man_s; from now on the guard answers for it
    given_up  the output is not confirmed off, everything has been tried, and that is told: nothing more is sent at once
    let_go    the output is off, confirmed, and the port is closed
    not_opened  the controller that was told of last was not opened: it was never ours, or what was given up still is
    busy      the output is armed: `alive` has to come from now on
    idle      the output is off, confirmed; nothing has to come
    expects   what the thermometer would show if the output went off now (`rig.safety.after_off.Courses`), or null
    records   a run begins: the folder that it writes into; "" where a daemon's job is over, and told
    .         alive: a tick of the loop was completed

A pipe whose reader has gone says that the guard is dead: `alive` then raises `GuardGone`, and the output is off on the
way out. On Linux the kernel sends SIGTERM at that moment besides, so that nobody has to wait for a tick. A guard that
is suspended (SIGSTOP) watches nothing: there `rig.guard.suspended` sends the SIGTERM. Nor does one that reads nothing
though it is not suspended (a frozen control group, a disk that does not answer): the pipe is full after some minutes,
and `alive` raises `GuardGone` then, too.

The pipe never blocks. What has to arrive and finds no room is kept, and goes before all else when there is some.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import threading
import time
from typing import TYPE_CHECKING, Any, Final, Protocol

from rig.core.outcome import Outcome, Stopped
from rig.guard.last_breath import LastBreath
from rig.guard.suspended import SuspendedWatch

if TYPE_CHECKING:
    from rig.safety.after_off import Courses

ALIVE: Final = b".\n"
LAST_WAIT_S = 1.0  # for room in the pipe, where no tick follows that could tell it later; the output is off by then
DEAF_S = 10.0  # with a full pipe: a guard on the busiest computer reads it many times
WHOLE: Final = int(getattr(select, "PIPE_BUF", 512))  # bytes that a pipe takes at once or not at all (POSIX)


class GuardGone(Outcome):
    """The guard process has died: without it nothing goes on."""


def say_who_died(guard: Guard, stopped: Stopped) -> None:
    """A signal may be the kernel's own, since the guard is dead: then it says so."""
    try:
        guard.alive()
    except GuardGone as gone:
        stopped.add_note(str(gone))


class Guard(Protocol):
    """What a bench and its loop tell; no method waits."""

    guarding: bool

    def holds(self, role: str, driver: str, port: str, options: dict[str, Any], dead_man_s: float = 0.0) -> None:
        """A port is about to be opened, by `rig.drivers.registry.open_controller` or `open_meter` with these.

        dead_man_s: what a controller's dead man will be configured to.
        """

    def let_go(self) -> None:
        """No port is ours any more, and the output that was is off, confirmed."""

    def not_opened(self) -> None:
        """The port of the controller that was told of last could not be opened."""

    def given_up(self) -> None:
        """The output is not confirmed off, and nothing is left to be tried at once; the user is told so."""

    def busy(self) -> None:
        """The output may come on: ticks have to be completed from now on."""

    def idle(self) -> None:
        """The output is off, confirmed."""

    def alive(self) -> None:
        """A tick was completed. Raises GuardGone where the guard has died, or is suspended."""

    def records(self, folder: str) -> None:
        """A run begins, which writes into this folder; "" where it is over, and its report drawn."""

    def expects(self, courses: Courses | None) -> None:
        """What the thermometer would show if the output went off now, None where no reading could choose."""


class _Unguarded:
    """Nobody is told: simulated ports, or a system without fork."""

    guarding = False

    def holds(self, role: str, driver: str, port: str, options: dict[str, Any], dead_man_s: float = 0.0) -> None:
        pass

    def let_go(self) -> None:
        pass

    def not_opened(self) -> None:
        pass

    def given_up(self) -> None:
        pass

    def busy(self) -> None:
        pass

    def idle(self) -> None:
        pass

    def alive(self) -> None:
        pass

    def records(self, folder: str) -> None:
        pass

    def expects(self, courses: Courses | None) -> None:
        pass


UNGUARDED: Final[Guard] = _Unguarded()


class GuardLine:
    """The pipe to the guard. writer: its file descriptor; guard_pid: the guard's process number.

    last_breath: what the guard waits for, held from now on.
    """

    guarding = True

    def __init__(self, writer: int, guard_pid: int, last_breath: LastBreath | None = None) -> None:
        self._writer = writer
        self._guard_pid = guard_pid
        self._last_breath = last_breath
        self._lock = threading.Lock()  # a job's thread ticks, the main thread tells what became of the output
        self._kept = b""  # what has to arrive, and found no room yet
        self._full_s: float | None = None  # since when there has been no room
        os.set_blocking(writer, False)
        if last_breath is not None:
            last_breath.hold()
            self._tell(event="begun")
        self._suspended = SuspendedWatch(guard_pid)
        self._suspended.start()

    def holds(self, role: str, driver: str, port: str, options: dict[str, Any], dead_man_s: float = 0.0) -> None:
        held = {"role": role, "driver": driver, "port": port, "options": options, "dead_man_s": dead_man_s}
        self._tell(LAST_WAIT_S, event="holds", **held)

    def let_go(self) -> None:
        self._tell(LAST_WAIT_S, event="let_go")

    def not_opened(self) -> None:
        self._tell(LAST_WAIT_S, event="not_opened")

    def given_up(self) -> None:
        self._tell(LAST_WAIT_S, event="given_up")

    def busy(self) -> None:
        self._tell(event="busy")

    def idle(self) -> None:
        self._tell(event="idle")

    def alive(self) -> None:
        if self._suspended.found:
            raise GuardGone(f"the guard process {self._guard_pid} is suspended")
        self._write(ALIVE)

    def records(self, folder: str) -> None:
        self._tell(event="records", folder=folder)

    def expects(self, courses: Courses | None) -> None:
        table = courses.table() if courses is not None else None
        line = json.dumps({"event": "expects", "courses": table}).encode() + b"\n"
        if len(line) <= WHOLE:
            self._write(line)

    def _write(self, line: bytes) -> None:
        """A line that may be left out where the guard is behind: the next says nearly the same. Raises GuardGone."""
        try:
            taken = self._offer(line, kept=False)
        except OSError:
            raise GuardGone(f"the guard process {self._guard_pid} has died") from None
        if not taken and self._full_s is not None and time.monotonic() - self._full_s >= DEAF_S:
            raise GuardGone(f"the guard process {self._guard_pid} has read nothing for {DEAF_S:g} s")

    def _tell(self, patience_s: float = 0.0, **message: Any) -> None:
        """A line that has to arrive, now or before the next one. A guard that has died is noticed by `alive`, never on
        the way out. patience_s: for a guard that is behind, where no next one may follow."""
        line, until_s = json.dumps(message).encode() + b"\n", time.monotonic() + patience_s
        with contextlib.suppress(OSError):
            taken = self._offer(line, kept=True)
            while not taken and (wait_s := until_s - time.monotonic()) > 0.0:
                select.select([], [self._writer], [], wait_s)
                taken = self._offer(b"", kept=True)

    def _offer(self, line: bytes, kept: bool) -> bool:
        """Into the pipe, behind what was kept, without waiting; False where there was no room for all of it, and then
        it is kept or left out. One that is left out is at most WHOLE. Raises OSError where the guard has died."""
        with self._lock:
            if kept:
                self._kept += line
            try:
                while self._kept:
                    self._kept = self._kept[os.write(self._writer, self._kept) :]
                if not kept:
                    os.write(self._writer, line)
            except BlockingIOError:
                self._full_s = self._full_s if self._full_s is not None else time.monotonic()
                return False
            self._full_s = None
            return True
