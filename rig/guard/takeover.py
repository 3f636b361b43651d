"""Switching the output off at a port whose owner has died: open it, command off, and see it confirmed.

The dead process's lock goes with it; before that the port is opened without. A frame that it left half-written is
closed by the driver's own way of bringing a line in step; what does not answer is asked again, with the port opened
anew, until the patience is over.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any

import serial

WRITE_TIMEOUT_S = 1.0
BETWEEN_TRIALS_S = 0.02


@dataclass(frozen=True)
class Held:
    """An instrument that the working process holds: role "controller" or "meter", and what opens it."""

    role: str
    driver: str
    port: str
    options: dict[str, Any] = field(default_factory=dict)


def prepare(held: Held) -> None:
    """Import what `switch_off` needs, so that nothing has to be read from a disk (it may be full, or gone) then."""
    from rig.clock import RealClock  # noqa: F401
    from rig.drivers.registry import CONTROLLERS, METERS, driver_class

    driver_class(CONTROLLERS if held.role == "controller" else METERS, held.role, held.driver)


def switch_off(held: Held, patience_s: float, locked: bool = True) -> tuple[bool, str]:
    """Command the output (a meter's test current) off: whether it is confirmed, and what stood in the way.

    locked: whether the port's lock is asked for; a process that is about to be gone may still have it.
    """
    from rig.clock import RealClock
    from rig.drivers import registry

    give_up_s = time.monotonic() + patience_s
    problem = ""
    while True:
        try:
            opener = registry.open_controller if held.role == "controller" else registry.open_meter
            with contextlib.nullcontext() if locked else _unlocked(registry):
                instrument = opener(held.driver, held.port, RealClock(), **held.options)
            try:
                if instrument.off():
                    return True, ""
                problem = f"{held.port}: the {held.role} does not confirm it"
            finally:
                instrument.close()
        except Exception as error:  # whatever it is, the output has to go off
            problem = str(error)
        if time.monotonic() >= give_up_s:
            return False, problem
        time.sleep(BETWEEN_TRIALS_S)


@contextlib.contextmanager
def _unlocked(registry: ModuleType) -> Iterator[None]:
    """In this process, the guard's own, drivers open their ports without the lock."""
    with_lock = registry.open_port

    def open_port(port: str, settings: Any) -> Any:
        line = {name: getattr(settings, name) for name in ("baudrate", "bytesize", "parity", "stopbits", "xonxoff")}
        return serial.serial_for_url(port, **line, timeout=0, write_timeout=WRITE_TIMEOUT_S)

    setattr(registry, "open_port", open_port)  # noqa: B010
    try:
        yield
    finally:
        setattr(registry, "open_port", with_lock)  # noqa: B010
