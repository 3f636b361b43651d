"""A line on which no answer names its question: after anything unexpected it is in doubt, and is brought in step first.

Each protocol proves in its own way that an answer belongs to its question, by a number that counts up: a token in a
register (`rig.drivers.scpi`), or a fence behind the questions (`rig.drivers.te_technology`, `rig.drivers.tclab`).
"""

from __future__ import annotations

import random

from rig.core.errors import Disconnected, InstrumentError, OutOfStep
from rig.ports.transport import Transport

RESYNCHRONISATIONS = 3  # one may meet the same disturbance again; after three the line is dead


class SteppedLink:
    """Base of the links to instruments that answer in order. byte_s: of a character on the line, s.

    in_doubt: the next question brings the line in step first. resynchronised: how often that was done. arrived_s: when
    the last question had arrived. REOPENS: whether the last trial opens the port anew; else only a port whose device
    was gone is.
    """

    LARGEST_TOKEN: int
    REOPENS = True

    def __init__(self, transport: Transport, *, byte_s: float, first_token: int | None) -> None:
        self.transport = transport
        self._byte_s = byte_s
        self._token = random.randrange(1, self.LARGEST_TOKEN + 1) if first_token is None else first_token
        self.in_doubt = True
        self.resynchronised = 0
        self.arrived_s = 0.0

    def doubt(self) -> None:
        """Resynchronise before the next question, because something was wrong with an answer."""
        self.in_doubt = True

    def _bring_in_step(self, trials: int) -> None:
        """Try until an answer is proven; InstrumentError of the last trial if none is."""
        self.in_doubt = True
        problem: InstrumentError | None = None
        for attempt in range(trials):
            try:
                if 0 < attempt == trials - 1 if self.REOPENS else isinstance(problem, Disconnected):
                    self.transport.reopen()
                self._prove(attempt)
            except InstrumentError as error:
                problem = error
            else:
                self.in_doubt = False
                self.resynchronised += 1
                return
        raise problem or OutOfStep("the line cannot be brought in step")

    def _prove(self, attempt: int) -> None:
        """Discard what may be under way, and return when a fresh number has come back. InstrumentError."""
        raise NotImplementedError
