"""Messages from the working process to its guard: lines of JSON through a pipe that never blocks.

    begun       the working process holds its `DeathNotice`
    holds       a port is about to be opened: role, driver, port, options, dead_man_s; the guard answers for it from now
    given_up    the output is not confirmed off, everything was tried, and the user is told; nothing more is sent now
    let_go      the output is off, confirmed, and the port is closed
    not_opened  the controller of the last `holds` could not be opened: it never was ours, or is still given up
    busy        the output is armed: `alive` has to come from now on
    idle        the output is off, confirmed; `alive` need not come
    expects     temperatures to expect if the output went off now (`rig.safety.switching_off.ExpectedCurves`), or null
    records     a run begins, in this folder; "" once a daemon's job is over and reported
    .           alive: a control cycle was completed

If the guard dies, the pipe breaks: `alive` raises `GuardGone`, and the output goes off on the way out. On Linux the
kernel sends SIGTERM at that moment, so that nobody waits for a cycle. If the guard is suspended, `SuspensionWatch` does
so. If it reads nothing although it is not suspended (a frozen control group, a disk that hangs), the pipe fills up
within minutes, and `alive` raises `GuardGone` as well.

A message that must arrive and finds no room is kept, and goes before all others as soon as there is room.

The guard hears of the working process's death through a robust mutex in shared memory: the working process locks it and
never releases it. When that process dies, of whatever cause, the kernel wakes the waiting guard (EOWNERDEAD) as one of
the first things it does; SIGCHLD, a pidfd and the end of a pipe come only after its memory has been freed, which takes
tens of ms for a large process.

The working process hears of the guard's death by its parent-death signal (Linux) and by the broken pipe, and of its
suspension by the third field of /proc/PID/stat, which is T (or t, under a debugger) for a stopped process and for no
other, however busy the computer is. Elsewhere than on Linux a suspended guard goes unnoticed.

Sources: The Open Group, POSIX.1-2017, pthread_mutexattr_setrobust; Linux Documentation/locking/robust-futexes.rst;
Linux man pages prctl(2), proc_pid_stat(5).
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import mmap
import os
import select
import signal
import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from rig.core.outcome import Outcome, Stopped

if TYPE_CHECKING:
    from rig.safety.switching_off import ExpectedCurves

MUTEX_BYTES = 64  # largest size of a pthread_mutex_t and its attributes
PROCESS_SHARED = ROBUST = 1
PR_SET_PDEATHSIG = 1  # of linux/prctl.h
LOOK_S = 0.25  # a suspended guard is noticed within a second, even if this thread has to wait for its turn
STOPPED = ("T", "t")


class DeathNotice:
    """A robust mutex. Make it before the fork; `hold` in the working process, then `write_at_death` in the guard.

    Raises OSError or AttributeError if the system has no such mutex.
    """

    def __init__(self) -> None:
        self._libc = ctypes.CDLL(None)
        self._memory = mmap.mmap(-1, mmap.PAGESIZE)
        self._mutex = (ctypes.c_char * MUTEX_BYTES).from_buffer(self._memory)
        attributes = ctypes.create_string_buffer(MUTEX_BYTES)
        for error in (
            self._libc.pthread_mutexattr_init(attributes),
            self._libc.pthread_mutexattr_setpshared(attributes, PROCESS_SHARED),
            self._libc.pthread_mutexattr_setrobust(attributes, ROBUST),
            self._libc.pthread_mutex_init(self._mutex, attributes),
        ):
            if error:
                raise OSError(error, os.strerror(error))

    @classmethod
    def if_possible(cls) -> DeathNotice | None:
        """Return one; None if the system has no such mutex: the guard then hears of a death some ms later."""
        try:
            return cls()
        except (OSError, AttributeError):
            return None

    def hold(self) -> None:
        """Lock the mutex, in the thread whose death is the process's."""
        self._libc.pthread_mutex_lock(self._mutex)

    def write_at_death(self, descriptor: int) -> None:
        """Write a byte 0 to the descriptor when the other process dies, in a thread."""

        def wait() -> None:
            self._libc.pthread_mutex_lock(self._mutex)
            with contextlib.suppress(OSError):  # nobody waits any more
                os.write(descriptor, b"\0")

        threading.Thread(target=wait, name="death notice", daemon=True).start()


def die_with(guard_pid: int) -> None:
    """Have the kernel send SIGTERM to this process when the guard dies (Linux)."""
    if sys.platform == "linux":
        with contextlib.suppress(OSError, AttributeError):
            ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
    if os.getppid() != guard_pid:  # the guard died before that
        os._exit(128 + signal.SIGTERM)


def is_suspended(pid: int) -> bool:
    """Return True if the process is stopped; False if that cannot be known."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return False
    return text.rpartition(")")[2].split()[:1] in ([state] for state in STOPPED)  # the name may contain blanks


class SuspensionWatch:
    """A thread that sends SIGTERM to this process, once, when the guard is suspended. found: True if it was."""

    def __init__(self, guard_pid: int) -> None:
        self._guard_pid = guard_pid
        self.found = False
        if sys.platform == "linux":
            threading.Thread(target=self._watch, name="suspended guard", daemon=True).start()

    def _watch(self) -> None:
        never = threading.Event()
        while not never.wait(LOOK_S):
            if is_suspended(self._guard_pid):
                self.found = True
                os.kill(os.getpid(), signal.SIGTERM)
                text = f"peltier: the guard process {self._guard_pid} is suspended; ending with the output off"
                with contextlib.suppress(OSError, ValueError):  # the terminal has gone
                    print(text, file=sys.stderr, flush=True)
                return


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
        held = {"role": role, "driver": driver, "port": port, "options": options, "dead_man_s": dead_man_s}
        self._send(LAST_WAIT_S, event="holds", **held)

    def let_go(self) -> None:
        """Report that no port is held any more, and that the output is off, confirmed."""
        self._send(LAST_WAIT_S, event="let_go")

    def not_opened(self) -> None:
        """Report that the controller of the last `holds` could not be opened."""
        self._send(LAST_WAIT_S, event="not_opened")

    def given_up(self) -> None:
        """Report that the output is not confirmed off, that nothing more is tried now, and that the user is told."""
        self._send(LAST_WAIT_S, event="given_up")

    def busy(self) -> None:
        """Report that the output may come on: cycles have to be completed from now on."""
        self._send(event="busy")

    def idle(self) -> None:
        """Report that the output is off, confirmed."""
        self._send(event="idle")

    def alive(self) -> None:
        """Report a completed cycle. Raises GuardGone."""

    def records(self, folder: str) -> None:
        """Report the folder of the run that begins; "" once it is over and its report drawn."""
        self._send(event="records", folder=folder)

    def expects(self, curves: ExpectedCurves | None) -> None:
        """Report the temperatures to expect if the output went off now; None if no reading could decide."""

    def _send(self, patience_s: float = 0.0, **message: Any) -> None:
        """Send a message that must arrive; without a guard process there is nobody to send it to."""


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

    def alive(self) -> None:
        if self._suspension.found:
            raise GuardGone(f"the guard process {self._guard_pid} is suspended")
        self._send_or_drop(ALIVE)

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
