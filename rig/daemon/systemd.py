"""Telling systemd: READY=1 once, WATCHDOG=1 after completed control cycles, STATUS for `systemctl status`.

And when it ends, how long that may take. A daemon that is silent so that the dead man of a controller which does not
obey acts, ended in that silence by TimeoutStopSec and begun again, would speak to the controller too early.

The protocol of sd_notify(3): datagrams to the socket that NOTIFY_SOCKET names. Without it nothing is sent.
"""

from __future__ import annotations

import contextlib
import math
import os
import socket
import time
from types import FrameType

from rig.safety.signals import SignalStop

EVERY_S = 1.0  # at most one WATCHDOG=1 in this time
ENDS_S = 25.0  # all of an end but the dead man's time: the exchange under way, a job's thread, rows, log, page


def watchdog_s() -> float:
    """WatchdogSec of the unit that this was started by, infinite where there is none."""
    text = os.environ.get("WATCHDOG_USEC", "")
    return int(text) * 1e-6 if text.isdecimal() and int(text) > 0 else math.inf


class Notifier:
    """Where systemd listens, if it does."""

    def __init__(self) -> None:
        address = os.environ.get("NOTIFY_SOCKET", "")
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._fed_s = -EVERY_S
        self._socket: socket.socket | None = None
        if self._address:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            self._socket.setblocking(False)

    def tell(self, text: str) -> None:
        """Send lines such as "READY=1"; never raises, never waits."""
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.sendto(text.encode(), self._address)

    def ready(self, status: str) -> None:
        """The bench is held and its output is off."""
        self.tell(f"READY=1\nSTATUS={status}")

    def cycle(self) -> None:
        """A control cycle was completed: the only thing that feeds the watchdog."""
        if self._socket is None:
            return
        now_s = time.monotonic()
        if now_s - self._fed_s >= EVERY_S:
            self._fed_s = now_s
            self.tell("WATCHDOG=1")

    def ends(self, within_s: float) -> None:
        """The end has begun: a TimeoutStopSec that is shorter than this is extended, a longer one stays."""
        self.tell(f"EXTEND_TIMEOUT_USEC={math.ceil(1e6 * within_s)}")

    def close(self) -> None:
        """Tell nothing more."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None


class EndTold(SignalStop):
    """A `SignalStop` that tells systemd at once how long the end may take: what switches the output off on the way out
    may wait for the controller's dead man, before the daemon is ready as well as after."""

    def __init__(self, notifier: Notifier, dead_man_s: float) -> None:
        super().__init__()
        self._notifier, self._within_s = notifier, ENDS_S + dead_man_s

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if self.received is None:
            self._notifier.ends(self._within_s)
        super()._handle(number, frame)
