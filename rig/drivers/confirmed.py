"""What must happen is tried until the instrument says that it has: output off, test current off."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence

from rig.core.clock import Clock
from rig.core.errors import Disconnected, Refused
from rig.drivers.controller import Status
from rig.ports.transport import Transport

OFF_S = 0.7  # for all of a controller's ways to switch off: what is sent later only feeds its dead man
STATUS_S = 0.3  # a status that changes one control step (0.1 to 0.3 s) after the command is waited for
STARTED_S = 0.5  # the same when the output is switched on: until a status says "running"
LOOK_S = 0.02  # between two looks at a status


def confirmed(try_once: Callable[[int], bool], attempts: int, doubt: Callable[[], None]) -> bool:
    """Whether one of the attempts (0, 1, ...) was confirmed. Never raises; `doubt` is called after an error."""
    for attempt in range(attempts):
        try:
            if try_once(attempt):
                return True
        except Exception:  # whatever it was, the next attempt matters more
            doubt()
    return False


def _no_doubt() -> None:
    """Of a protocol whose every answer proves what it belongs to."""


def confirmed_off(
    transport: Transport, ways: Sequence[tuple[Callable[[], bool], float]], doubt: Callable[[], None] = _no_doubt
) -> bool:
    """Whether the output is off by one of several ways, each stronger than the one before. Never raises.

    ways: what commands off and looks whether it is, and until when that is repeated (s from now; once at least).
    doubt: called after whatever went wrong; a port whose device was gone is opened anew then.
    """
    clock = transport.clock
    begin_s = clock.now_s()
    for command_and_look, until_s in ways:
        while True:
            trial_s = clock.now_s()
            try:
                if command_and_look():
                    return True
            except Exception as error:  # whatever it was, the next attempt matters more
                with contextlib.suppress(Exception):  # a port that is gone stays gone: the next attempt tells
                    doubt()
                    if isinstance(error, Disconnected):
                        transport.reopen()
            now_s = clock.now_s()
            if now_s + max(LOOK_S, 0.5 * (now_s - trial_s)) >= begin_s + until_s:  # no room for another like it
                break
            clock.sleep_until_s(clock.now_s() + LOOK_S)
    return False


def comes_on(clock: Clock, status: Callable[[], Status]) -> None:
    """Wait until a controller says that its output is on. Refused where it does not, or is in error."""
    found: list[Status] = []

    def runs_or_never_will() -> bool:
        found[:] = [status()]
        return found[0].is_error or found[0].output_is_on

    waited_for(clock, runs_or_never_will, STARTED_S)
    if found[0].is_error or not found[0].output_is_on:
        remedy = f" ({found[0].remedy})" if found[0].remedy else ""
        raise Refused(found[0].code or None, f"the output does not come on: {found[0].text}{remedy}")


def waited_for(clock: Clock, true: Callable[[], bool], longest_s: float) -> bool:
    """Whether it becomes true in time; asked at once, and every `LOOK_S`. Raises what `true` raises."""
    until_s = clock.now_s() + longest_s
    while not true():
        if clock.now_s() >= until_s:
            return False
        clock.sleep_until_s(clock.now_s() + LOOK_S)
    return True
