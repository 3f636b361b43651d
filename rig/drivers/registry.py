"""Drivers by the name that a configuration gives them; only the one that is asked for is imported."""

from __future__ import annotations

from importlib import import_module
from typing import Any, cast

from rig.clock import Clock
from rig.drivers.controller import TemperatureController
from rig.drivers.meter import ResistanceMeter
from rig.ports.open import LineSettings, open_port
from rig.ports.transport import Port, Transport

# name -> module in rig.drivers, class
CONTROLLERS = {"meerstetter": ("meerstetter", "MeerstetterController")}
METERS = {"keithley2000": ("keithley2000", "Keithley2000Meter")}


def open_controller(name: str, port: str, clock: Clock, **options: Any) -> TemperatureController:
    """The temperature controller `name` at `port`; options go to the driver. An unknown name is a ValueError.

    PortHeld, Disconnected. Nothing is sent yet.
    """
    return cast(TemperatureController, _open(CONTROLLERS, "controller", name, port, clock, options))


def open_meter(name: str, port: str, clock: Clock, **options: Any) -> ResistanceMeter:
    """The ohmmeter `name` at `port`; otherwise as `open_controller`."""
    return cast(ResistanceMeter, _open(METERS, "meter", name, port, clock, options))


def _open(
    drivers: dict[str, tuple[str, str]],
    role: str,
    name: str,
    port: str,
    clock: Clock,
    options: dict[str, Any],
) -> Any:
    if name not in drivers:
        raise ValueError(f"{role} {name!r} is not known; there are {', '.join(sorted(drivers))}")
    module, kind = drivers[name]
    driver = getattr(import_module(f"rig.drivers.{module}"), kind)
    line: LineSettings = driver.LINE
    return driver(Transport(cast(Port, open_port(port, line)), clock), **options)
