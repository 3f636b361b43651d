"""Going on when "switch the controller off by hand" has been said: a detached process that tries for a minute more.

It holds the port, so that nobody starts something there meanwhile, and says nothing: whoever was told to switch the
controller off by hand is not told otherwise. Between two trials it is silent for longer than the controller's dead man.
Who wants the port is told who holds it (exit status 75); `peltier off` ends this process and tries itself.
Where there is no fork nothing goes on.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import sys
import time

from rig.guard.takeover import Held, driver_of, opened
from rig.ports.open import STILL_TRYING, is_still_trying
from rig.safety.signals import CAUGHT
from rig.safety.switching_off import MARGIN_S

KEEP_TRYING_S = 60.0  # a dozen times the usual dead man's: by then whoever was called has pulled the plug
BETWEEN_TRIALS_S = 1.0  # a port that was gone needs about that to be there again
PR_SET_NAME = 15  # of linux/prctl.h


def keep_trying(held: Held, seconds: float = KEEP_TRYING_S) -> None:
    """Go on in a process of its own; returns at once in this one."""
    if not hasattr(os, "fork"):
        return
    if os.fork():  # what stdout and stderr have not written yet stays here: the other ends without a flush
        return
    try:
        _detach()
        _try_until(held, time.monotonic() + seconds)
    finally:
        os._exit(0)


def ended(pid: int | None) -> bool:
    """End such a process, if that is what it is and it may be ended; its port is free some ms later."""
    if pid is None or not is_still_trying(pid):
        return False
    try:
        os.kill(pid, signal.SIGKILL)
    except OSError:  # another user's
        return False
    return True


def _detach() -> None:
    """Out of the terminal's and the caller's reach: whoever waits for the caller's output does not wait for this."""
    os.setsid()
    for number in (*CAUGHT, signal.SIGCHLD):
        signal.signal(number, signal.SIG_DFL)
    signal.set_wakeup_fd(-1)
    nothing = os.open(os.devnull, os.O_RDWR)
    for descriptor in (0, 1, 2):
        os.dup2(nothing, descriptor)
    os.closerange(3, 1024)
    if sys.platform == "linux":
        with contextlib.suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(PR_SET_NAME, STILL_TRYING.encode(), 0, 0, 0)


def _try_until(held: Held, until_s: float) -> None:
    pause_s = BETWEEN_TRIALS_S
    if driver_of(held).has_dead_man:
        pause_s = max(pause_s, held.dead_man_s + MARGIN_S)
    controller = None
    while time.monotonic() < until_s:
        try:
            if controller is None:
                controller = opened(held)
            if controller.off():
                return
        except Exception:  # a port that is gone or somebody else's; the next trial tells
            controller = None
        time.sleep(pause_s)
