"""Switching the output off at a port whose owner has died: open it, command off, and see it confirmed.

The dead process's lock goes with it; before that the port is opened without. A frame that it left half-written is
closed by the driver's own way of bringing a line in step. A port that cannot be opened (an adapter that comes back just
now) is tried again until the patience is over; a controller that does not confirm is not asked again and again, because
that would feed its dead man: `rig.safety.switching_off`.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Any

import serial

from rig.safety.after_off import AfterOff, Courses, looked_at
from rig.safety.switching_off import Verdict, look_after_silence, off_confirmed
from rig.safety.switching_off import switch_off as switch_off_and_look

WRITE_TIMEOUT_S = 1.0  # a frame is a few bytes: a port that takes none for that long is gone
BETWEEN_TRIALS_S = 0.02  # of opening a port that its last owner is still letting go of


@dataclass(frozen=True)
class Held:
    """An instrument that the working process holds: role "controller" or "meter", and what opens it.

    dead_man_s: what a controller's dead man is configured to.
    """

    role: str
    driver: str
    port: str
    options: dict[str, Any] = field(default_factory=dict)
    dead_man_s: float = 0.0


def prepare(held: Held) -> None:
    """Import what `switch_off` needs, so that nothing has to be read from a disk (it may be full, or gone) then."""
    from rig.core.clock import RealClock  # noqa: F401

    driver_of(held)


def driver_of(held: Held) -> Any:
    """The class of its driver."""
    from rig.drivers.registry import controller_class, meter_class

    return (controller_class if held.role == "controller" else meter_class)(held.driver)


def opened(held: Held, locked: bool = True) -> Any:
    """Its driver, on its port. locked: whether the port's lock is asked for; a process about to be gone may have it."""
    from rig.core.clock import RealClock
    from rig.drivers.registry import open_controller, open_meter
    from rig.ports.open import open_port

    opener = open_controller if held.role == "controller" else open_meter
    way = open_port if locked else _open_unlocked
    return opener(held.driver, held.port, RealClock(), open_port=way, **held.options)


def off_at_once(held: Held) -> Verdict | None:
    """Off, without the port's lock, and without silence; None where the port cannot be opened."""
    try:
        controller = opened(held, locked=False)
    except Exception:  # tried again with the lock
        return None
    try:
        return switch_off_and_look(controller, 0.0)
    finally:
        controller.close()


def switch_off(held: Held, patience_s: float) -> Verdict:
    """Command the output (a meter's test current) off, and where it is not confirmed, be silent and look."""
    instrument = _opened_in_time(held, patience_s)
    if isinstance(instrument, str):
        return Verdict(False, instrument)
    try:
        if held.role == "meter":
            return Verdict(bool(instrument.off()))
        return _named(held, switch_off_and_look(instrument, held.dead_man_s))
    except Exception as error:  # a driver of the user's own may do anything
        return Verdict(False, f"{held.port}: {error}")
    finally:
        instrument.close()


def look_once_more(held: Held, before: Verdict, patience_s: float) -> Verdict:
    """After `off_at_once` was not confirmed: hold the port in silence for the dead man's time, and look."""
    controller = _opened_in_time(held, patience_s)
    if isinstance(controller, str):
        return Verdict(False, controller)
    try:
        if not (controller.has_dead_man and held.dead_man_s > 0.0):
            return _named(held, before)
        return _named(held, look_after_silence(controller, held.dead_man_s, before.said_s))
    finally:
        controller.close()


def temperature_after(held: Held, courses: Courses, off_s: float, patience_s: float) -> AfterOff:
    """What the temperature says of an output that was confirmed to be off at `off_s`. Never raises an Exception.

    The port is held meanwhile. A port that cannot be opened, and a driver that fails, leave it open.
    """
    controller = _opened_in_time(held, patience_s)
    if isinstance(controller, str):
        return AfterOff(courses, off_s)
    dead_man_s = held.dead_man_s if controller.has_dead_man else 0.0
    try:
        return looked_at(courses, controller, controller.transport.clock, off_s, dead_man_s)
    except Exception:  # a driver of the user's own may do anything
        return AfterOff(courses, off_s)
    finally:
        controller.close()


def sentence(held: Held, verdict: Verdict) -> str:
    """What a confirmation rests on, and how it came about."""
    return off_confirmed(driver_of(held)) + (f": {verdict.text}" if verdict.text else "")


def _opened_in_time(held: Held, patience_s: float) -> Any | str:
    """Its driver, or what stood in the way until the patience was over."""
    give_up_s = time.monotonic() + patience_s
    while True:
        try:
            return opened(held)
        except Exception as error:  # whatever it is, the output has to go off
            problem = str(error)
        if time.monotonic() >= give_up_s:
            return problem
        time.sleep(BETWEEN_TRIALS_S)


def _named(held: Held, verdict: Verdict) -> Verdict:
    """With the port's name in front of what is wrong."""
    return verdict if verdict.confirmed else Verdict(False, f"{held.port}: {verdict.text}", verdict.said_s)


def _open_unlocked(port: str, settings: Any) -> Any:
    """Open a port without its lock, which a process about to be gone may have."""
    from rig.ports.open import settings_at

    settings = settings_at(port, settings)
    line = {name: getattr(settings, name) for name in ("baudrate", "bytesize", "parity", "stopbits", "xonxoff")}
    return serial.serial_for_url(port, **line, timeout=0, write_timeout=WRITE_TIMEOUT_S)
