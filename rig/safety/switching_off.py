"""Switching the output off, from the first command to a verdict: in the working process, the guard and `peltier off`.

    off       the driver's own ways, each stronger than the one before; over within 0.7 s
    silence   where that is not confirmed, and the controller has a dead man: every frame that it understands feeds it,
              so nothing is said for its time, and a bit more
    look      status and current are read, once; nothing is commanded any more

What is then not confirmed is told as that, and nobody says "confirmed" after it: the controller has to be switched off
by hand. Time is the bench's clock, by which the controller's transport lives.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from rig.core.errors import Disconnected
from rig.core.outcome import Stopped
from rig.drivers.controller import TemperatureController

MARGIN_S: Final = 0.3  # beyond the dead man's time: its clock is not ours, and it acts at its next control step
STEP_S: Final = 0.5  # of the silence, so that who waits for a sign of life has one
NO_OUTPUT_A: Final = 0.1  # a current-measurement offset is no output
NOT_CONFIRMED: Final = "the controller did not confirm that its output is off"
BY_ITS_DEAD_MAN: Final = "it did not obey, and its own dead man has switched it off"


@dataclass(frozen=True)
class Verdict:
    """Whether the output is off, confirmed by the controller, and why it is not, or how it came about, in words.

    said_s: when the last command was sent, on the controller's clock.
    """

    confirmed: bool
    text: str = ""
    said_s: float = 0.0


def _nothing() -> None:
    """Nobody waits for a sign of life."""


def confirmed_by(controller: Any) -> str:
    """What a controller's, or a driver class's, confirmation rests on, in words."""
    return str(getattr(controller, "confirms_off_by", "what its driver reads back"))


def off_confirmed(controller: Any, when: str = "") -> str:
    """The sentence that says so, of a controller or a driver class. when: after how long, in words."""
    return f"output off, confirmed by the controller{when} ({confirmed_by(controller)})"


def switch_off(
    controller: TemperatureController, dead_man_s: float | None = None, alive: Callable[[], None] = _nothing
) -> Verdict:
    """Off, and where that is not confirmed, silence and a look. Raises nothing but what a signal becomes.

    dead_man_s: of the controller; by default what this program has configured it to. alive: called twice a second.
    """
    confirmed, why = False, NOT_CONFIRMED
    try:
        confirmed = controller.off()
    except Stopped:  # a signal: whoever ends the run switches off again
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
    """Nothing is said until the dead man's time has passed since `said_s`; then one look. Never raises an Exception."""
    clock = controller.transport.clock
    until_s = said_s + dead_man_s + MARGIN_S
    while clock.now_s() < until_s:
        clock.sleep_until_s(min(until_s, clock.now_s() + STEP_S))
        with contextlib.suppress(Exception):  # whoever does not hear it has no say in this
            alive()
    is_off, what = looks_off(controller)
    if is_off:
        return Verdict(True, BY_ITS_DEAD_MAN, said_s)
    return Verdict(False, f"{NOT_CONFIRMED}, nor after {dead_man_s:g} s of silence for its dead man ({what})", said_s)


def looks_off(controller: TemperatureController) -> tuple[bool, str]:
    """Whether it says that it is off and, where it shows one, that no current flows; and what it says. One look,
    nothing is commanded. Never raises an Exception."""
    try:
        return _look_where_it_is(controller)
    except Exception as error:
        return False, _of(controller, error)


def _of(controller: TemperatureController, error: Exception) -> str:
    """What an error says, without the controller's name, which stands in front of all of it."""
    return str(error).removeprefix(f"{getattr(controller.transport, 'who', '')}: ")


def _look_where_it_is(controller: TemperatureController) -> tuple[bool, str]:
    """As `_look`; a port that was gone may be back."""
    try:
        return _look(controller)
    except Disconnected:
        controller.transport.reopen()
        return _look(controller)


def _look(controller: TemperatureController) -> tuple[bool, str]:
    """Whether it says that it is off and, where it shows one, that no current flows; and what it says."""
    status = controller.status()
    if status.output_is_on:
        return False, f"its status is {status.text!r}"
    current = controller.read_current()
    if current.is_number:
        return abs(current.value) <= NO_OUTPUT_A, f"{current.value:.3g} A flow"
    return not controller.commands_current, "it does not report its current"
