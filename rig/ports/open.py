"""Open a port with the settings its instrument needs, alone; say who has it otherwise."""

from __future__ import annotations

import contextlib
import errno
import os
from dataclasses import dataclass, replace
from pathlib import Path

import serial

import rig.ports.protocol_sim  # noqa: F401 - makes sim:// and visa:// known to pyserial
from rig.core.errors import Disconnected, PortHeld
from rig.core.file_writing import command_of
from rig.ports.transport import GONE

WRITE_TIMEOUT_S = 1.0  # a message is a few bytes: a port that takes none for that long is gone
STILL_TRYING = "still-off-trial"  # name of a process that goes on after an output was not confirmed off (15 characters)
LOCKED = {errno.EAGAIN, errno.EWOULDBLOCK, errno.EBUSY}


@dataclass(frozen=True, slots=True)
class LineSettings:
    """Line settings: baudrate, 1/s; bytesize, bits; parity "N", "E" or "O"; stopbits 1, 1.5 or 2."""

    baudrate: int = 9600
    bytesize: int = 8
    parity: str = "N"
    stopbits: float = 1
    xonxoff: bool = False

    @property
    def byte_s(self) -> float:
        """Return the time of one character on the wire, s: its start, data, parity and stop bits."""
        return (1 + self.bytesize + (self.parity != "N") + self.stopbits) / self.baudrate

    def framed(self, framing: str) -> LineSettings:
        """Return the same with another framing, such as "7E2" or "8N1"; ValueError if it is none."""
        if len(framing) != 3 or framing[0] not in "78" or framing[1] not in "NEO" or framing[2] not in "12":
            raise ValueError(f"framing {framing!r}: 7 or 8, N, E or O, 1 or 2 is expected, as in '8N1'")
        return replace(self, bytesize=int(framing[0]), parity=framing[1], stopbits=int(framing[2]))


def open_port(port: str, settings: LineSettings) -> serial.SerialBase:
    """Open whatever pyserial opens (/dev/ttyUSB0, COM3, socket://host:port, sim://NAME), exclusively.

    PortHeld if another process has it, Disconnected if it is not there.
    """
    settings = settings_at(port, settings)
    try:
        opened: serial.SerialBase = serial.serial_for_url(
            port,
            baudrate=settings.baudrate,
            bytesize=settings.bytesize,
            parity=settings.parity,
            stopbits=settings.stopbits,
            xonxoff=settings.xonxoff,
            timeout=0,
            write_timeout=WRITE_TIMEOUT_S,
            exclusive=True,
        )
    except GONE as error:
        if _is_lock(error):
            raise PortHeld(port, *holder(port)) from error
        number = getattr(error, "errno", None)
        why = os.strerror(number) if number and not port.startswith("sim://") else str(error)
        raise Disconnected(f"{port}: cannot be opened: {why} (`peltier ports` lists what is there)") from error
    except ValueError as error:  # an unknown scheme, a setting that the handler does not know
        raise Disconnected(f"{port}: {error}") from error
    return opened


def settings_at(port: str, settings: LineSettings) -> LineSettings:
    """Return the settings that can be set at a port.

    Linux refuses parity and seven bits at a pseudo-terminal (EINVAL), such as `peltier emulate` serves; characters pass
    there unchanged.
    """
    if os.path.realpath(port).startswith("/dev/pts/"):
        return replace(settings, bytesize=8, parity="N")
    return settings


def _is_lock(error: BaseException) -> bool:
    if getattr(error, "errno", None) in LOCKED:
        return True
    text = str(error)
    return "lock port" in text or "PermissionError(13, 'Access is denied" in text  # the latter on Windows


def holder(port: str) -> tuple[int | None, str]:
    """Return process number and command line of the process that has `port` locked; (None, "") if it is unknown.

    Linux only: /proc shows who has the device open, and which of those descriptors carries the lock. Other users'
    processes do not show theirs. The process at the far end of a pseudo-terminal, such as `peltier emulate`, does not
    hold it.
    """
    if port.startswith("sim://"):
        return os.getpid(), "this process"
    found = _have_open(port)
    process = next((process for process, locked in found if locked), None)
    if process is None:
        process = next((process for process, _ in found if process != os.getpid()), None)
    return (None, "") if process is None else (process, _command(process))


def open_elsewhere(port: str) -> list[tuple[int, str]]:
    """Return process number and command line of each other process that has `port` open without a lock.

    Many programs open a port like that; they can command the instrument, or take our answers. Linux only, as `holder`.
    """
    found = [] if port.startswith("sim://") else _have_open(port)
    return [(process, _command(process)) for process, locked in found if not locked and process != os.getpid()]


def _have_open(port: str) -> list[tuple[int, bool]]:
    """Return the processes that have a device open, each with whether it has the lock on it."""
    try:
        device = os.path.realpath(port)
        processes = [int(entry) for entry in os.listdir("/proc") if entry.isdigit()]
    except OSError:
        return []
    found: dict[int, bool] = {}
    for process in processes:
        with contextlib.suppress(OSError):  # gone meanwhile, or not ours to see
            for descriptor in os.listdir(f"/proc/{process}/fd"):
                if os.path.realpath(f"/proc/{process}/fd/{descriptor}") == device:
                    locked = "FLOCK" in Path(f"/proc/{process}/fdinfo/{descriptor}").read_text()
                    found[process] = found.get(process, False) or locked
    return [(process, locked) for process, locked in found.items() if locked or not _is_far_end(process, device)]


def is_still_trying(process: int) -> bool:
    """Return True for a process that still tries to switch an output off (`rig.guard.takeover`)."""
    with contextlib.suppress(OSError):
        return Path(f"/proc/{process}/comm").read_text().strip() == STILL_TRYING
    return False


def _is_far_end(process: int, device: str) -> bool:
    """Return True if a process serves the pseudo-terminal `device`: it has the master of that number."""
    directory, _, number = device.rpartition("/")
    if directory != "/dev/pts":
        return False
    with contextlib.suppress(OSError):
        for descriptor in os.listdir(f"/proc/{process}/fd"):
            if os.path.realpath(f"/proc/{process}/fd/{descriptor}").endswith("ptmx"):
                fields = Path(f"/proc/{process}/fdinfo/{descriptor}").read_text().split()
                if "tty-index:" in fields and fields[fields.index("tty-index:") + 1] == number:
                    return True
    return False


def _command(process: int) -> str:
    if is_still_trying(process):
        return "still trying to switch the output off; `peltier off CONFIG` takes over"
    return command_of(process)
