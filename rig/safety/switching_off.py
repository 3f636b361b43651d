"""Switch the output off and find out whether it is off, for the working process, the guard and `peltier off`.

1. off: the driver's commands, each stronger than the one before; done within 0.7 s.
2. silence: if "off" is not confirmed and the controller has a dead man, nothing is sent for a little longer than the
   dead man's time, because every frame that the controller understands feeds it.
3. look: status and current are read, once; nothing is commanded any more.

An output that is not confirmed off then is reported as such, and never as confirmed later: it has to be switched off by
hand. Time is the bench's clock, which the controller's transport uses.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from rig.core.errors import Disconnected
from rig.core.outcome import Stopped
from rig.drivers.controller import TemperatureController

MARGIN_S: Final = 0.3  # added to the dead man's time: its clock differs, and it acts at its next control step
STEP_S: Final = 0.5  # of the silence, between two signs of life
NO_OUTPUT_A: Final = 0.1  # an offset of the current measurement is below this
NOT_CONFIRMED: Final = "the controller did not confirm that its output is off"
BY_ITS_DEAD_MAN: Final = "it did not obey the command, and its own dead man switched the output off"


@dataclass(frozen=True)
class Verdict:
    """Result of switching off.

    confirmed: True if the controller confirmed it; text: why it did not, or how it came about; said_s: when the last
    command was sent, on the controller's clock.
    """

    confirmed: bool
    text: str = ""
    said_s: float = 0.0


def _nothing() -> None:
    """Default sign of life: none."""


def confirmed_by(controller: Any) -> str:
    """Return the evidence on which the confirmation of a controller, or a driver class, rests, in words."""
    return str(getattr(controller, "confirms_off_by", "what its driver reads back"))


def off_confirmed(controller: Any, when: str = "") -> str:
    """Return the sentence for a confirmed "off" of a controller or driver class. when: after how long, in words."""
    return f"output off, confirmed by the controller{when} ({confirmed_by(controller)})"


def switch_off(
    controller: TemperatureController, dead_man_s: float | None = None, alive: Callable[[], None] = _nothing
) -> Verdict:
    """Command off; if that is not confirmed, be silent and look. Raises nothing but the exception of a signal.

    dead_man_s: of the controller; by default the configured one. alive: called twice a second during the silence.
    """
    confirmed, why = False, NOT_CONFIRMED
    try:
        confirmed = controller.off()
    except Stopped:  # a signal: the end of the run switches off again
        raise
    except Exception as error:  # a driver of the user's own may do anything
        why = f"{NOT_CONFIRMED} ({_of(controller, error)})"
    said_s = controller.transport.clock.now_s()
    if confirmed:
        return Verdict(True, "", said_s)
    if dead_man_s is None:
        dead_man_s = float(getattr(controller, "dead_man_s", 0.0))
    if not (controller.has_dead_man and dead_man_s > 0.0):
        return Verdict(False, why, said_s)
    return look_after_silence(controller, dead_man_s, said_s, alive)


def look_after_silence(
    controller: TemperatureController, dead_man_s: float, said_s: float, alive: Callable[[], None] = _nothing
) -> Verdict:
    """Send nothing until the dead man's time has passed since `said_s`, then look once. Never raises an Exception."""
    clock = controller.transport.clock
    until_s = said_s + dead_man_s + MARGIN_S
    while clock.now_s() < until_s:
        clock.sleep_until_s(min(until_s, clock.now_s() + STEP_S))
        with contextlib.suppress(Exception):  # a guard that has gone changes nothing here
            alive()
    is_off, what = looks_off(controller)
    if is_off:
        return Verdict(True, BY_ITS_DEAD_MAN, said_s)
    return Verdict(
        False, f"{NOT_CONFIRMED}, not even after {dead_man_s:g} s of silence for its dead man ({what})", said_s
    )


def looks_off(controller: TemperatureController) -> tuple[bool, str]:
    """Return (True if status and, if it reports one, current say "off"; the report). Reads once and commands nothing.

    Never raises an Exception.
    """
    try:
        try:
            return _look(controller)
        except Disconnected:  # the port may be back
            controller.transport.reopen()
            return _look(controller)
    except Exception as error:
        return False, _of(controller, error)


def _of(controller: TemperatureController, error: Exception) -> str:
    """Return an error's text without the controller's name, which stands in front of the whole message."""
    return str(error).removeprefix(f"{getattr(controller.transport, 'who', '')}: ")


def _look(controller: TemperatureController) -> tuple[bool, str]:
    status = controller.status()
    if status.output_is_on:
        return False, f"its status is {status.text!r}"
    current = controller.read_current()
    if current.is_number:
        return abs(current.value) <= NO_OUTPUT_A, f"{current.value:.3g} A flow"
    return not controller.commands_current, "it does not report its current"
