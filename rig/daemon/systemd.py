"""Messages to systemd: READY=1 once, WATCHDOG=1 after completed control cycles, STATUS for `systemctl status`.

At the end, also how long the end may take. A controller that does not obey is left in silence until its own dead man
acts; a daemon that TimeoutStopSec ends in that silence would be started again and talk to the controller too early.

The protocol is that of sd_notify(3): datagrams to the socket in NOTIFY_SOCKET. Without it nothing is sent.
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
ENDS_S = 25.0  # an end without the dead man's time: the exchange under way, a job's thread, rows, log, page


def watchdog_s() -> float:
    """Return WatchdogSec of the unit that started this; infinity if there is none."""
    text = os.environ.get("WATCHDOG_USEC", "")
    return int(text) * 1e-6 if text.isdecimal() and int(text) > 0 else math.inf


class Notifier:
    """Sends to systemd, if it listens; never raises, never waits."""

    def __init__(self) -> None:
        address = os.environ.get("NOTIFY_SOCKET", "")
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._fed_s = -EVERY_S
        self._socket: socket.socket | None = None
        if self._address:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            self._socket.setblocking(False)

    def send(self, text: str) -> None:
        """Send lines such as "READY=1"."""
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.sendto(text.encode(), self._address)

    def ready(self, status: str) -> None:
        """Report that the bench is held and its output off."""
        self.send(f"READY=1\nSTATUS={status}")

    def cycle(self) -> None:
        """Report a completed control cycle; nothing else feeds the watchdog."""
        now_s = time.monotonic()
        if self._socket is not None and now_s - self._fed_s >= EVERY_S:
            self._fed_s = now_s
            self.send("WATCHDOG=1")

    def ends(self, within_s: float) -> None:
        """Report that the end has begun: a TimeoutStopSec that is shorter than this is extended."""
        self.send(f"EXTEND_TIMEOUT_USEC={math.ceil(1e6 * within_s)}")

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None


class SignalStopWithNotice(SignalStop):
    """A `SignalStop` that reports to systemd at once how long the end may take, before the daemon is ready as well."""

    def __init__(self, notifier: Notifier, dead_man_s: float) -> None:
        super().__init__()
        self._notifier, self._within_s = notifier, ENDS_S + dead_man_s

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if self.received is None:
            self._notifier.ends(self._within_s)
        super()._handle(number, frame)
