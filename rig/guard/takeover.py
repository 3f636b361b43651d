"""Switch the output off at a port whose owner has died: open the port, command off, wait for the confirmation.

The dead process's lock goes away with it; before that the port is opened without. The driver's own resynchronisation
closes a frame that was left half-written. A port that cannot be opened (an adapter that is being plugged in) is tried
again for some seconds. A controller that does not confirm is not asked again and again, because every frame feeds its
dead man: see `rig.safety.switching_off`.

If the output is still not confirmed off, a message tells the user to switch the controller off by hand, and a detached
process (`keep_trying`) goes on for a minute. It holds the port, so that nothing else starts there (exit status 75 names
it), and prints nothing, so that the message stands. Between two trials it is silent for longer than the
controller's dead man. `peltier off` ends it and tries itself. Without fork there is no such process.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import time
from dataclasses import dataclass, field
from typing import Any

import serial

from rig.ports.open import STILL_TRYING, is_still_trying
from rig.safety.signals import CAUGHT
from rig.safety.switching_off import (
    MARGIN_S,
    ExpectedCurves,
    OffCheck,
    Verdict,
    check_temperature,
    look_after_silence,
    off_confirmed,
)
from rig.safety.switching_off import switch_off as switch_off_and_look

WRITE_TIMEOUT_S = 1.0  # a frame is a few bytes: a port that takes none for that long is gone
BETWEEN_OPENINGS_S = 0.02  # of a port that its last owner is still closing
KEEP_TRYING_S = 60.0  # a dozen times the usual dead man's time: by then somebody has pulled the plug
BETWEEN_TRIALS_S = 1.0  # a port that was gone needs about that to come back
PR_SET_NAME = 15  # of linux/prctl.h


@dataclass(frozen=True)
class Held:
    """An instrument that the working process holds: role "controller" or "meter", and the arguments that open it.

    dead_man_s: time to which a controller's dead man is configured.
    """

    role: str
    driver: str
    port: str
    options: dict[str, Any] = field(default_factory=dict)
    dead_man_s: float = 0.0


def prepare(held: Held) -> None:
    """Import now everything that `switch_off` will need: the disk may be gone by then."""
    from rig.core.clock import RealClock  # noqa: F401

    driver_of(held)


def driver_of(held: Held) -> Any:
    """Return the class of the instrument's driver."""
    from rig.drivers.registry import controller_class, meter_class

    return (controller_class if held.role == "controller" else meter_class)(held.driver)


def opened(held: Held, locked: bool = True) -> Any:
    """Return the driver on its port. locked: False opens without the port's lock, which a dying process may have."""
    from rig.core.clock import RealClock
    from rig.drivers.registry import open_controller, open_meter
    from rig.ports.open import open_port

    opener = open_controller if held.role == "controller" else open_meter
    way = open_port if locked else _open_unlocked
    return opener(held.driver, held.port, RealClock(), open_port=way, **held.options)


def off_at_once(held: Held) -> Verdict | None:
    """Command off without the port's lock and without waiting for a dead man; None if the port cannot be opened."""
    try:
        controller = opened(held, locked=False)
    except Exception:  # tried again with the lock
        return None
    try:
        return switch_off_and_look(controller, 0.0)
    finally:
        controller.close()


def switch_off(held: Held, patience_s: float) -> Verdict:
    """Command the output (a meter's test current) off; if unconfirmed, be silent for the dead man and look."""
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
    """Hold the port in silence for the dead man's time after an unconfirmed `off_at_once`, then look."""
    controller = _opened_in_time(held, patience_s)
    if isinstance(controller, str):
        return Verdict(False, controller)
    try:
        if not (controller.has_dead_man and held.dead_man_s > 0.0):
            return _named(held, before)
        return _named(held, look_after_silence(controller, held.dead_man_s, before.said_s))
    finally:
        controller.close()


