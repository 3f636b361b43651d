"""Bytes to an instrument and lines back, with one deadline for a whole answer; and silence, in words.

A line counts only with its terminator; bytes that trickle in do not extend the deadline; a read never returns part of a
line. Whatever a vanished device makes pyserial raise (SerialException, OSError, termios.error, TypeError) becomes
`Disconnected`. That an answer belongs to its question is proven by the protocols above.
"""

from __future__ import annotations

import contextlib
import os
from typing import Any, Protocol

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
PRINTABLE = {*range(0x20, 0x7F), *b"\r\n\t"}
STRANGE_SHARE = 0.25  # of bytes: a text that lost some on the wire has fewer
ENDS = {b"\r": "CR", b"\n": "LF", b";": "a semicolon", b"\x00": "NUL"}
FALLEN_SILENT_S = 1.0  # several questions in a row: one that is lost is asked again within a tenth of it


class Port(Protocol):
    """The part of a pyserial port that the transport uses."""

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
    """One serial line. port: open, with a write time-out; clock: by which its reads block.

    who: the instrument at its other end, for messages. heard_s: when anything at all came from there last, on the
    clock; None: never. heard: the last bytes of it; lines: how many had their terminator.
    """

    def __init__(self, port: Port, clock: Clock, who: str = "") -> None:
        self.port = port
        self.clock = clock
        self.who = who
        self.stale_bytes = 0
        self.heard_s: float | None = None
        self.heard, self.lines = b"", 0
        self._received = b""
        self._asked, self._asked_s = b"", 0.0  # the last message, and when it was sent

    def send(self, data: bytes) -> None:
        """Discard what came unasked, then write. TimedOut if the line is stuck, Disconnected."""
        try:
            if self._received or self.port.in_waiting:
                self.drain()
            self.port.write(data)
        except GONE as error:
            raise self._error(error) from error
        self._asked, self._asked_s = data, self.clock.now_s()

    def receive_line(self, terminator: bytes, deadline_s: float) -> bytes:
        """Return the next line without its terminator. TimedOut at `deadline_s`, Corrupt for a line without end."""
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
                    raise Corrupt(self.named(f"{len(received)} bytes without a terminator"))
                remaining_s = deadline_s - self.clock.now_s()
                if remaining_s < SHORTEST_WAIT_S:
                    self._received = received
                    self._hear(received)
                    raise TimedOut(self._silence(len(received), deadline_s))
                port = self.port
                port.timeout = remaining_s
                received += port.read(1)
                waiting = port.in_waiting
                if waiting:
                    received += port.read(waiting)
        except GONE as error:
            self._received = b""
            raise self._error(error) from error

    @property
    def has_more(self) -> bool:
        """Return True if bytes are there that no question has asked for."""
        try:
            return bool(self._received or self.port.in_waiting)
        except GONE as error:
            raise self._error(error) from error

    def drain(self) -> bytes:
        """Discard what has arrived by now, and return it."""
        stale = self._received
        self._received = b""
        try:
            waiting = self.port.in_waiting
            if waiting:
                self.port.timeout = 0
                stale += self.port.read(waiting)
        except GONE as error:
            raise self._error(error) from error
        self.stale_bytes += len(stale)
        self._hear(stale)
        return stale

    def _hear(self, data: bytes) -> None:
        if data:
            self.heard_s, self.heard = self.clock.now_s(), data[-LAST_HEARD:]

    def reopen(self) -> None:
        """Close and open again, for a device that was gone; Disconnected if it still is."""
        self._received = b""
        self.close()
        try:
            self.port.open()
        except GONE as error:
            raise Disconnected(self.named(f"cannot be opened: {error_in_words(error)}")) from error

    def close(self) -> None:
        """Let go of the port; never raises."""
        with contextlib.suppress(*GONE):
            self.port.close()

    def named(self, text: str) -> str:
        """Return a message with the instrument in front of it."""
        return f"{self.who}: {text}" if self.who else text

    def _silence(self, received: int, deadline_s: float) -> str:
        question = self._asked.decode("latin-1").strip()
        part = f" but {received} bytes of one" if received else ""
        return self.named(f"no answer{part} to {question!r}; expected it within {deadline_s - self._asked_s:.2g} s")

    def _error(self, error: BaseException) -> InstrumentError:
        if isinstance(error, SerialTimeoutException):
            return TimedOut(self.named("the line takes no bytes"))
        return Disconnected(self.named(f"the port is gone: check its cable and its supply ({error_in_words(error)})"))


def error_in_words(error: BaseException) -> str:
    """Return the system's words for what a port raised if it has a number, which pyserial repeats around them."""
    number = getattr(error, "errno", None)
    if number:
        return os.strerror(number)
    if isinstance(error, TypeError):  # pyserial reads from a descriptor that it has closed
        return "it was closed"
    return str(error) if isinstance(error, SerialException) else f"{type(error).__name__}: {error}"


# ---- silence, in words ------------------------------------------------------------------------------


def nobody_answers(instrument: Any, port: str, role: str, driver: str, asked: str) -> str | None:
    """Return the message for a port at which nobody answers; None if whole lines of text came.

    A user-defined driver may have no transport: None. role: "controller" or "meter"; asked: what for, in words.
    """
    transport = getattr(instrument, "transport", None)
    if transport is None or not hasattr(transport, "heard"):
        return None
    who = f"the {role} ({driver})"
    asked = f"was asked {asked}{_line_in_words(transport.port)}"
    if transport.heard_s is not None:
        came = not_understood(transport.heard, transport.lines)
        check = f"Check bench.{role}: driver, baud, options, and the instrument's menu of its interface"
        return f"{port}: {who} {asked}, and {came}. {check}" if came else None
    return (
        f"{port}: nobody answers there; {who} {asked}. Check whether it is switched on and plugged in, whether this is "
        f"its port (`peltier ports --ask`), and bench.{role}: driver, baud, options"
    )


def fallen_silent(instrument: Any, now_s: float) -> str:
    """Return how long nothing has come from an instrument that answered before, to put behind another message.

    Empty if something came lately, and for a user-defined driver without a transport.
    """
    heard_s = getattr(getattr(instrument, "transport", None), "heard_s", None)
    if heard_s is None or now_s - heard_s < FALLEN_SILENT_S:
        return ""
    return f"; nothing has come from it for {now_s - heard_s:.1f} s: check its supply and its cable"


def _line_in_words(port: Any) -> str:
    """Return a port's settings, as in ", at 9600 baud, 8N1"; nothing for a port that has none."""
    settings = [getattr(port, name, None) for name in ("baudrate", "bytesize", "parity", "stopbits")]
    if None in settings or "://" in str(getattr(port, "port", "")):
        return ""
    baudrate, bytesize, parity, stopbits = settings
    return f", at {baudrate} baud, {bytesize}{parity}{stopbits:g}"


def not_understood(heard: bytes, lines: int) -> str | None:
    """Return why the bytes from a line are no answer: no text, or no end that is known; None if they may be one.

    heard: its last bytes; lines: how many had the end that an answer has.
    """
    strange = sum(byte not in PRINTABLE for byte in heard)
    if strange > STRANGE_SHARE * len(heard):
        return f"the bytes are no text, as with another baud rate or parity: {heard!r}"
    if lines or not heard:
        return None
    end = ENDS.get(heard[-1:]) if heard[-2:] != b"\r\n" else "CR LF"
    ends = f"they end in {end}" if end else "they have no end at all"
    return f"bytes came without the end that its answers have; {ends} (its terminator): {heard!r}"
