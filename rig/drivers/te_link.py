"""TE Technology frames from the host's side: a question, and as much proof as the protocol allows.

Sources: TC-36-25 RS232 manual, Appendix C p. 42 to 50; TC-48-20 manual, Appendix B p. 48 to 54. Frames as in
`sim.instruments.te_frames`: lower-case hexadecimal and an 8-bit sum; nothing in a reply names its request.

What makes up for that:

* one request at a time, `gap_s` after the last byte; bytes that nobody has asked for put the line in doubt;
* a fence closes every sequence of requests. Where the model has a register that can hold anything without a
  consequence, a number that counts up is written there, and the reply to a write is the value; elsewhere a value that
  no temperature has is read. The instrument answers in order, so if every request has had one reply, and the fence its
  own, then none of them was an older one's;
* after anything unexpected the line is in doubt: listened to until it has been silent for `drain_s`, then a fence until
  it comes back.

Residual, single faults: none for late, lost, split, repeated, stale and foreign frames, as each of them leaves one
frame too many or too few before the fence. A fence that only reads a constant cannot tell an old one from a new one:
there `drain_s` has to outlast the longest delay. Of double faults (one reply lost, another doubled) in one sequence, a
reading made twice can be its first half twice: right, and one exchange older than its time says.

The sum sees every change of one character. It misses a burst that leaves the sum as it is: 1 of about 16 random changes
of two neighbouring digits. Such a burst within up to four digits changes the value by a multiple of 15 (16 = 1 modulo
15, so the digits' sum is the value modulo 15): hence a reading is made twice, and the two have to agree
(`rig.drivers.te_technology`).
"""

from __future__ import annotations

import random
from dataclasses import dataclass

from rig.core.errors import Corrupt, InstrumentError, OutOfStep, TimedOut
from rig.ports.transport import Transport

RESYNCHRONISATIONS = 3  # one may meet the same disturbance again; after three the line is dead
REQUESTS = 3  # trials of a request that the instrument could not read
LARGEST_TOKEN = 9999
SHOUTS, SHOUT_S = 4, 0.015  # how often, and how far apart at least
DIGITS = frozenset(b"0123456789abcdef")
Request = tuple[bytes, int | None]


@dataclass(frozen=True, slots=True)
class Dialect:
    """A model's frames: digits of the data, whether there is an address, and what serves as a fence.

    fence_write: code of the register for a counting number. fence_read, fence_value: a code that reads a constant.
    quiet: a write that comes first after doubt (its acknowledgement does not matter).
    """

    digits: int
    has_address: bool
    fence_write: bytes = b""
    fence_read: bytes = b""
    fence_value: int = 0
    quiet: tuple[bytes, int] | None = None


