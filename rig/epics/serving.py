"""`peltier epics` put together: records, access security, the daemon's stream of events. Until a signal."""

from __future__ import annotations

import contextlib
import ctypes
import ipaddress
import os
import socket
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, MutableMapping
from pathlib import Path
from typing import Any, NoReturn

from rig.config.configuration import ConfigurationFile
from rig.config.tables import EpicsTable
from rig.core.errors import RigError
from rig.core.faults import fault
from rig.core.requirements import to_install
from rig.daemon.client import Client, NoDaemon, Refusal
from rig.safety.signals import SignalStop

EVERYWHERE = "0.0.0.0"
SILENCE_S = 7.5  # the daemon sends its state at least every 5 s
AGAIN_S = 1.0
MISSING = f"needs softioc, which is not installed: {to_install('epics')}"
Take = Callable[[str, dict[str, Any]], None]
Place = Callable[[], Path]  # returns the daemon's present socket


def serve(file: ConfigurationFile, place: Place, report: Callable[[str], None]) -> NoReturn:
    """Serve the bench whose daemon listens, or will listen, at `place`, until a signal.

    Raises Stopped then; Faults if softioc is missing; RigError if a port is taken, or EPICS does not accept the access
    list.
    """
    table, serving = file.content.epics, file.content.serve
    for port in (table.ca_port, table.pva_port):
        _check_free(table.address, port)
    _listen(table, os.environ)
    try:
        from softioc import builder

        from rig.epics.records import Commands, Published, StopRecord, access_list
    except ImportError:
        raise fault("peltier epics", "", MISSING) from None
    prefix = table.prefix or serving.name
    builder.SetDeviceName(prefix)
    published = Published(file.content.limits.temperature_degC, serving.idle_period_s)
    StopRecord(place)
    commands = Commands(place, published) if table.write else None
    takes = [published.take, *([commands.take] if commands is not None else [])]
    with SignalStop() as signals:
        signals.shield()  # EPICS is begun as a whole, or not at all
        _begin(access_list(table))
        write = "for those of the list" if table.write else "off"
        at = f"ca {table.address}:{table.ca_port} pva {table.address}:{table.pva_port}"
        report(f"epics {prefix} {at} write {write}")
        threading.Thread(target=_follow, args=(place, takes, published.lost), name="events", daemon=True).start()
        signals.expose()
        while True:  # Python runs signal handlers between two steps of its main thread
            time.sleep(0.5)


def _listen(table: EpicsTable, environment: MutableMapping[str, str]) -> None:
    """Set EPICS' variables for where the server listens and announces itself."""
    environment["EPICS_CAS_SERVER_PORT"] = str(table.ca_port)
    environment["EPICS_PVAS_SERVER_PORT"] = str(table.pva_port)
    environment["EPICS_PVAS_BROADCAST_PORT"] = str(table.pva_port + 1)
    if table.address == EVERYWHERE:
        return
    loopback = ipaddress.IPv4Address(table.address).is_loopback
    for server in ("CAS", "PVAS"):
        environment[f"EPICS_{server}_INTF_ADDR_LIST"] = table.address
        if loopback:  # no other computer can reach it
            environment[f"EPICS_{server}_AUTO_BEACON_ADDR_LIST"] = "NO"
            environment[f"EPICS_{server}_BEACON_ADDR_LIST"] = table.address


def _check_free(address: str, port: int) -> None:
    """Raise RigError if another server listens: EPICS would take another port, and clients would find either one."""
    try:
        with socket.create_server((address, port)):
            pass
    except OSError as error:
        reason = os.strerror(error.errno) if error.errno else str(error)
        raise RigError(f"{address}:{port} (epics.ca_port, epics.pva_port): {reason.lower()}") from None


def _begin(access: str) -> None:
    """Start EPICS with an access list, its own lines on stderr. Raises RigError if the list is not in force."""
    from softioc import builder, imports, softioc

    from rig.epics.records import InThreads

    builder.LoadDatabase()
    with tempfile.NamedTemporaryFile("w", suffix=".acf") as kept, _stdout_to_stderr():
        kept.write(access)
        kept.flush()
        ctypes.c_int.in_dll(imports.Com, "asCheckClientIP").value = 1  # hosts are addresses, not what clients say
        imports.dbCore.asSetFilename(kept.name.encode())
        softioc.iocInit(InThreads())
    if not ctypes.c_int.in_dll(imports.Com, "asActive").value:
        raise RigError("EPICS did not accept the access list, so that anybody could write; see the lines above")


def _follow(place: Place, takes: list[Take], lost: Callable[[], None]) -> None:
    """Pass on the daemon's events for ever; while it is away, mark the records and try again."""
    while True:
        try:
            with Client(place()) as client:
                for message in client.events(SILENCE_S):
                    for take in takes:
                        take(message["event"], message["data"])
        except (NoDaemon, Refusal):
            lost()
        time.sleep(AGAIN_S)


@contextlib.contextmanager
def _stdout_to_stderr() -> Iterator[None]:
    """Redirect EPICS' greeting on stdout, which belongs to the caller, to stderr."""
    sys.stdout.flush()
    kept = os.dup(1)
    os.dup2(2, 1)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
