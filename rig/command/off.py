"""peltier off [CONFIG]: the output off, with a daemon or without.

Where daemons run, the one that holds CONFIG's controller stops (without CONFIG every one). Where none does, the
controller that CONFIG names is opened and commanded off. A simulated controller (sim://) has no identity: that of
CONFIG is held by the daemon that was started with this very file, and by no other. Exit status 11 where that is not
confirmed, 75 where another process holds the port. A process that still tries to switch the output off, after that was
not confirmed, is ended, and this one tries instead.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rig.command.stop import stop_all
from rig.core.faults import Faults, fault
from rig.core.outcome import NotConfirmedOff
from rig.daemon.client import (
    NONE_RUNS,
    Client,
    NoDaemon,
    Refusal,
    daemons,
    json_argument,
    text_stream,
    write_json,
)

if TYPE_CHECKING:
    from rig.core.errors import PortHeld
    from rig.drivers.controller import TemperatureController
    from rig.guard.takeover import Held

PATIENCE_S = 5.0  # for a port that cannot be opened
ENDS_S = 15.0  # all of it but the dead man's time: that patience, an imported driver, the off, a look
SIMULATED = "sim://"  # how the port of a simulated instrument begins
DEAD_MAN_S = 5.0  # where the configuration does not say (rig.config.configuration)


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("config", type=Path, nargs="?", help="configuration that names the controller (TOML)")
    json_argument(parser)


def main(options: argparse.Namespace) -> int:
    try:
        return _off(options)
    except Faults as faults:  # before anything was sent
        hand = "peltier off: nothing was sent, and the output may be on. Switch the controller off by hand."
        raise Faults([*faults.lines, hand]) from None


def _off(options: argparse.Namespace) -> int:
    """Stop the daemons, or open the controller. Raises Faults, PortHeld; then nothing was sent."""
    held = _controller(options.config) if options.config is not None else None
    clients = daemons()
    if held is None:
        if not clients:
            raise fault("peltier off", "", f"{NONE_RUNS}; expected CONFIG, to switch its controller off")
        return stop_all(clients, "peltier off", options.json)
    simulated = held.port.startswith(SIMULATED)
    holders = [c for c in clients if (_serves(c, options.config) if simulated else _holds(c, held.port))]
    others = [client for client in clients if client not in holders]
    for client in others:
        client.close()
    if holders:
        return stop_all(holders, "peltier off", options.json)
    if simulated:
        return _nothing_on(held.port, options.config, [client.path.stem for client in others], options.json)
    return _switched_off(held, options.json)


def _nothing_on(port: str, config: Path, others: list[str], target: str | None) -> int:
    """Report that nobody simulates this configuration's rig. others: daemons that run, of other configurations."""
    write_json(target, {"off": True, "confirmed": True, "took_s": 0.0})
    text = f"{port}: simulated, and no daemon serves {config}: nothing is on"
    if others:
        text += f"; left alone: {', '.join(others)} (`peltier stop --bench NAME` stops one)"
    print(text, file=text_stream(target), flush=True)
    return 0


def _controller(path: Path) -> Held:
    """Return what opens the controller, without the schema, which takes longer to load than the rest."""
    from rig.config.toml_file import read_toml
    from rig.drivers.registry import beside
    from rig.guard.takeover import Held

    try:
        table = read_toml(path)["bench"]["controller"]
        driver, port = table["driver"], table["port"]
        more = dict(table.get("options", {}))
    except (KeyError, TypeError, ValueError, AttributeError):
        raise fault(path, "bench.controller", "expected driver and port") from None
    if not (isinstance(driver, str) and isinstance(port, str)):
        raise fault(path, "bench.controller", "expected driver and port as text")
    driver = beside(driver, path.parent)
    if "baud" in table:
        more["baud"] = table["baud"]
    dead_man_s = table.get("dead_man_s", DEAD_MAN_S)
    return Held("controller", driver, port, more, float(dead_man_s) if isinstance(dead_man_s, int | float) else 0.0)


