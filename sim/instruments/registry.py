"""Emulated instruments by the name of their driver; only the one that is asked for is imported."""

from __future__ import annotations

from importlib import import_module
from typing import cast

from sim.instruments.instrument import Instrument, Plant

# driver's name -> module in sim.instruments, class
CONTROLLERS = {"meerstetter": ("meerstetter", "MeerstetterTec")}
METERS = {"keithley2000": ("keithley2000", "Keithley2000")}


def emulated_controller(name: str, plant: Plant, start_s: float = 0.0) -> Instrument:
    """The emulator of a temperature controller on a plant. An unknown name is a KeyError."""
    return _emulated(CONTROLLERS[name], plant, start_s)


def emulated_meter(name: str, plant: Plant, start_s: float = 0.0) -> Instrument:
    """The emulator of an ohmmeter on a plant. An unknown name is a KeyError."""
    return _emulated(METERS[name], plant, start_s)


def _emulated(where: tuple[str, str], plant: Plant, start_s: float) -> Instrument:
    module, kind = where
    return cast(Instrument, getattr(import_module(f"sim.instruments.{module}"), kind)(plant, start_s=start_s))
