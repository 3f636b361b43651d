"""Which simulated instrument answers at `sim://NAME`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import serial

from rig.core.clock import Clock
from sim.instruments.instrument import Instrument

if __package__ not in serial.protocol_handler_packages:  # "rig.ports", where protocol_sim is
    serial.protocol_handler_packages.append(__package__)


@dataclass(slots=True)
class Line:
    """An instrument with the clock by which its port blocks, and the port that holds it exclusively."""

    instrument: Instrument
    clock: Clock
    holder: Any = None


_lines: dict[str, Line] = {}


def register(name: str, instrument: Instrument, clock: Clock) -> str:
    """Make `instrument` answer at `sim://name`; returns that address. A taken name is a ValueError."""
    if name in _lines:
        raise ValueError(f"sim://{name} is registered already")
    _lines[name] = Line(instrument, clock)
    return f"sim://{name}"


def unregister(name: str) -> None:
    """Pull the plug; ports that are open find nobody from now on."""
    _lines.pop(name, None)


def look_up(name: str) -> Line | None:
    """What answers at `sim://name`."""
    return _lines.get(name)
