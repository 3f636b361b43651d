"""Simulated ports: `sim://NAME` is a serial port whose far end is an emulated instrument in this process.

pyserial finds this module by its name, `protocol_` and the scheme, through `protocol_handler_packages`. Anything that
takes a pyserial port can use it: our transport, PyMeasure's SerialAdapter, PyVISA-py (`ASRLsim://NAME::INSTR`). A read
that blocks sleeps on the clock registered with the instrument: in virtual time it jumps to the next byte.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import Any

import serial
from serial.serialutil import PortNotOpenError, SerialBase, SerialException

from rig.core.clock import Clock, RealClock
from sim.instruments.instrument import Instrument

if __package__ not in serial.protocol_handler_packages:  # "rig.ports", where this module and protocol_visa are
    serial.protocol_handler_packages.append(__package__)

LONGEST_SLEEP_S = 0.02  # in real time, so that cancel_read is noticed


@dataclass(slots=True)
class Line:
    """An instrument with the clock by which its port blocks, and the port that holds it exclusively."""

    instrument: Instrument
    clock: Clock
    holder: Any = None


_lines: dict[str, Line] = {}


def register(name: str, instrument: Instrument, clock: Clock) -> str:
    """Make `instrument` answer at `sim://name`; return that address. ValueError for a name that is taken."""
    if name in _lines:
        raise ValueError(f"sim://{name} is registered already")
    _lines[name] = Line(instrument, clock)
    return f"sim://{name}"


def unregister(name: str) -> None:
    """Pull the plug: open ports find no instrument from now on."""
    _lines.pop(name, None)


def look_up(name: str) -> Line | None:
    """Return the line of `sim://name`, if it is registered."""
    return _lines.get(name)


class Serial(SerialBase):
    """A simulated port. Line settings are kept but change nothing: the emulator has its own baud rate."""

    _line: Line | None = None
    _instrument: Instrument
    _clock: Clock
    _buffer = b""
    _cancelled = False

    def open(self) -> None:
        """Connect; SerialException if nothing is registered, or the port is held exclusively."""
        if self.is_open:
            raise SerialException("Port is already open.")
        url = str(self.portstr)
        line = look_up(url.partition("://")[2])
        if line is None:
            raise SerialException(2, f"could not open port {url}: no instrument is registered there")
        if self.exclusive:
            if line.holder is not None and line.holder.is_open:
                raise SerialException(11, f"Could not exclusively lock port {url}: it is open in this process")
            line.holder = self
        self._line, self._instrument, self._clock = line, line.instrument, line.clock
        self._buffer = b""
        self.is_open = True

    def close(self) -> None:
        """Disconnect; closing twice is fine."""
        if self._line is not None and self._line.holder is self:
            self._line.holder = None
        self._line = None
        self.is_open = False

    def _reconfigure_port(self, force_update: bool = False) -> None:
        pass

    def _require_line(self) -> None:
        if self._line is None:
            raise PortNotOpenError()
        if look_up(str(self.portstr).partition("://")[2]) is not self._line:
            raise SerialException(5, "device reports readiness to read but returned no data: it is gone")

    @property
    def in_waiting(self) -> int:
        """Return how many bytes can be read without blocking."""
        self._require_line()
        self._buffer += self._instrument.transmit(self._clock.now_s())
        return len(self._buffer)

    def read(self, size: int = 1, /) -> bytes:
        """Return up to `size` bytes, fewer if the time-out ends first; SerialException for ever in virtual time."""
        self._require_line()
        buffer = self._buffer
        if len(buffer) < size:
            buffer = self._wait_for(size)
        self._buffer = buffer[size:]
        return buffer[:size]

    def _wait_for(self, size: int) -> bytes:
        instrument, clock = self._instrument, self._clock
        now_s = clock.now_s()
        timeout_s = self.timeout
        deadline_s = inf if timeout_s is None else now_s + timeout_s
        real = isinstance(clock, RealClock)
        buffer = self._buffer
        while True:
            buffer += instrument.transmit(now_s)
            if len(buffer) >= size or now_s >= deadline_s or self._cancelled:
                self._cancelled = False
                return buffer
            next_s = instrument.next_transmit_s()
            wake_s = deadline_s if next_s is None or next_s > deadline_s else next_s
            if real:
                wake_s = min(wake_s, now_s + LONGEST_SLEEP_S)
                self._require_line()
            elif wake_s == inf:
                raise SerialException("nothing is under way, and the read has no time-out: it would block for ever")
            clock.sleep_until_s(wake_s)
            now_s = clock.now_s()

    def cancel_read(self) -> None:
        """Let a read that blocks in another thread return."""
        self._cancelled = True

    def write(self, data: Any, /) -> int:
        """Hand `data` to the instrument; it takes no time here, but time on the emulated wire."""
        self._require_line()
        data = bytes(data)
        self._instrument.receive(data, self._clock.now_s())
        return len(data)

    def reset_input_buffer(self) -> None:
        self._require_line()
        self._instrument.transmit(self._clock.now_s())
        self._buffer = b""

    def reset_output_buffer(self) -> None:
        """Do nothing: no byte is held back."""

    flush = _update_rts_state = _update_dtr_state = _update_break_state = reset_output_buffer
    out_waiting = 0
    cts = dsr = cd = True
    ri = False
