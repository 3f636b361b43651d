"""How an experiment can end, and the exit status that says so.

Outcome (Exception)
+-- Unsuitable       1    the film is not one that the experiment can go on with
+-- Tripped          10   an interlock tripped
+-- NotConfirmedOff  11   the output is not confirmed off; outranks all others
+-- Stopped          128 + n   stopped by signal n
"""

from __future__ import annotations

import signal


class OfOutput(str):
    """A note on an error that says what became of the output: it is told first, or in a place of its own."""

    __slots__ = ()


class Outcome(Exception):
    """An end that is neither success nor a program's fault."""

    exit_status = 1


class Unsuitable(Outcome):
    """What was measured is nothing that the experiment can go on with; nothing is wrong with the bench.

    cause: a word for it, as a trip has one.
    """

    def __init__(self, cause: str, text: str) -> None:
        super().__init__(text)
        self.cause = cause


class Tripped(Outcome):
    """An interlock tripped: which, on what value, against which limit."""

    exit_status = 10

    def __init__(self, cause: str, text: str, time_s: float) -> None:
        super().__init__(text)
        self.cause = cause
        self.time_s = time_s


class NotConfirmedOff(Outcome):
    """The controller did not confirm that its output is off."""

    exit_status = 11


class Stopped(Outcome):
    """Stopped by a signal."""

    def __init__(self, number: int) -> None:
        super().__init__(f"stopped by {signal.Signals(number).name}")
        self.number = number
        self.exit_status = 128 + number
