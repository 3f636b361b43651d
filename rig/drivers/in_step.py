"""A line on which no answer names its question: after anything unexpected it is in doubt, and is brought in step first.

Each protocol proves in its own way that an answer belongs to its question, by a number that counts up: a token in a
register (`rig.drivers.scpi`), or a fence behind the questions (`rig.drivers.te_technology`, `rig.drivers.tclab`).
"""

from __future__ import annotations

import random
from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

from rig.core.errors import Corrupt, Disconnected, InstrumentError, OutOfStep, TimedOut
from rig.ports.transport import Transport

P = ParamSpec("P")
T = TypeVar("T")

RESYNCHRONISATIONS = 3  # one may meet the same disturbance again; after three the line is dead


class SteppedLink:
    """Base of the links to instruments that answer in order. byte_s: of a character on the line, s.

    after_resynchronisation: called when the line is in step again, so that the driver asks what the instrument still
    remembers: it may have restarted. in_doubt: the next question brings the line in step first. arrived_s: when the
    last question had arrived. REOPENS: whether the last trial opens the port anew; else only one whose device was gone.
    """

    LARGEST_TOKEN: int
    REOPENS = True

    def __init__(
        self,
        transport: Transport,
        *,
        byte_s: float,
        first_token: int | None = None,
        after_resynchronisation: Callable[[], None] = lambda: None,
    ) -> None:
        self.transport = transport
        self._byte_s = byte_s
        self._token = random.randrange(1, self.LARGEST_TOKEN + 1) if first_token is None else first_token
        self._after_resynchronisation = after_resynchronisation
        self.in_doubt = True
        self.arrived_s = 0.0

    def doubt(self) -> None:
        """Resynchronise before the next question, because something was wrong with an answer."""
        self.in_doubt = True

    def be_in_step(self, trials: int = RESYNCHRONISATIONS) -> None:
        """Resynchronise if the line is in doubt, or if something has come unasked."""
        if self.in_doubt or self._has_unasked():
            self.resynchronise(trials)

    def resynchronise(self, trials: int = RESYNCHRONISATIONS) -> None:
        """Try until an answer is proven; InstrumentError of the last trial if none is."""
        self.in_doubt = True
        problem: InstrumentError | None = None
        for attempt in range(trials):
            try:
                if 0 < attempt == trials - 1 if self.REOPENS else isinstance(problem, Disconnected):
                    self.transport.reopen()
                self._prove(attempt)
                break
            except InstrumentError as error:
                problem, self.in_doubt = error, True  # whatever a part of the proof has shown
        else:
            raise problem or OutOfStep("the line cannot be brought in step")
        self.in_doubt = False
        try:
            self._after_resynchronisation()
        except BaseException:
            self.in_doubt = True  # in step, but what the instrument remembers is not known
            raise

    def _has_unasked(self) -> bool:
        return self.transport.has_more

    def _prove(self, attempt: int) -> None:
        """Discard what may be under way, and return when a fresh number has come back. InstrumentError."""
        raise NotImplementedError


def retry_once(question: Callable[P, T]) -> Callable[P, T]:
    """Decorate a method of a driver's start so that it is done a second time after TimedOut, Corrupt or OutOfStep.

    For methods that may be done twice and prove their answers: identity, and settings that are read back. A line that
    hiccups once (an adapter that hands over half an answer, the rest 0.4 s later) does not end a start.
    """

    @wraps(question)
    def asked(*args: P.args, **more: P.kwargs) -> T:
        try:
            return question(*args, **more)
        except (TimedOut, Corrupt, OutOfStep):
            return question(*args, **more)

    return asked
