"""peltier off [CONFIG]: the output off, with a daemon or without.

Where a daemon runs it is told to stop (of CONFIG's ports, or every one). Where none does, the controller that CONFIG
names is opened and commanded off. Exit status 11 where that is not confirmed, 75 where another process holds the port.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

from rig.command.stop import NOT_CONFIRMED, stopped
from rig.daemon.asking import NONE_RUNS, json_argument, report, teller
from rig.daemon.client import Client, NoDaemon, daemons
from rig.faults import fault

PATIENCE_S = 5.0


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("config", type=Path, nargs="?", help="configuration that names the controller (TOML)")
    json_argument(parser)


def main(options: argparse.Namespace) -> int:
    clients = daemons()
    if options.config is None:
        if not clients:
            raise fault("peltier off", "", f"{NONE_RUNS}; expected CONFIG, to switch its controller off")
        return max(stopped(client, "peltier off", options.json) for client in clients)
    driver, port, driver_options = _controller(options.config)
    holders = [client for client in clients if _holds(client, port)]
    for client in clients:
        if client not in holders:
            client.close()
    if holders:
        return max(stopped(client, "peltier off", options.json) for client in holders)
    if port.startswith("sim://"):
        print(f"{port}: simulated, and no daemon holds it: nothing is on", file=teller(options.json))
        return 0
    return _switched_off(driver, port, driver_options, options.json)


def _controller(path: Path) -> tuple[str, str, dict[str, object]]:
    """Driver, port and options, without the schema, which takes longer to load than the rest."""
    from rig.files.toml_text import read_toml

    try:
        table = read_toml(path)["bench"]["controller"]
        driver, port = table["driver"], table["port"]
        more = dict(table.get("options", {}))
    except (KeyError, TypeError, ValueError, AttributeError):
        raise fault(path, "bench.controller", "expected driver and port") from None
    if not (isinstance(driver, str) and isinstance(port, str)):
        raise fault(path, "bench.controller", "expected driver and port as text")
    if "baud" in table:
        more["baud"] = table["baud"]
    return driver, port, more


def _holds(client: Client, port: str) -> bool:
    try:
        ports = client.ask("who").get("ports", [])
    except NoDaemon:
        return False
    return any(port == held or os.path.realpath(port) == os.path.realpath(held) for held in ports)


def _switched_off(driver: str, port: str, options: dict[str, object], target: str | None) -> int:
    """Open the port and command the output off. Raises Faults, PortHeld."""
    import time

    from rig.clock import RealClock
    from rig.drivers.registry import CONTROLLERS, open_controller
    from rig.errors import PortHeld, RigError

    if driver not in CONTROLLERS:
        raise fault("bench.controller.driver", repr(driver), f"expected one of {', '.join(CONTROLLERS)}")
    begin, problem = time.monotonic(), ""
    while time.monotonic() - begin < PATIENCE_S:
        try:
            controller = open_controller(driver, port, RealClock(), **options)
        except PortHeld:
            raise
        except ValueError as error:
            raise fault("bench.controller.options", "", str(error)) from None
        except RigError as error:
            problem = str(error)
        else:
            try:
                if controller.off():
                    took_s = time.monotonic() - begin
                    report(target, {"off": True, "confirmed": True, "took_s": took_s})
                    text = f"{port}: output off, confirmed by the controller in {1e3 * took_s:.0f} ms"
                    print(text, file=teller(target), flush=True)
                    return 0
                problem = f"{port}: the controller does not confirm it"
            finally:
                controller.close()
        time.sleep(0.05)
    report(target, {"off": False, "confirmed": False, "took_s": time.monotonic() - begin})
    print(f"peltier off: OUTPUT NOT CONFIRMED OFF: {problem}. Switch the controller off by hand.", file=sys.stderr)
    return NOT_CONFIRMED
