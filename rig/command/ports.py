"""peltier ports: the serial ports that are there, what is attached, and whether another process holds them."""

from __future__ import annotations

import argparse

from rig.command.record_arguments import add_json_argument
from rig.command.say import Voice


def arguments(parser: argparse.ArgumentParser) -> None:
    add_json_argument(parser)


def main(options: argparse.Namespace) -> int:
    from serial.tools.list_ports import comports

    from rig.ports.open import holder

    voice = Voice(options.json)
    found = []
    for port in sorted(comports()):
        process, command = holder(port.device)
        held = f"held by process {process} {command}".strip() if process is not None else "free"
        voice.say(f"{port.device:<20} {port.description}  {port.serial_number or ''}  {held}")
        found.append(
            {
                "port": port.device,
                "description": port.description,
                "serial_number": port.serial_number,
                "held_by": process,
            }
        )
    if not found:
        voice.say("no serial port is there (a pseudo-terminal or socket:// is not listed)")
    voice.report({"format": "peltier-ports/1", "ports": found})
    return 0
