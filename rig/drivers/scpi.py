"""SCPI over a serial line: a question, and the proof that an answer belongs to it.

Sources: IEEE 488.2-1992 (*ESE, *ESE?, `;` lists answered in one line), Model 2000 User's Manual rev J p. 4-38 (^X
aborts and discards pending output), p. 5-63 (error queue).

SCPI has neither sequence numbers nor checksums. Two means make up for that:

* a token. Every message ends in `*ESE?;*ESE n`: it asks for the number that the message before has left in the event
  status enable register, and leaves another. A late, repeated or lost answer, and an instrument that has restarted in
  between (its register is 0), show a wrong number.
* after anything unexpected the line is in doubt: ^X, then `*ESE n;*ESE?` until that number comes back. The instrument
  answers in order, so everything older has come before it and is discarded.

Tokens count from 1 to 255, from a random first one, so that none comes again before 254 others have been used.
Residual: another message's whole answer passes if its token is the right one, 1 time in 255.
"""

from __future__ import annotations

import re
from typing import Any, ClassVar

from rig.core.errors import Corrupt, OutOfStep, Refused, TimedOut
from rig.drivers.in_step import RESYNCHRONISATIONS, SteppedLink
from rig.ports.transport import Transport

TRIALS = 3  # one answer may be hurt, and its repetition by the same disturbance
LONGEST_ANSWER = 100  # characters, for the time that they take
LOOK_S = 0.005  # to look for an answer whose time has passed while nobody asked: it may have come long ago
TOKEN = re.compile(rb"\s*\+?0*(\d{1,3})\s*")
ERROR = re.compile(r'(?:.*;)?\s*([+-]?\d+)\s*,\s*(?:"([^"]*)"|([^";]*))\s*')  # some write semicolons into the text


