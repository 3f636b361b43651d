"""pyserial's handler of `visa://RESOURCE`: an instrument on GPIB, USB or the network, through PyVISA.

    visa://GPIB0::24::INSTR        visa://USB0::0x05E6::0x2450::04096331::INSTR        visa://TCPIP0::10.0.0.7::INSTR

pyserial finds this module by its name, `protocol_` and the scheme, so that whatever opens a port opens these too. It
needs the extra `visa` (PyVISA, and PyVISA-py where no maker's VISA library is installed; `PYVISA_LIBRARY` chooses).

On these buses a message has an end of its own and an instrument speaks when it is asked: lines go out one by one with
the bus's END behind the last character, a message that comes in is a line even if it has no line feed, and the
character that aborts (^X, ^C) becomes the bus's device clear. So it is for instruments whose lines end in LF. Serial
lines and sockets under a VISA name are streams: bytes go as they are, a message ends with LF.

The lock is VISA's, exclusive; PyVISA-py has none, and there another process is not kept out.
"""

from __future__ import annotations

import contextlib
import errno
import functools
import os
import re
from typing import Any

from serial.serialutil import PortNotOpenError, SerialBase, SerialException, SerialTimeoutException

from rig.core.requirements import to_install

OPEN_TIMEOUT_MS = 2000  # as VISA counts; an instrument on the bus locks within milliseconds
EVER_MS = 3_600_000.0  # for a port without a time-out
ABORTS = re.compile(rb"[\x03\x18]")
TIMED_OUT, NO_SUCH_OPERATION = "VI_ERROR_TMO", "VI_ERROR_NSUP_OPER"
HELD = ("VI_ERROR_RSRC_BUSY", "VI_ERROR_RSRC_LOCKED")
MISSING = f"PyVISA is not installed: {to_install('visa')}"


@functools.cache
def _resource_manager(manager: Any, library: str | None) -> Any:
    """Return PyVISA's resource manager for PYVISA_LIBRARY.

    To make one PyVISA asks the linker and a compiler for makers' libraries, 0.2 s, and a port is tried again and again.
    """
    return manager()


class Serial(SerialBase):
    """A port of VISA's. Line settings count for a serial line under a VISA name, and for nothing else."""

    _resource: Any = None
    _buffer = b""
    _is_stream = False

    def open(self) -> None:
        """Connect; SerialException if there is nothing, or another process has it."""
        if self.is_open:
            raise SerialException("Port is already open.")
        try:
            import pyvisa
            from pyvisa.constants import AccessModes, InterfaceType
        except ImportError:
            raise SerialException(MISSING) from None
        name = str(self.portstr).partition("://")[2]
        mode = AccessModes.exclusive_lock if self.exclusive else AccessModes.no_lock
        try:
            manager = _resource_manager(pyvisa.ResourceManager, os.environ.get("PYVISA_LIBRARY"))
            resource: Any = manager.open_resource(name, access_mode=mode, open_timeout=OPEN_TIMEOUT_MS)
            is_line = resource.interface_type == InterfaceType.asrl
        except Exception as error:  # a library that is missing is a ValueError or an OSError, and each has its own
            raise _as_pyserial(error, name) from error
        self._is_stream = is_line or resource.resource_class == "SOCKET"
        self._resource, self._buffer, self.is_open = resource, b"", True
        try:
            if self._is_stream:
                resource.read_termination = "\n"
            if is_line:
                self._reconfigure_port()
        except Exception as error:
            self.close()
            raise _as_pyserial(error, name) from error

    def close(self) -> None:
        """Let go; closing twice is fine."""
        resource, self._resource = self._resource, None
        self._buffer, self.is_open = b"", False
        if resource is not None:
            with contextlib.suppress(Exception):
                resource.close()

    def _reconfigure_port(self, force_update: bool = False) -> None:
        from pyvisa.constants import InterfaceType, Parity, StopBits

        resource = self._resource
        if resource is None or resource.interface_type != InterfaceType.asrl:
            return
        resource.baud_rate, resource.data_bits = self.baudrate, self.bytesize
        resource.parity = {"N": Parity.none, "E": Parity.even, "O": Parity.odd}[self.parity]
        resource.stop_bits = {1: StopBits.one, 1.5: StopBits.one_and_a_half, 2: StopBits.two}[self.stopbits]

    @property
    def timeout(self) -> float | None:
        """Return how long a read blocks, s; None for ever."""
        return self._timeout

    @timeout.setter
    def timeout(self, timeout: float | None) -> None:
        self._timeout = timeout

    @property
    def in_waiting(self) -> int:
        """Return how many bytes remain of the last message: there is no other, as no instrument speaks unasked."""
        self._require()
        return len(self._buffer)

    def read(self, size: int = 1, /) -> bytes:
        """Return up to `size` bytes of the next message; nothing if the time-out ends first."""
        resource = self._require()
        if not self._buffer and self._timeout != 0:
            resource.timeout = EVER_MS if self._timeout is None else max(1.0, 1e3 * self._timeout)
            self._buffer = self._message(resource)
        data, self._buffer = self._buffer[:size], self._buffer[size:]
        return data

    def _message(self, resource: Any) -> bytes:
        try:
            data = bytes(resource.read_raw())
        except Exception as error:
            translated = _as_pyserial(error)
            if isinstance(translated, SerialTimeoutException):
                return b""
            raise translated from error
        return data if self._is_stream or data.endswith(b"\n") else data + b"\n"

    def write(self, data: Any, /) -> int:
        """Hand over line by line, an abort as a device clear. SerialTimeoutException if it is stuck."""
        resource = self._require()
        data = bytes(data)
        resource.timeout = EVER_MS if self.write_timeout is None else max(1.0, 1e3 * self.write_timeout)
        try:
            if self._is_stream:
                resource.write_raw(data)
                return len(data)
            if ABORTS.search(data):
                self._clear(resource)
            for line in re.split(rb"[\r\n]+", ABORTS.split(data)[-1]):
                if line:
                    resource.write_raw(line + b"\n")
        except Exception as error:
            raise _as_pyserial(error) from error
        return len(data)

    def _clear(self, resource: Any) -> None:
        """Clear the device, if the bus has such a message."""
        try:
            resource.clear()
        except Exception as error:
            if not isinstance(error, NotImplementedError) and getattr(error, "abbreviation", "") != NO_SUCH_OPERATION:
                raise
        self._buffer = b""

    def reset_input_buffer(self) -> None:
        self._require()
        self._buffer = b""

    def _require(self) -> Any:
        if self._resource is None:
            raise PortNotOpenError()
        return self._resource

    def flush(self) -> None:
        """Do nothing: no byte is held back."""

    _update_rts_state = _update_dtr_state = _update_break_state = flush


def _as_pyserial(error: BaseException, name: str = "") -> SerialException:
    code, text = getattr(error, "abbreviation", ""), f"{name}: {error}" if name else str(error)
    if code == TIMED_OUT:
        return SerialTimeoutException(text)
    if code in HELD:
        return SerialException(errno.EBUSY, text)
    return SerialException(text)
