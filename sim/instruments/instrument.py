"""The seam: what an emulated instrument sees of the world (`Plant`), and what a port sees of it
(`Instrument`).

An emulator has no clock and does no I/O; time is a parameter, in seconds on whatever scale the caller keeps.
Whoever carries the bytes (an in-process serial port, a pseudo-terminal) calls `receive` with what the host
has written and `transmit` for what has reached the host by now. The physics runs inside `transmit`, through
`Plant.advance_to`, so that instruments which share a plant see one history.

A reply reaches the host in one piece, when its last byte has been sent, as USB adapters deliver it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol


class Plant(Protocol):
    """What an instrument sees of the simulated world. All times are seconds on one monotone scale."""

    @property
    def current_A(self) -> float:
        """Current through the Peltier element now, A; positive heats."""

    def advance_to(self, time_s: float) -> None:
        """Run physics and due events up to `time_s`; a time that has passed already is ignored."""

    def schedule(self, time_s: float, callback: Callable[[float], None]) -> None:
        """Call `callback(time_s)` when the plant has reached `time_s`; ties in order of call."""

    def set_current_A(self, current_A: float, /) -> None:
        """Current through the Peltier element from now on, A; positive heats."""

    def read_temperature_degC(self) -> float:
        """Thermometer's reading now, with its noise, degC; nan where the sensor is open."""

    def sink_temperature_degC(self) -> float:
        """Heat sink's temperature now, degC."""

    def read_resistance_ohm(self, test_current_A: float, /) -> float:
        """Film's resistance now as the ohmmeter's input sees it, with noise, ohm; inf where it is open."""

    def read_voltage_V(self) -> float:
        """Voltage at the meter's input now, of a detector, with its noise, V; 0 where there is none."""

    def set_test_current_A(self, test_current_A: float, /) -> None:
        """Ohmmeter's test current through the film from now on, A."""


class Instrument(Protocol):
    """An instrument at the far end of a serial line."""

    def receive(self, data: bytes, time_s: float) -> None:
        """Take bytes that the host has written at `time_s`; they arrive here a baud-rate time later."""

    def transmit(self, time_s: float) -> bytes:
        """Run the plant to `time_s` and return the bytes that have reached the host by then, each once."""

    def next_transmit_s(self) -> float | None:
        """When the next bytes are expected at the host, s; None where nothing is under way.

        It can turn out later (a meter that changes its range measures again), never earlier.
        """
