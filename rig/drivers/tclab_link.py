"""TCLab's words from the host's side: some commands, and a number that proves that their replies are theirs.

Source: the board's public firmware, TCLab-sketch 1.4.0 and 2.0.1. A command is a line, and so is its reply; nothing in
a reply names its command, there is no checksum, and the board obeys in order.

What makes up for that: a fence closes every group of commands. The power limit of the heater that is not in use (P2
for heater 1) is set to a number that counts up, and the board answers with it. If every command has had one line, and
the fence its own, none of them was an older one's. The number stays between 0.01 and 100.00, which is never above the
board's own default, and comes again after 9999 others. After anything unexpected the line is in doubt: an end of line,
which closes what may lie half-sent, then fences until one comes back.

Opening the port restarts an Arduino Uno (not a Leonardo): its heaters are off then, and it listens `boot_s` later.
Only the first exchange waits for that. A port that is opened anew in mid-run is not waited for: a STOP may be behind
that exchange, and a board that has restarted ends the run anyway.

Residual: a reply lost and another doubled in the same group. What the replies are worth is the driver's to judge.
"""

from __future__ import annotations

import random

from rig.core.errors import Disconnected, InstrumentError, OutOfStep
from rig.ports.transport import Transport

END = b"\n"
REPLY_END = b"\r\n"
LONGEST_GROUP = 60  # bytes; the Arduino holds 64 that it has not read yet
LARGEST_TOKEN = 10000  # hundredths
RESYNCHRONISATIONS = 3
LONGEST_REPLY = 40  # characters
STALE_LINES = 64  # that may come before a fence, when the line is in doubt


class TcLabLink:
    """One board. fence: the command whose number fences. byte_s: of a character on the line, s.

    answer_s: until a group's last reply, beyond the time on the wire.
    """

    def __init__(
        self,
        transport: Transport,
        *,
        fence: str,
        byte_s: float,
        boot_s: float,
        answer_s: float = 0.25,
        first_token: int | None = None,
    ) -> None:
        self.transport = transport
        self._fence = fence
        self._byte_s, self._answer_s = byte_s, answer_s
        self._token = random.randrange(1, LARGEST_TOKEN + 1) if first_token is None else first_token
        self.listens_s = transport.clock.now_s() + boot_s  # the past, once it has answered
        self._in_doubt = True
        self.sent_s = 0.0  # when the last group was sent
        self.resynchronised = 0

    @property
    def in_doubt(self) -> bool:
        """Whether the next group has to bring the line in step first."""
        return self._in_doubt

    def doubt(self) -> None:
        """Something was wrong with a reply: resynchronise first."""
        self._in_doubt = True

    def ask(self, *commands: str) -> list[str]:
        """The replies to some commands, proven by the fence behind them. TimedOut, Corrupt, OutOfStep, Disconnected."""
        transport = self.transport
        if self._in_doubt or transport.has_more:
            self.resynchronise()
        self._in_doubt = True
        expected = self._next_token()
        data = "\n".join((*commands, f"{self._fence} {expected}\n")).encode("ascii")
        if len(data) > LONGEST_GROUP:
            raise ValueError(f"{data!r} does not fit into the board's {LONGEST_GROUP} bytes")
        transport.send(data)
        self.sent_s = transport.clock.now_s()
        characters = len(data) + LONGEST_REPLY * (len(commands) + 1)
        deadline_s = self.sent_s + self._answer_s + characters * self._byte_s
        *replies, fence = [self._line(deadline_s) for _ in range(len(commands) + 1)]
        if fence != expected:
            raise OutOfStep(f"{fence!r} came back where {expected!r} was expected: replies are out of step")
        if transport.has_more:
            raise OutOfStep("there were more replies than commands")
        self._in_doubt = False
        return replies

    def shout(self, command: str) -> None:
        """Send a command at once, whatever the line is doing; nobody waits for its reply."""
        self._in_doubt = True
        self.transport.send(END + command.encode("ascii") + END)

    def resynchronise(self, trials: int = RESYNCHRONISATIONS, *, boots: bool = True) -> None:
        """Fences until one comes back; a port whose device was gone is opened anew. InstrumentError.

        boots: whether a board that was opened just now is given the time until it listens.
        """
        self._in_doubt = True
        if boots:
            self.transport.clock.sleep_until_s(self.listens_s)
        problem: InstrumentError | None = None
        for _ in range(trials):
            try:
                if isinstance(problem, Disconnected):
                    self.transport.reopen()
                self._await_fence()
            except InstrumentError as error:
                problem = error
            else:
                self._in_doubt = False
                self.listens_s = self.transport.clock.now_s()
                self.resynchronised += 1
                return
        raise problem or OutOfStep("the line cannot be brought in step")

    def _await_fence(self) -> None:
        transport = self.transport
        transport.drain()
        expected = self._next_token()
        data = END + f"{self._fence} {expected}\n".encode("ascii")
        transport.send(data)
        deadline_s = transport.clock.now_s() + self._answer_s + (len(data) + LONGEST_REPLY) * self._byte_s
        for _ in range(STALE_LINES):
            if self._line(deadline_s) == expected:
                return
        raise OutOfStep("the line cannot be brought in step")

    def _line(self, deadline_s: float) -> str:
        return self.transport.receive_line(REPLY_END, deadline_s).decode("latin-1")

    def _next_token(self) -> str:
        self._token = self._token % LARGEST_TOKEN + 1
        return f"{self._token / 100.0:.2f}"