class ScpiLink(SteppedLink):
    """One instrument; see `SteppedLink`.

    TERMINATOR: of its answers; END: of our messages; ABORT: the character that makes it drop its work;
    CLEAR_S: how long that takes before it listens again, s. WAKE: a message that it needs before any other. ANSWER_S:
    until an answer begins that takes no measurement; meters answer within 50 ms.
    """

    TERMINATOR: ClassVar[bytes] = b"\n"
    END: ClassVar[bytes] = b"\r"
    ABORT: ClassVar[bytes] = b"\x18"
    CLEAR_S: ClassVar[float] = 0.0
    WAKE: bytes = b""
    ANSWER_S: ClassVar[float] = 0.5
    LARGEST_TOKEN = 255

    def __init__(self, transport: Transport, *, byte_s: float, **options: Any) -> None:
        super().__init__(transport, byte_s=byte_s, **options)
        self._answer_s = self.ANSWER_S + LONGEST_ANSWER * byte_s
        self._expected = b""
        self._pending = False
        self._deadline_s = 0.0
        self.errors: list[tuple[int, str]] = []

    def forget(self) -> None:
        """Give up on the answer that is under way; the next question brings the line in step."""
        self._pending = False  # in doubt it has been since that question was sent

    def be_in_step(self, trials: int = RESYNCHRONISATIONS) -> None:
        """See `SteppedLink`. OutOfStep if a question waits for its answer."""
        if self._pending:
            self._pending = False
            raise OutOfStep("a question is asked while another waits for its answer")
        super().be_in_step(trials)

    def start(self, message: str, answer_s: float | None = None, trials: int = RESYNCHRONISATIONS) -> None:
        """Send a message with a question, whose answer `finish` returns within `answer_s` from now.

        trials: to bring the line in step first, if it is in doubt.
        """
        self.be_in_step(trials)
        extra_s = LONGEST_ANSWER * self._byte_s
        self._send(message, self._answer_s if answer_s is None else answer_s + extra_s)

    def finish(self) -> str:
        """Return the answer, proven to belong to the question. TimedOut, Corrupt, OutOfStep, Disconnected."""
        if not self._pending:
            raise OutOfStep("there is no question to be answered")
        self._pending = False
        line = self._receive_answer(max(self._deadline_s, self.transport.clock.now_s() + LOOK_S))
        answer, _, token = line.rpartition(b";")
        if token != self._expected and not _is_token(token, self._expected):
            if not token.strip().isdigit() or not answer:
                raise Corrupt(f"{line!r} is no answer")
            raise OutOfStep(f"the answer has token {token!r}, and the message before left {self._expected!r}: {line!r}")
        self.in_doubt = False
        return answer.decode("latin-1")

    def ask(self, message: str, answer_s: float | None = None) -> str:
        """Return the answer to a question. Refused, from the error queue, if the instrument gave none."""
        try:
            self.start(message, answer_s)
            return self.finish()
        except TimedOut:
            self.explain_silence(message)
            raise

    def answers(self, message: str, count: int) -> list[str]:
        """Return the answers to several questions of one message. Corrupt if they are not `count`."""
        answers = self.ask(message).split(";")
        if len(answers) != count:
            self.doubt()
            raise Corrupt(f"{answers} are not {count} answers to {message}")
        return answers

    def twice(self, *questions: str) -> list[str]:
        """Return answers that the instrument gives twice in one line, a token between; Corrupt if they differ.

        A stale pair before the token of a question that did not arrive whole is none.
        """
        message, count = ";".join(questions), len(questions)
        for _ in range(TRIALS):
            answers = self.answers(f"{message};*ESE?;{message}", 2 * count + 1)
            first, token, second = answers[:count], answers[count], answers[count + 1 :]
            if first == second and self.is_token(token):
                return first
        self.doubt()
        raise Corrupt(f"{first}, {token!r}, {second} are not twice the same about a token")

    def shout(self, message: str) -> None:
        """Send a line at once, whatever the instrument is doing, and wait for no answer."""
        self.doubt()
        self.transport.send(self.END + message.encode("ascii") + self.END)

    def explain_silence(self, message: str) -> None:
        """Raise Refused if the error queue says why an answer did not come."""
        self.resynchronise()
        if self.errors:
            raise Refused(self.errors[0][0], f"{self.errors[0][1]}: {message}") from None

    def command(self, message: str) -> None:
        """Send a command, and raise Refused with the first error in the queue."""
        answer = self.ask(message + ";:SYST:ERR?")
        code, text = _error(answer)
        if code:
            raise Refused(code, f"{text}: {message}")

    def ask_alone(self, message: str) -> str:
        """Return the answer to a question that must stand alone (*IDN?); resynchronise before and after."""
        self.resynchronise()
        self.in_doubt = True
        self.transport.send(message.encode("ascii") + self.END)
        deadline_s = self.transport.clock.now_s() + self._answer_s
        answer = self.transport.receive_line(self.TERMINATOR, deadline_s).decode("latin-1").strip()
        self.resynchronise()
        return answer

    def is_token(self, text: str) -> bool:
        """Return True if this is the token of the last answer, for a question that asks for it in between, too."""
        return _is_token(text.strip().encode("latin-1"), self._expected)

    def _next_token(self) -> int:
        """Return the next token; not 0, which an instrument that has restarted holds."""
        return self._token % 255 + 1

    def _receive_answer(self, deadline_s: float) -> bytes:
        return self.transport.receive_line(self.TERMINATOR, deadline_s)

    def _send(self, message: str, answer_s: float) -> None:
        # in doubt until the answer is here, whatever interrupts us
        self.in_doubt = True
        self._expected = b"%d" % self._token
        self._token = self._next_token()
        data = f"{message};*ESE?;*ESE {self._token}".encode("ascii") + self.END
        transport = self.transport
        transport.send(data)
        now_s = transport.clock.now_s()
        self.arrived_s = now_s + len(data) * self._byte_s
        self._deadline_s = self.arrived_s + answer_s
        self._pending = True

    def _empty_error_queue(self) -> None:
        self.errors = []
        for _ in range(16):
            self._send(":SYST:ERR?", self._answer_s)
            code, text = _error(self.finish())
            if not code:
                break
            self.errors.append((code, text))

    def _prove(self, attempt: int) -> None:
        """Abort, discard, and wait for a fresh token; then empty the error queue into `errors`."""
        self._pending = False
        token = self._token = self._next_token()
        transport = self.transport
        transport.drain()
        if self.CLEAR_S:
            transport.send(self.ABORT)
            transport.clock.sleep_until_s(transport.clock.now_s() + self.CLEAR_S)
            transport.drain()
        opening = (b"" if self.CLEAR_S else self.ABORT) + self.END
        if self.WAKE:
            opening += self.WAKE + self.END
        data = opening + b"*ESE %d;*ESE?" % token + self.END
        transport.send(data)
        deadline_s = transport.clock.now_s() + self._answer_s
        while not _is_token(transport.receive_line(self.TERMINATOR, deadline_s), b"%d" % token):
            pass
        self._empty_error_queue()


def _is_token(text: bytes, expected: bytes) -> bool:
    """Return True if `text` is the number `expected`; some instruments write a sign."""
    found = TOKEN.fullmatch(text)
    return found is not None and found[1] == expected


def _error(answer: str) -> tuple[int, str]:
    """Return number and text of an entry of the error queue, with or without quotes; 0 if it is empty."""
    found = ERROR.fullmatch(answer)
    if found is None:
        raise Corrupt(f"{answer!r} is no entry of an error queue")
    return int(found[1]), (found[2] or found[3] or "").partition(";")[0].strip()
