"""Hearing of a process's death before the kernel has taken its memory down, which takes tens of ms for a large one.

A robust mutex in shared memory: the working process locks it and never lets go. When it dies, of whatever, the kernel
wakes who waits for the mutex (EOWNERDEAD) as one of the first things it does, before memory and files go. A parent's
SIGCHLD, a pidfd and the end of a pipe all come after that.
Source: The Open Group, POSIX.1-2017, pthread_mutexattr_setrobust; Linux Documentation/locking/robust-futexes.rst.
"""

from __future__ import annotations

import ctypes
import mmap
import os
import threading

SIZE = 64  # of a pthread_mutex_t and its attributes, at most
PROCESS_SHARED = ROBUST = 1


class LastBreath:
    """Make it before the fork. `hold` in the working process; `write_when_it_ends` in the other, after that.

    Raises OSError or AttributeError where the system has no such mutex.
    """

    def __init__(self) -> None:
        self._libc = ctypes.CDLL(None)
        self._memory = mmap.mmap(-1, mmap.PAGESIZE)
        self._mutex = (ctypes.c_char * SIZE).from_buffer(self._memory)
        attributes = ctypes.create_string_buffer(SIZE)
        for done in (
            self._libc.pthread_mutexattr_init(attributes),
            self._libc.pthread_mutexattr_setpshared(attributes, PROCESS_SHARED),
            self._libc.pthread_mutexattr_setrobust(attributes, ROBUST),
            self._libc.pthread_mutex_init(self._mutex, attributes),
        ):
            if done:
                raise OSError(done, os.strerror(done))

    def hold(self) -> None:
        """Lock it, in the thread whose death is the process's."""
        self._libc.pthread_mutex_lock(self._mutex)

    def write_when_it_ends(self, descriptor: int) -> None:
        """A byte 0 to the descriptor when the other process dies; in a thread of its own, which ends with that."""

        def wait() -> None:
            self._libc.pthread_mutex_lock(self._mutex)
            try:
                os.write(descriptor, b"\0")
            except OSError:  # nobody waits any more
                return

        threading.Thread(target=wait, name="last-breath", daemon=True).start()
