"""An EPICS server beside a daemon, for tests: a process of its own on ports of its own, and clients of another make."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tests.peltier import begun
from tests.rig.daemon.benches import LONGEST_S, until

ROOT = Path(__file__).resolve().parents[3]
PREFIX = "RIG"


def free_ports() -> int:
    """The first of two TCP and UDP ports of the loopback that are free."""
    while True:
        with socket.socket() as first, socket.socket() as second, contextlib.suppress(OSError, OverflowError):
            first.bind(("127.0.0.1", 0))
            port = int(first.getsockname()[1])
            second.bind(("127.0.0.1", port + 1))
            with socket.socket(type=socket.SOCK_DGRAM) as udp, socket.socket(type=socket.SOCK_DGRAM) as next_udp:
                udp.bind(("127.0.0.1", port))
                next_udp.bind(("127.0.0.1", port + 1))
                return port


def epics_table(more: str = "") -> tuple[str, int, int]:
    """[epics] with free ports; the port of Channel Access, and that of PV Access."""
    ca, pva = free_ports(), free_ports()
    return f'[epics]\nprefix = "{PREFIX}"\nca_port = {ca}\npva_port = {pva}\n{more}', ca, pva


@contextlib.contextmanager
def serving(path: Path, place: Path) -> Iterator[subprocess.Popen[str]]:
    """`peltier epics` of a configuration, asking the daemon at `place`, from its first line on."""
    environment = {**os.environ, "PELTIER_SOCKET": str(place), "PYTHONPATH": str(ROOT)}
    process = begun("epics", path, env=environment)
    try:
        assert process.stdout is not None
        assert process.stdout.readline().startswith(f"epics {PREFIX} ")
        yield process
    finally:
        process.terminate()
        process.wait(LONGEST_S)
        process.stdout.close()


class PvaClient:
    """p4p's client, which knows the server's port and no environment."""

    def __init__(self, pva_port: int) -> None:
        from p4p.client.thread import Context

        where = {"EPICS_PVA_ADDR_LIST": f"127.0.0.1:{pva_port + 1}", "EPICS_PVA_AUTO_ADDR_LIST": "NO"}
        self._context = Context("pva", conf={**where, "EPICS_PVA_BROADCAST_PORT": str(pva_port + 1)}, useenv=False)

    def get(self, name: str) -> Any:
        """A value with severity, status and timestamp."""
        return self._context.get(f"{PREFIX}:{name}", timeout=LONGEST_S)

    def text(self, name: str) -> str:
        """A text as it is (p4p's own says its time as well)."""
        return "".join(self.get(name))

    def put(self, name: str, value: Any) -> None:
        """Write, and wait until that was carried out. Raises p4p's RemoteError."""
        self._context.put(f"{PREFIX}:{name}", value, timeout=LONGEST_S, wait=True)

    def until(self, name: str, true: Any) -> Any:
        """Wait until a value is so."""
        return until(lambda: (lambda value: [value] if true(value) else None)(self.get(name)), name)[0]

    def close(self) -> None:
        """Let go."""
        self._context.close()


CA = """
import json, sys, epics
for line in sys.stdin:
    do = json.loads(line)
    pv = epics.PV(do["pv"])
    there = pv.wait_for_connection(do["wait_s"])
    fault = None
    if there and "value" in do:
        try:
            pv.put(do["value"], wait=True, timeout=do["wait_s"])
        except Exception as error:
            fault = f"{type(error).__name__}: {error}"
    value = pv.get() if there else None
    print(json.dumps({"there": there, "fault": fault, "value": value if isinstance(value, (int, float, str)) else None,
        "severity": pv.severity, "write": bool(there and pv.write_access)}), flush=True)
"""


class CaClient:
    """pyepics in a process of its own: its ports come from the environment, once a process."""

    def __init__(self, ca_port: int, name: str = "somebody") -> None:
        where = {"EPICS_CA_ADDR_LIST": f"127.0.0.1:{ca_port}", "EPICS_CA_AUTO_ADDR_LIST": "NO", "LOGNAME": name}
        where["EPICS_CA_REPEATER_PORT"] = str(free_ports())
        self._process = subprocess.Popen(
            [sys.executable, "-c", CA],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, **where},
        )

    def ask(self, pv: str, wait_s: float = LONGEST_S, **more: Any) -> dict[str, Any]:
        """Read, or with value=... write and read."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps({"pv": f"{PREFIX}:{pv}", "wait_s": wait_s, **more}) + "\n")
        self._process.stdin.flush()
        answer: dict[str, Any] = json.loads(self._process.stdout.readline())
        return answer

    def close(self) -> None:
        """End."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait(LONGEST_S)
        assert self._process.stdout is not None
        self._process.stdout.close()