class TeLink:
    """One controller.

    byte_s: of a character on the line, s. gap_s: from the last byte of a reply to the next request. drain_s: silence
    that is waited for when the line is in doubt. answer_s: until a reply begins, beyond the time on the wire.
    """

    def __init__(
        self,
        transport: Transport,
        dialect: Dialect,
        *,
        address: int = 0,
        byte_s: float,
        gap_s: float = 0.01,
        drain_s: float = 0.3,
        answer_s: float = 0.25,
        first_token: int | None = None,
    ) -> None:
        self.transport = transport
        self._dialect = dialect
        self._address = b"%02x" % address if dialect.has_address else b""
        self._gap_s, self._drain_s = gap_s, drain_s
        self._byte_s = byte_s
        self._patience_s = answer_s + (2 * dialect.digits + 12) * byte_s
        self._token = random.randrange(1, LARGEST_TOKEN + 1) if first_token is None else first_token
        self._in_doubt = True
        self._quiet_s = 0.0  # when the last byte came or went
        self.arrived_s = 0.0  # when the last request had arrived
        self.arrivals_s: list[float] = []  # of the requests of the last sequence, without its fence
        self.resynchronised = 0

    @property
    def in_doubt(self) -> bool:
        """Whether the next sequence has to bring the line in step first."""
        return self._in_doubt

    def doubt(self) -> None:
        """Something was wrong with a reply: resynchronise first."""
        self._in_doubt = True

    def sequence(self, *requests: Request, trials: int = RESYNCHRONISATIONS) -> list[int]:
        """Replies to some requests (code, value; None reads), proven by a fence behind them.

        A write whose reply is not its value is OutOfStep. TimedOut, Corrupt, OutOfStep, Disconnected.
        """
        transport = self.transport
        if self._in_doubt or transport.has_more:
            self.resynchronise(trials)
        self._in_doubt = True
        uncalled = transport.stale_bytes
        replies, self.arrivals_s = [], []
        for code, value in requests:
            reply = self._ask(code, value)
            if value is not None and reply != value:
                raise OutOfStep(f"{value} was written by code {code.decode()}, and {reply} acknowledged")
            replies.append(reply)
            self.arrivals_s.append(self.arrived_s)
        expected, reply = self._fence()
        if reply != expected:
            raise OutOfStep(f"{reply} came back where {expected} was expected: replies are out of step")
        if transport.stale_bytes != uncalled:
            raise OutOfStep("there were more replies than requests")
        self._in_doubt = False
        return replies

    def shout(self, code: bytes, value: int) -> None:
        """Send a write at once, whatever the line is doing, and some more times.

        Nobody waits for an acknowledgement. What begins while the instrument still answers the request before is lost
        (the manual warns of sending too fast), hence the repetition, for longer than an exchange takes.
        """
        self._in_doubt = True
        clock = self.transport.clock
        frame = self._frame(code, value)
        for _ in range(SHOUTS):
            self.transport.send(frame)
            clock.sleep_until_s(clock.now_s() + max(len(frame) * self._byte_s, SHOUT_S))

    def answers(self) -> bool:
        """Whether anything comes within the time of an answer, after `shout`; it stays unread."""
        clock = self.transport.clock
        give_up_s = clock.now_s() + self._patience_s
        while not self.transport.has_more:
            if clock.now_s() >= give_up_s:
                return False
            clock.sleep_until_s(clock.now_s() + SHOUT_S)
        return True

    def resynchronise(self, trials: int = RESYNCHRONISATIONS) -> None:
        """Listen until the line is silent, then send fences until one comes back."""
        self._in_doubt = True
        problem: InstrumentError | None = None
        for attempt in range(trials):
            try:
                if attempt and attempt == trials - 1:
                    self.transport.reopen()
                self._await_silence()
                if self._dialect.quiet is not None:
                    self._ask(*self._dialect.quiet)
                self._await_fence()
            except InstrumentError as error:
                problem = error
            else:
                self._in_doubt = False
                self.resynchronised += 1
                return
        raise problem or OutOfStep("the line cannot be brought in step")

    def _await_silence(self) -> None:
        transport = self.transport
        clock = transport.clock
        give_up_s = clock.now_s() + 10.0 * self._drain_s
        while True:
            clock.sleep_until_s(clock.now_s() + self._drain_s)
            if not transport.drain():
                return
            if clock.now_s() > give_up_s:
                raise OutOfStep("the line does not fall silent")

    def _await_fence(self) -> None:
        expected, reply = self._fence()
        for _ in range(32):
            if reply == expected:
                return
            try:
                data = self._receive(self.transport.clock.now_s() + self._patience_s)
            except TimedOut:
                break
            reply = _value(data)
        raise OutOfStep(f"{reply} came back where {expected} was expected: the line cannot be brought in step")

    def _fence(self) -> tuple[int, int]:
        """A fence's expected and its actual reply."""
        dialect = self._dialect
        if not dialect.fence_write:
            return dialect.fence_value, self._ask(dialect.fence_read, None)
        self._token = self._token % LARGEST_TOKEN + 1
        return self._token, self._ask(dialect.fence_write, self._token)

    def _ask(self, code: bytes, value: int | None) -> int:
        """One request and the next reply, whatever it answers."""
        transport = self.transport
        clock = transport.clock
        frame = self._frame(code, value)
        for _ in range(REQUESTS):
            clock.sleep_until_s(self._quiet_s + self._gap_s)
            transport.send(frame)
            sent_s = clock.now_s()
            self.arrived_s = sent_s + len(frame) * self._byte_s
            data = self._receive(sent_s + self._patience_s)
            if data.strip(b"X"):
                return _value(data)
        raise Corrupt(f"the instrument could not read {frame!r}")

    def _receive(self, deadline_s: float) -> bytes:
        """The next reply's data, X instead of digits where the instrument could not read the request."""
        try:
            line = self.transport.receive_line(b"^", deadline_s)
        finally:
            self._quiet_s = self.transport.clock.now_s()
        data = line[1:-2]
        if line[:1] == b"*" and len(data) == self._dialect.digits and b"%02x" % (sum(data) & 0xFF) == line[-2:]:
            return data
        raise Corrupt(f"{line!r} is no reply")

    def _frame(self, code: bytes, value: int | None) -> bytes:
        digits = self._dialect.digits
        if value is None:
            data = b"0" * digits if self._dialect.has_address else b""
        else:
            data = b"%0*x" % (digits, value & ((1 << 4 * digits) - 1))
        body = self._address + code + data
        return b"*%b%02x\r" % (body, sum(body) & 0xFF)


def _value(data: bytes) -> int:
    """Two's complement. Corrupt where it is no lower-case hexadecimal number."""
    if not DIGITS.issuperset(data):
        raise Corrupt(f"{data!r} is no number")
    value = int(data, 16)
    return value - (1 << 4 * len(data)) if data[0] >= 0x38 else value
