"""How guard and working process notice each other's end.

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
import mmap
import os
import signal
import sys
import threading
from pathlib import Path

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
