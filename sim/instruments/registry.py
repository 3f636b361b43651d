"""Emulated instruments by the name of their driver; only the one that is asked for is imported."""

from __future__ import annotations

from importlib import import_module
from inspect import signature
from typing import Any, cast

from sim.instruments.instrument import Instrument, Plant

# class in sim.instruments by the driver's name, which is the module's, too
CONTROLLERS = {
    "lakeshore": "LakeShore",
    "meerstetter": "MeerstetterTec",
    "srs_ldc500": "SrsLdc500",
    "tclab": "TcLab",
    "te_technology": "TeTechnology",
}
METERS = {
    "hp34401a": "Hp34401A",
    "keithley2000": "Keithley2000",
    "keithley2400": "Keithley2400",
    "keithley2450": "Keithley2450",
}


def emulated_controller(name: str, plant: Plant, start_s: float = 0.0, **options: Any) -> Instrument:
    """Return the emulator of a temperature controller on a plant; options go to it. KeyError for an unknown name."""
    return cast(Instrument, _emulator(name, CONTROLLERS[name])(plant, start_s=start_s, **options))


def emulated_meter(name: str, plant: Plant, start_s: float = 0.0, **options: Any) -> Instrument:
    """Return the emulator of a meter on a plant; options go to it. KeyError for an unknown name."""
    return cast(Instrument, _emulator(name, METERS[name])(plant, start_s=start_s, **options))


def emulator_options(role: str, name: str) -> set[str]:
    """Return the names of the options that an emulator has; role "controller" or "meter"."""
    emulator = _emulator(name, (CONTROLLERS if role == "controller" else METERS)[name])
    return set(signature(emulator).parameters) - {"plant", "start_s"}


def _emulator(name: str, kind: str) -> Any:
    return getattr(import_module(f"sim.instruments.{name}"), kind)
