"""Emulated instruments by the name of their driver; only the one that is asked for is imported."""

from __future__ import annotations

from importlib import import_module
from inspect import signature
from typing import Any, cast

from sim.instruments.instrument import Instrument, Plant

# driver's name -> module in sim.instruments, class
CONTROLLERS = {
    "lakeshore": ("lakeshore", "LakeShore"),
    "meerstetter": ("meerstetter", "MeerstetterTec"),
    "srs_ldc500": ("srs_ldc500", "SrsLdc500"),
    "tclab": ("tclab", "TcLab"),
    "te_technology": ("te_technology", "TeTechnology"),
}
METERS = {
    "hp34401a": ("hp34401a", "Hp34401A"),
    "keithley2000": ("keithley2000", "Keithley2000"),
    "keithley2400": ("keithley2400", "Keithley2400"),
    "keithley2450": ("keithley2450", "Keithley2450"),
}


def emulated_controller(name: str, plant: Plant, start_s: float = 0.0, **options: Any) -> Instrument:
    """The emulator of a temperature controller on a plant; options go to it. An unknown name is a KeyError."""
    return _emulated(CONTROLLERS[name], plant, start_s, options)


def emulated_meter(name: str, plant: Plant, start_s: float = 0.0, **options: Any) -> Instrument:
    """The emulator of an ohmmeter on a plant; options go to it. An unknown name is a KeyError."""
    return _emulated(METERS[name], plant, start_s, options)


def emulator_options(role: str, name: str) -> set[str]:
    """Names of the options that an emulator has; role "controller" or "meter"."""
    module, kind = (CONTROLLERS if role == "controller" else METERS)[name]
    emulator = getattr(import_module(f"sim.instruments.{module}"), kind)
    return set(signature(emulator).parameters) - {"plant", "start_s"}


def _emulated(where: tuple[str, str], plant: Plant, start_s: float, options: dict[str, Any]) -> Instrument:
    module, kind = where
    emulator = getattr(import_module(f"sim.instruments.{module}"), kind)
    return cast(Instrument, emulator(plant, start_s=start_s, **options))