def temperature_after(held: Held, curves: ExpectedCurves, off_s: float, patience_s: float) -> OffCheck:
    """Check the temperature after an "off" that was confirmed at `off_s`, holding the port. Never raises an Exception.

    If the port cannot be opened or the driver raises, the check stays undecided.
    """
    controller = _opened_in_time(held, patience_s)
    if isinstance(controller, str):
        return OffCheck(curves, off_s)
    dead_man_s = held.dead_man_s if controller.has_dead_man else 0.0
    try:
        return check_temperature(curves, controller, controller.transport.clock, off_s, dead_man_s)
    except Exception:  # a driver of the user's own may do anything
        return OffCheck(curves, off_s)
    finally:
        controller.close()


def keep_trying(held: Held, seconds: float = KEEP_TRYING_S) -> None:
    """Go on trying in a process of its own; returns at once in this one."""
    if not hasattr(os, "fork"):
        return
    if os.fork():  # unflushed stdout and stderr stay here: the other process ends without a flush
        return
    try:
        _detach()
        _try_until(held, time.monotonic() + seconds)
    finally:
        os._exit(0)


def end_trying(pid: int | None) -> bool:
    """End a `keep_trying` process; return False if it is none or another user's. Its port is free some ms later."""
    if pid is None or not is_still_trying(pid):
        return False
    try:
        os.kill(pid, signal.SIGKILL)
    except OSError:  # another user's
        return False
    return True


def _detach() -> None:
    """Leave the terminal and the caller's pipes, so that nobody waits for this process."""
    os.setsid()
    for number in (*CAUGHT, signal.SIGCHLD):
        signal.signal(number, signal.SIG_DFL)
    signal.set_wakeup_fd(-1)
    nothing = os.open(os.devnull, os.O_RDWR)
    for descriptor in (0, 1, 2):
        os.dup2(nothing, descriptor)
    os.closerange(3, 1024)
    if sys.platform == "linux":
        with contextlib.suppress(OSError, AttributeError, ImportError):
            import ctypes  # the guard has it already

            ctypes.CDLL(None).prctl(PR_SET_NAME, STILL_TRYING.encode(), 0, 0, 0)


def _try_until(held: Held, until_s: float) -> None:
    pause_s = BETWEEN_TRIALS_S
    if driver_of(held).has_dead_man:
        pause_s = max(pause_s, held.dead_man_s + MARGIN_S)
    controller = None
    while time.monotonic() < until_s:
        try:
            if controller is None:
                controller = opened(held)
            if controller.off():
                return
        except Exception:  # the port is gone, or somebody else's: the next trial decides
            controller = None
        time.sleep(pause_s)


def sentence(held: Held, verdict: Verdict) -> str:
    """Return the sentence for a confirmed "off": on what it rests, and how it came about."""
    return off_confirmed(driver_of(held)) + (f": {verdict.text}" if verdict.text else "")


def _opened_in_time(held: Held, patience_s: float) -> Any | str:
    """Return the driver, or, after patience_s, why the port cannot be opened."""
    give_up_s = time.monotonic() + patience_s
    while True:
        try:
            return opened(held)
        except Exception as error:  # whatever it is, the output has to go off
            problem = str(error)
        if time.monotonic() >= give_up_s:
            return problem
        time.sleep(BETWEEN_OPENINGS_S)


def _named(held: Held, verdict: Verdict) -> Verdict:
    """Return the verdict with the port's name in front of its reason."""
    return verdict if verdict.confirmed else Verdict(False, f"{held.port}: {verdict.text}", verdict.said_s)


def _open_unlocked(port: str, settings: Any) -> Any:
    """Open a port without its lock, which a process about to be gone may have."""
    from rig.ports.open import settings_at

    settings = settings_at(port, settings)
    line = {name: getattr(settings, name) for name in ("baudrate", "bytesize", "parity", "stopbits", "xonxoff")}
    return serial.serial_for_url(port, **line, timeout=0, write_timeout=WRITE_TIMEOUT_S)
