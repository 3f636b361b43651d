"""Lake Shore controllers over a serial line: the token of SCPI, in five bits, and errors in the event status register.

Source: Model 335 user's manual, chapter 6 (interface commands; status system, section 6.2.5; `;` lists answered in one
line), the same for the Model 336. Not verified on an instrument: that lines of 80 characters are taken.

A line asks its questions and ends in `*ESE?;*ESE m;*ESE?;*ESE n`, as in `rig.drivers.scpi` but with two tokens: what
the line before has left, and one of its own. Of the event status enable register only the bits that the instrument
uses (OPC, QYE, EXE, CME, PON) are sure to be kept, 31 numbers; the pair counts through 961: a whole answer of somebody
else's passes where both are the right ones. A register that is not what was left is that of an instrument that has
restarted. There is no error queue and no character that aborts; `*ESR?` tells what was not understood, and an end of
line closes what may lie half-sent.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

from rig.core.errors import Corrupt, OutOfStep, Refused
from rig.drivers.scpi import ScpiLink
from rig.ports.transport import Transport

ANSWER_S = 0.3  # until an answer begins: it takes commands every 50 ms, and another may be under way
BITS = (1, 4, 16, 32, 128)  # of the event status enable register that are used
TOKENS = tuple(sorted(sum(bits) for bits in product(*((0, bit) for bit in BITS)) if any(bits)))
ERRORS = {4: "query error", 8: "device error", 16: "execution error", 32: "command error"}


class LakeShoreLink(ScpiLink):
    """One instrument. byte_s: of a character on the line, s. Otherwise as `ScpiLink`."""

    def __init__(
        self,
        transport: Transport,
        *,
        byte_s: float,
        first_token: int | None = None,
        after_resynchronisation: Callable[[], None] | None = None,
    ) -> None:
        super().__init__(
            transport,
            terminator=b"\r\n",
            end=b"\n",
            abort=b"",
            byte_s=byte_s,
            answer_s=ANSWER_S,
            first_token=first_token,
            after_resynchronisation=after_resynchronisation,
        )
        self._count = self._token
        self._left = b""

    def is_token(self, text: str) -> bool:
        """Whether this is the token that the line before has left, where a question asks for it in between too."""
        return _is_number(text.strip().encode("latin-1"), self._left)

    def command(self, message: str) -> None:
        """Send what has no answer, and see whether it was taken: Refused with the error."""
        self._take_errors(self.ask(f"{message};*ESR?"))
        if self.errors:
            raise Refused(self.errors[0][0], f"{self.errors[0][1]}: {message}")

    def _next_token(self) -> int:
        self._count = (self._count + 1) % len(TOKENS) ** 2
        return TOKENS[self._count % len(TOKENS)]

    def _send(self, message: str, answer_s: float) -> None:
        self._left = b"%d" % self._token
        self._token = TOKENS[self._count // len(TOKENS) % len(TOKENS)]  # this line's own, which the answer ends with
        super()._send(f"{message};*ESE?;*ESE {self._token}", answer_s)

    def _receive_answer(self, deadline_s: float) -> bytes:
        rest, _, own = super()._receive_answer(deadline_s).rpartition(b";")
        answer, _, left = rest.rpartition(b";")
        if not _is_number(left, self._left):
            raise OutOfStep(f"token {left!r} where {self._left!r} was left")
        return answer + b";" + own

    def _empty_error_queue(self) -> None:
        self._send("*ESR?", self._answer_s)
        self._take_errors(self.finish())

    def _take_errors(self, answer: str) -> None:
        text = answer.strip()
        if not (text.isascii() and text.isdigit()):
            self.doubt()
            raise Corrupt(f"{answer!r} is no event status register")
        self.errors = [(bit, name) for bit, name in ERRORS.items() if int(text) & bit]


def _is_number(text: bytes, expected: bytes) -> bool:
    """Whether they are the same number; the instrument writes three digits."""
    return text.isascii() and text.isdigit() and int(text) == int(expected)
