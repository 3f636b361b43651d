"""Messages from the working process to its guard: lines of JSON through a pipe that never blocks.

    begun       the working process holds its `DeathNotice`
    holds       a port is about to be opened: role, driver, port, options, dead_man_s; the guard answers for it from now
    given_up    the output is not confirmed off, everything was tried, and the user is told; nothing more is sent now
    let_go      the output is off, confirmed, and the port is closed
    not_opened  the controller of the last `holds` could not be opened: it never was ours, or is still given up
    busy        the output is armed: `alive` has to come from now on
    idle        the output is off, confirmed; `alive` need not come
    expects     temperatures to expect if the output went off now (`rig.safety.after_off.ExpectedCurves`), or null
    records     a run begins, in this folder; "" once a daemon's job is over and reported
    .           alive: a control cycle was completed

If the guard dies, the pipe breaks: `alive` raises `GuardGone`, and the output goes off on the way out. On Linux the
kernel sends SIGTERM at that moment, so that nobody waits for a cycle. If the guard is suspended, `SuspensionWatch` does
so. If it reads nothing although it is not suspended (a frozen control group, a disk that hangs), the pipe fills up
within minutes, and `alive` raises `GuardGone` as well.

A message that must arrive and finds no room is kept, and goes before all others as soon as there is room.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import threading
import time
from typing import TYPE_CHECKING, Any, Final

from rig.core.outcome import Outcome, Stopped
from rig.guard.liveness import DeathNotice, SuspensionWatch

if TYPE_CHECKING:
    from rig.safety.after_off import ExpectedCurves

ALIVE: Final = b".\n"
LAST_WAIT_S = 1.0  # for room in the pipe where no later cycle would deliver the message; the output is off by then
DEAF_S = 10.0  # with a full pipe; a guard on the busiest computer reads it many times in that time
WHOLE: Final = int(getattr(select, "PIPE_BUF", 512))  # bytes that a pipe takes all or not at all (POSIX)


class GuardGone(Outcome):
    """The guard process has died or does not react; nothing goes on without it."""


class Guard:
    """Interface of a bench and its loop to the guard; no method waits. This one is for work without a guard process:
    simulated ports, or a system without fork."""

    guarding = False

    def holds(self, role: str, driver: str, port: str, options: dict[str, Any], dead_man_s: float = 0.0) -> None:
        """Announce that a port is about to be opened, by `rig.drivers.registry.open_controller` or `open_meter`.

        dead_man_s: time that the controller's dead man will be configured to.
        """

    def let_go(self) -> None:
        """Report that no port is held any more, and that the output is off, confirmed."""

    def not_opened(self) -> None:
        """Report that the controller of the last `holds` could not be opened."""

    def given_up(self) -> None:
        """Report that the output is not confirmed off, that nothing more is tried now, and that the user is told."""

    def busy(self) -> None:
        """Report that the output may come on: cycles have to be completed from now on."""

    def idle(self) -> None:
        """Report that the output is off, confirmed."""

    def alive(self) -> None:
        """Report a completed cycle. Raises GuardGone."""

    def records(self, folder: str) -> None:
        """Report the folder of the run that begins; "" once it is over and its report drawn."""

    def expects(self, curves: ExpectedCurves | None) -> None:
        """Report the temperatures to expect if the output went off now; None if no reading could decide."""


UNGUARDED: Final = Guard()


def add_guard_death(guard: Guard, stopped: Stopped) -> None:
    """Add a note to an end by a signal if the signal came because the guard is dead."""
    try:
        guard.alive()
    except GuardGone as gone:
        stopped.add_note(str(gone))


class GuardPipe(Guard):
    """The pipe to the guard process. writer: its file descriptor; notice: the death notice, held from now on."""

    guarding = True

    def __init__(self, writer: int, guard_pid: int, notice: DeathNotice | None = None) -> None:
        self._writer, self._guard_pid, self._notice = writer, guard_pid, notice
        self._lock = threading.Lock()  # a job's thread reports cycles, the main thread the state of the output
        self._kept = b""  # must arrive, and found no room yet
        self._full_since_s: float | None = None
        os.set_blocking(writer, False)
        if notice is not None:
            notice.hold()
            self._send(event="begun")
        self._suspension = SuspensionWatch(guard_pid)

    def holds(self, role: str, driver: str, port: str, options: dict[str, Any], dead_man_s: float = 0.0) -> None:
        held = {"role": role, "driver": driver, "port": port, "options": options, "dead_man_s": dead_man_s}
        self._send(LAST_WAIT_S, event="holds", **held)

    def let_go(self) -> None:
        self._send(LAST_WAIT_S, event="let_go")

    def not_opened(self) -> None:
        self._send(LAST_WAIT_S, event="not_opened")

    def given_up(self) -> None:
        self._send(LAST_WAIT_S, event="given_up")

    def busy(self) -> None:
        self._send(event="busy")

    def idle(self) -> None:
        self._send(event="idle")

    def alive(self) -> None:
        if self._suspension.found:
            raise GuardGone(f"the guard process {self._guard_pid} is suspended")
        self._send_or_drop(ALIVE)

    def records(self, folder: str) -> None:
        self._send(event="records", folder=folder)

    def expects(self, curves: ExpectedCurves | None) -> None:
        table = curves.table() if curves is not None else None
        line = json.dumps({"event": "expects", "curves": table}).encode() + b"\n"
        if len(line) <= WHOLE:
            self._send_or_drop(line)

    def _send_or_drop(self, line: bytes) -> None:
        """Send a line that may be dropped if the guard is behind: the next one says nearly the same. Raises
        GuardGone."""
        try:
            sent = self._offer(line, keep=False)
        except OSError:
            raise GuardGone(f"the guard process {self._guard_pid} has died") from None
        if not sent and self._full_since_s is not None and time.monotonic() - self._full_since_s >= DEAF_S:
            raise GuardGone(f"the guard process {self._guard_pid} has read nothing for {DEAF_S:g} s")

    def _send(self, patience_s: float = 0.0, **message: Any) -> None:
        """Send a line that must arrive, now or before the next one. patience_s: for room, where no next one may follow.
        A dead guard is reported by `alive` only, never on the way out."""
        line, until_s = json.dumps(message).encode() + b"\n", time.monotonic() + patience_s
        with contextlib.suppress(OSError):
            sent = self._offer(line, keep=True)
            while not sent and (wait_s := until_s - time.monotonic()) > 0.0:
                select.select([], [self._writer], [], wait_s)
                sent = self._offer(b"", keep=True)

    def _offer(self, line: bytes, keep: bool) -> bool:
        """Write the kept lines, then this one, without waiting; False if there was no room for all of it. A line that
        is not kept is at most WHOLE long. Raises OSError if the guard has died."""
        with self._lock:
            if keep:
                self._kept += line
            try:
                while self._kept:
                    self._kept = self._kept[os.write(self._writer, self._kept) :]
                if not keep:
                    os.write(self._writer, line)
            except BlockingIOError:
                self._full_since_s = self._full_since_s if self._full_since_s is not None else time.monotonic()
                return False
            self._full_since_s = None
            return True
