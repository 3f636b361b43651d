"""Bytes to an instrument and lines back, with one deadline for a whole answer.

A line counts only with its terminator; bytes that trickle in do not extend the deadline; a read never
returns part of a line. What a vanished device makes pyserial raise (SerialException, OSError,
termios.error, TypeError) becomes `Disconnected`. That an answer belongs to its question is proven by the
protocols above, which know how.
"""

from __future__ import annotations

import contextlib
import os
from typing import Protocol

from serial import SerialException, SerialTimeoutException

from rig.core.clock import Clock
from rig.core.errors import Corrupt, Disconnected, InstrumentError, TimedOut

try:
    from termios import error as _TermiosError
except ImportError:  # Windows

    class _TermiosError(Exception):  # type: ignore[no-redef]
        pass


GONE = (OSError, _TermiosError, TypeError)  # a SerialException is an OSError; termios.error is not
LONGEST_LINE = 4096
LAST_HEARD = 80  # bytes, for messages: an identity is shorter
SHORTEST_WAIT_S = 1e-6  # select takes no less


def in_words(error: BaseException) -> str:
    """What a port raised: the system's words where it has a number, which pyserial repeats around them."""
    number = getattr(error, "errno", None)
    if number:
        return os.strerror(number)
    if isinstance(error, TypeError):  # pyserial reads from a descriptor that it has closed
        return "it was closed"
    return str(error) if isinstance(error, SerialException) else f"{type(error).__name__}: {error}"


class Port(Protocol):
    """What the transport needs of a pyserial port."""

    timeout: float | None

    @property
    def in_waiting(self) -> int: ...
    @property
    def is_open(self) -> bool: ...
    def read(self, size: int = 1, /) -> bytes: ...
    def write(self, data: bytes, /) -> int | None: ...
    def open(self) -> None: ...
    def close(self) -> None: ...


class Transport:
    """One serial line. port: open, with a write time-out; clock: the one its reads block by.

    who: the instrument at its other end, for what is told of it. heard_s: when anything at all came from there last,
    on the clock; None: never. heard: the last bytes of it; lines: how many had their terminator.
    """

    def __init__(self, port: Port, clock: Clock, who: str = "") -> None:
        self.port = port
        self.clock = clock
        self.who = who
        self.stale_bytes = 0
        self.heard_s: float | None = None
        self.heard, self.lines = b"", 0
        self._received = b""
        self._asked, self._asked_s = b"", 0.0  # what was sent last, and when

    def send(self, data: bytes) -> None:
        """Throw away what came uncalled, then write. TimedOut where the line is stuck, Disconnected."""
        try:
            if self._received or self.port.in_waiting:
                self.drain()
            self.port.write(data)
        except GONE as error:
            raise self._meaning(error) from error
        self._asked, self._asked_s = data, self.clock.now_s()

    def receive_line(self, terminator: bytes, deadline_s: float) -> bytes:
        """The next line without its terminator. TimedOut at `deadline_s`, Corrupt where a line has no end."""
        received = self._received
        try:
            while True:
                end = received.find(terminator)
                if end >= 0:
                    self._received = received[end + len(terminator) :]
                    self._hear(received)
                    self.lines += 1
                    return received[:end]
                if len(received) > LONGEST_LINE:
                    self._received = b""
                    self._hear(received)
                    raise Corrupt(self.told(f"{len(received)} bytes without a terminator"))
                remaining_s = deadline_s - self.clock.now_s()
                if remaining_s < SHORTEST_WAIT_S:
                    self._received = received
                    self._hear(received)
                    raise TimedOut(self._gave_up(len(received), deadline_s))
                port = self.port
                port.timeout = remaining_s
                received += port.read(1)
                waiting = port.in_waiting
                if waiting:
                    received += port.read(waiting)
        except GONE as error:
            self._received = b""
            raise self._meaning(error) from error

    @property
    def has_more(self) -> bool:
        """Whether bytes are there that no question has asked for."""
        try:
            return bool(self._received or self.port.in_waiting)
        except GONE as error:
            raise self._meaning(error) from error

    def drain(self) -> bytes:
        """Throw away what has arrived by now, and return it."""
        stale = self._received
        self._received = b""
        try:
            waiting = self.port.in_waiting
            if waiting:
                self.port.timeout = 0
                stale += self.port.read(waiting)
        except GONE as error:
            raise self._meaning(error) from error
        self.stale_bytes += len(stale)
        self._hear(stale)
        return stale

    def _hear(self, data: bytes) -> None:
        if data:
            self.heard_s, self.heard = self.clock.now_s(), data[-LAST_HEARD:]

    def reopen(self) -> None:
        """Close and open again, for a device that was gone; Disconnected where it still is."""
        self._received = b""
        self.close()
        try:
            self.port.open()
        except GONE as error:
            raise Disconnected(self.told(f"cannot be opened: {in_words(error)}")) from error

    def close(self) -> None:
        """Let go of the port; never raises."""
        with contextlib.suppress(*GONE):
            self.port.close()

    def told(self, text: str) -> str:
        """What is wrong, with the instrument in front of it."""
        return f"{self.who}: {text}" if self.who else text

    def _gave_up(self, received: int, deadline_s: float) -> str:
        question = self._asked.decode("latin-1").strip()
        part = f" but {received} bytes of one" if received else ""
        return self.told(f"no answer{part} to {question!r}; expected it within {deadline_s - self._asked_s:.2g} s")

    def _meaning(self, error: BaseException) -> InstrumentError:
        if isinstance(error, SerialTimeoutException):
            return TimedOut(self.told("the line does not take what is written"))
        return Disconnected(self.told(f"the port has gone: look at its cable and its supply ({in_words(error)})"))
