"""Noticing that the guard process is suspended: it then watches nothing, and the working process must not go on alone.

Linux: the third field of /proc/PID/stat is T (or t, under a debugger) for a process that is stopped, and for no other,
however busy the computer is. So there is no time-out that a slow computer could run into. Elsewhere nobody notices.
Source: Linux man page proc_pid_stat(5).
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from pathlib import Path

LOOK_S = 0.25  # a guard that is suspended is noticed within a second, also where this thread has to wait for its turn
STOPPED = ("T", "t")


def is_suspended(pid: int) -> bool:
    """Whether the process is stopped; False where that cannot be known."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return False
    return text.rpartition(")")[2].split()[:1] in ([state] for state in STOPPED)  # the name may have blanks in it


class SuspendedWatch:
    """A thread that looks at the guard's state, and sends SIGTERM to this process, once, when the guard is suspended.

    found: whether it was.
    """

    def __init__(self, guard_pid: int) -> None:
        self._guard_pid = guard_pid
        self.found = False

    def start(self) -> None:
        """Begin to watch, where there is a /proc."""
        if sys.platform == "linux":
            threading.Thread(target=self._watch, name="suspended-guard", daemon=True).start()

    def _watch(self) -> None:
        never = threading.Event()
        while not never.wait(LOOK_S):
            if is_suspended(self._guard_pid):
                self.found = True
                os.kill(os.getpid(), signal.SIGTERM)
                with contextlib.suppress(OSError, ValueError):  # the terminal has gone
                    print(
                        f"peltier: the guard process {self._guard_pid} is suspended: ending with the output off",
                        file=sys.stderr,
                        flush=True,
                    )
                return
