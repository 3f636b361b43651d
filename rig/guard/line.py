"""What the working process tells its guard, a line of JSON at a time through a pipe.

    begun     the working process holds its `LastBreath`
    holds     before a port is opened: role, driver, port, options, dead_man_s; from now on the guard answers for it
    given_up  the output is not confirmed off, everything has been tried, and that is told: nothing more is sent at once
    let_go    the output is off, confirmed, and the port is closed; or it was never ours
    busy      the output is armed: `alive` has to come from now on
    idle      the output is off, confirmed; nothing has to come
    expects   what the thermometer would show if the output went off now (`rig.safety.after_off.Courses`), or null
    records   a run begins: the folder that it writes into
    .         alive: a tick of the loop was completed

A pipe whose reader has gone says that the guard is dead: `alive` then raises `GuardGone`, and the output is off on the
way out. On Linux the kernel sends SIGTERM at that moment besides, so that nobody has to wait for a tick. A guard that
is suspended (SIGSTOP) watches nothing: there `rig.guard.suspended` sends the SIGTERM.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
from typing import TYPE_CHECKING, Any, Final, Protocol

from rig.core.outcome import Outcome
from rig.guard.last_breath import LastBreath
from rig.guard.suspended import SuspendedWatch

if TYPE_CHECKING:
    from rig.safety.after_off import Courses

ALIVE: Final = b".\n"
WHOLE: Final = int(getattr(select, "PIPE_BUF", 512))  # bytes that a pipe takes at once or not at all (POSIX)


class GuardGone(Outcome):
    """The guard process has died: without it nothing goes on."""


class Guard(Protocol):
    """What a bench and its loop tell; no method waits."""

    guarding: bool

    def holds(self, role: str, driver: str, port: str, options: dict[str, Any], dead_man_s: float = 0.0) -> None:
        """A port is about to be opened, by `rig.drivers.registry.open_controller` or `open_meter` with these.

        dead_man_s: what a controller's dead man will be configured to.
        """

    def let_go(self) -> None:
        """No port is ours any more, and the output that was is off, confirmed."""

    def given_up(self) -> None:
        """The output is not confirmed off, and nothing is left to be tried at once; the user is told so."""

    def busy(self) -> None:
        """The output may come on: ticks have to be completed from now on."""

    def idle(self) -> None:
        """The output is off, confirmed."""

    def alive(self) -> None:
        """A tick was completed. Raises GuardGone where the guard has died, or is suspended."""

    def records(self, folder: str) -> None:
        """A run begins, which writes into this folder."""

    def expects(self, courses: Courses | None) -> None:
        """What the thermometer would show if the output went off now, None where no reading could choose."""


class _Unguarded:
    """Nobody is told: simulated ports, or a system without fork."""

    guarding = False

    def holds(self, role: str, driver: str, port: str, options: dict[str, Any], dead_man_s: float = 0.0) -> None:
        pass

    def let_go(self) -> None:
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
        os.set_blocking(writer, False)
        if last_breath is not None:
            last_breath.hold()
            self._tell(event="begun")
        self._suspended = SuspendedWatch(guard_pid)
        self._suspended.start()

    def holds(self, role: str, driver: str, port: str, options: dict[str, Any], dead_man_s: float = 0.0) -> None:
        self._tell(event="holds", role=role, driver=driver, port=port, options=options, dead_man_s=dead_man_s)

    def let_go(self) -> None:
        self._tell(event="let_go")

    def given_up(self) -> None:
        self._tell(event="given_up")

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
        """Without waiting. Raises GuardGone."""
        try:
            os.write(self._writer, line)
        except BlockingIOError:  # the guard is behind: what it has not read yet says nearly the same
            pass
        except OSError:
            raise GuardGone(f"the guard process {self._guard_pid} has died") from None

    def _tell(self, **message: Any) -> None:
        """Short lines go through a pipe whole. A guard that has died is noticed by `alive`, never on the way out."""
        with contextlib.suppress(BrokenPipeError):
            os.set_blocking(self._writer, True)
            try:
                os.write(self._writer, json.dumps(message).encode() + b"\n")
            finally:
                os.set_blocking(self._writer, False)