def _who(client: Client) -> dict[str, Any]:
    """Return a daemon's answer on itself; empty if it has none."""
    try:
        return dict(client.ask("GET", "/daemon"))
    except (NoDaemon, Refusal):
        return {}


def _serves(client: Client, config: Path) -> bool:
    """Return True if a daemon was started with this file."""
    served = _who(client).get("configuration")
    return isinstance(served, str) and os.path.realpath(served) == os.path.realpath(config)


def _holds(client: Client, port: str) -> bool:
    """Return True if a daemon holds this real port."""
    ports = _who(client).get("ports", [])
    return any(port == held or os.path.realpath(port) == os.path.realpath(held) for held in ports)


def _switched_off(held: Held, target: str | None) -> int:
    """Open the port and command the output off. Raises Faults, PortHeld."""
    import time

    from rig.daemon.systemd import Notifier
    from rig.guard.takeover import keep_trying
    from rig.ports.transport import nobody_answers
    from rig.safety.switching_off import off_confirmed, switch_off

    begin = time.monotonic()
    notifier = Notifier()
    notifier.ends(ENDS_S + held.dead_man_s)
    notifier.close()
    controller, problem, doubted = _opened(held)
    if controller is not None:
        try:
            verdict = switch_off(controller, held.dead_man_s)
        finally:
            controller.close()
        took_s = time.monotonic() - begin
        if verdict.confirmed and not doubted:
            write_json(target, {"off": True, "confirmed": True, "took_s": took_s})
            how = f": {verdict.text}" if verdict.text else ""
            text = off_confirmed(controller, f" in {1e3 * took_s:.0f} ms")
            print(f"{held.port}: {text}{how}", file=text_stream(target), flush=True)
            return 0
        silent = nobody_answers(controller, held.port, "controller", held.driver, "to switch its output off")
        problem = silent or f"{held.port}: {verdict.text}"
        if verdict.confirmed:
            problem = f"{held.port}: the controller says now that its output is off, but before it did not confirm that"
    write_json(target, {"off": False, "confirmed": False, "took_s": time.monotonic() - begin})
    print(f"peltier off: OUTPUT NOT CONFIRMED OFF: {problem}. Switch the controller off by hand.", file=sys.stderr)
    if controller is not None and not verdict.confirmed:
        keep_trying(held)
    return NotConfirmedOff.exit_status


def _opened(held: Held) -> tuple[TemperatureController | None, str, bool]:
    """Open the controller on its port; return it, or None and what stood in the way, and True if another process had to
    give up on it.

    Raises Faults, PortHeld.
    """
    import time

    from rig.core.clock import RealClock
    from rig.core.errors import PortHeld
    from rig.drivers.registry import controller_class, open_controller
    from rig.guard.takeover import end_trying

    try:
        controller_class(held.driver)
    except ValueError as error:
        raise fault("bench.controller.driver", "", str(error)) from None
    begin, problem, doubted = time.monotonic(), "", False
    while time.monotonic() - begin < PATIENCE_S:
        try:
            return open_controller(held.driver, held.port, RealClock(), **held.options), "", doubted
        except PortHeld as error:
            if not (end_trying(error.pid) or doubted):
                raise _still_held(error) from None
            doubted, problem = True, str(error)
        except ValueError as error:
            raise fault("bench.controller.options", "", str(error)) from None
        except Exception as error:  # a port that is not there; and a driver of the user's own may do anything
            problem = str(error)
        time.sleep(0.02)
    return None, problem, doubted


def _still_held(error: PortHeld) -> PortHeld:
    """Add what is known of the output then, and what to do."""
    end = "stopping that process" if error.pid is None else f"`kill {error.pid}`, or Ctrl-C where it runs,"
    error.add_note(
        "nothing was sent, and the output may be on: "
        f"{end} ends a `peltier run` or `calibrate` with its output off; of another program switch the controller off "
        "by hand"
    )
    return error
