"""Drivers by the name that a configuration gives them; only the one that is asked for is imported."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module
from inspect import signature
from typing import Any, cast

from rig.clock import Clock
from rig.drivers.controller import TemperatureController
from rig.drivers.meter import ResistanceMeter
from rig.ports.open import LineSettings, open_port
from rig.ports.transport import Port, Transport

# name -> module in rig.drivers, class
CONTROLLERS = {
    "meerstetter": ("meerstetter", "MeerstetterController"),
    "srs_ldc500": ("srs_ldc500", "SrsLdc500Controller"),
    "te_technology": ("te_technology", "TeTechnologyController"),
}
METERS = {
    "hp34401a": ("hp34401a", "Hp34401AMeter"),
    "keithley2000": ("keithley2000", "Keithley2000Meter"),
    "keithley2400": ("keithley2400", "Keithley2400Meter"),
}


def open_controller(name: str, port: str, clock: Clock, **options: Any) -> TemperatureController:
    """The temperature controller `name` at `port`.

    Of the options `baud` (1/s) and `framing` ("8N1") change the line's settings, from what the driver says; the others
    go to the driver. An unknown name, and an option that the driver does not have, is a ValueError; PortHeld,
    Disconnected. Nothing is sent yet.
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
    options = dict(options)
    baud, framing = options.pop("baud", None), options.pop("framing", None)
    known = set(signature(driver).parameters) - {"transport", "line"}
    if not options.keys() <= known:
        unknown = ", ".join(sorted(options.keys() - known))
        raise ValueError(
            f"{role} {name!r} has no option {unknown}; there are baud, framing, {', '.join(sorted(known))}"
        )
    line: LineSettings = driver.line_for(**options) if hasattr(driver, "line_for") else driver.LINE
    if baud is not None:
        if not (isinstance(baud, int) and baud > 0):
            raise ValueError(f"baud {baud!r}: a positive whole number is expected")
        line = replace(line, baudrate=baud)
    if framing is not None:
        line = line.framed(framing)
    opened = open_port(port, line)
    try:
        return driver(Transport(cast(Port, opened), clock), line=line, **options)
    except BaseException:
        opened.close()
        raise
