"""A process held up from outside, every thread of it, as a computer that stalls does: by ptrace.

SIGSTOP would not do: a run's guard rightly ends a process that is suspended. A process that is traced is reported as
stopped to who traces it, and to no parent.
Source: Linux man page ptrace(2): PTRACE_SEIZE, PTRACE_INTERRUPT, PTRACE_DETACH.
"""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
import time

SEIZE, INTERRUPT, DETACH = 0x4206, 0x4207, 17
ALL_KINDS = 0x40000000  # __WALL: threads of others are waited for, too


def freeze(pid: int, seconds: float) -> int:
    """Hold a process up; how many threads it had, 0 where none could be held. In the thread that calls."""
    libc = ctypes.CDLL(None, use_errno=True)
    libc.ptrace.restype = ctypes.c_long
    libc.ptrace.argtypes = [ctypes.c_long, ctypes.c_long, ctypes.c_void_p, ctypes.c_void_p]
    held = []
    for thread in map(int, os.listdir(f"/proc/{pid}/task")):
        if libc.ptrace(SEIZE, thread, None, None) == 0:
            libc.ptrace(INTERRUPT, thread, None, None)
            os.waitpid(thread, ALL_KINDS)
            held.append(thread)
    time.sleep(seconds)
    for thread in held:
        libc.ptrace(DETACH, thread, None, None)
    return len(held)


def impossible_because() -> str:
    """Why nobody can be held up here; empty where it can be done."""
    if sys.platform != "linux":
        return "ptrace as it is used here is Linux's"
    sleeper = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60.0)"])
    try:
        time.sleep(0.2)
        return "" if freeze(sleeper.pid, 0.0) else "this system lets nobody trace a process (kernel.yama, a container)"
    except (OSError, AttributeError) as error:
        return f"no ptrace: {error}"
    finally:
        sleeper.kill()
        sleeper.wait()
