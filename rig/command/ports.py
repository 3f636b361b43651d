"""peltier ports: the serial ports that are there, what is attached, and whether another process holds them.

peltier ports                          what the computer knows of each port, and who holds it; nothing is sent
peltier ports --ask [PORT ...]         and which of the instruments answers there: a harmless question in each
                                       protocol, at each one's factory line settings, until one is answered; at a
                                       silent port that takes half a minute, and each question is shown
"""

from __future__ import annotations

import argparse
import sys
from typing import Any

from rig.command.record_arguments import add_json_argument
from rig.command.terminal import Terminal


def arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("ports", nargs="*", metavar="PORT", help="these only, such as /dev/ttyUSB0 or socket://host:1")
    parser.add_argument("--ask", action="store_true", help="ask who answers")
    add_json_argument(parser)


def main(options: argparse.Namespace) -> int:
    from serial.tools.list_ports import comports

    from rig.ports.open import holder

    terminal = Terminal(options.json)
    known = {port.device: port for port in sorted(comports())}
    found = []
    for name in options.ports or known:
        port = known.get(name)
        process, command = holder(name)
        held = f"held by process {process} {command}".strip() if process is not None else "free"
        entry: dict[str, Any] = {
            "port": name,
            "description": port.description if port is not None else None,
            "serial_number": port.serial_number if port is not None else None,
            "held_by": process,
        }
        text = f"{port.description}  {port.serial_number or ''}" if port is not None else "not listed"
        terminal.print(f"{name:<20} {text}  {held}")
        if options.ask and process is None:
            entry |= _asked(name, terminal)
        found.append(entry)
    if not found:
        terminal.print("no serial port is there (a pseudo-terminal or socket:// is not listed)")
    terminal.write_json({"format": "peltier-ports/1", "ports": found})
    return 0


def _asked(port: str, terminal: Terminal) -> dict[str, Any]:
    """Ask who answers at a port, by the driver that understands it."""
    from rig.core.clock import RealClock
    from rig.core.errors import RigError
    from rig.core.streams import TerminalLine
    from rig.drivers.registry import tries

    line = TerminalLine(sys.stderr)
    came: dict[str, list[str]] = {}
    try:
        for tried in tries(port, RealClock(), lambda text: line.show(f"{'':<20} {text}")):
            line.clear()
            if tried.identity is not None:
                terminal.print(f'{"":<20} {tried.identity}: driver = "{tried.driver}"')
                return {"driver": tried.driver, "instrument": str(tried.identity)}
            if tried.came is not None:
                came.setdefault(tried.came, []).append(tried.driver)
    except RigError as error:
        line.clear()
        terminal.print(f"{'':<20} {error}")
        return {"driver": None, "error": str(error)}
    for text, drivers in came.items():
        terminal.print(f"{'':<20} {text}, asked as {', '.join(dict.fromkeys(drivers))}")
    said = "somebody answers, and is not understood" if came else "nobody answers"
    terminal.print(f"{'':<20} {said} (other line settings? see docs/instruments.md)")
    return {"driver": None, **({"came": list(came)} if came else {})}
