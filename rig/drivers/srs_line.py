"""SRS instruments over a serial line: the same token as in SCPI, within 64 bytes, and errors that are asked for.

Source: LDC500 series manual, remote chapter p. 4-10 (lines, 64-byte input buffer, TERM), p. 4-37, 4-38 (LCME, LEXE).

A line asks its questions and ends in `*ESE?;*ESE n`, as in `rig.drivers.scpi`. Answers may come one by one or joined
with `;`, and with any terminator: as many are awaited as there are questions, the token the last. An instrument that
was set to no terminator, or to CR alone, is told to use CR and LF (TERM is kept by the instrument, so this is done
only where it does not answer otherwise). There is no character that aborts; a line end closes what may lie half-sent
in the buffer.

Settings are silent. Errors are asked for after a pause, because the instrument takes some milliseconds to log them.
"""

from __future__ import annotations

from collections.abc import Callable

from rig.core.errors import Corrupt, Refused
from rig.drivers.scpi import ScpiLink
from rig.ports.transport import Transport

LONGEST_LINE = 64  # bytes of its input buffer
ANSWER_S = 0.3  # until an answer begins: it takes commands one by one, some 10 ms each
LOGGED_S = 0.02  # until an error can be asked for
COMMAND_ERRORS = {
    1: "illegal command",
    2: "undefined command",
    3: "illegal query",
    4: "illegal set",
    5: "missing parameter",
    6: "extra parameter",
    7: "null parameter",
    8: "input buffer overflow",
    9: "bad number",
    10: "bad integer",
    11: "bad token",
    12: "bad token value",
    13: "bad hexadecimal",
    14: "unknown token",
}


class SrsLink(ScpiLink):
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
            end=b"\n",
            abort=b"",
            byte_s=byte_s,
            answer_s=ANSWER_S,
            first_token=first_token,
            after_resynchronisation=after_resynchronisation,
        )
        self._questions = 1

    def command(self, message: str) -> None:
        """Send what has no answer, and see whether it was taken: Refused with the error."""
        self.ask(message)
        self.check(message)

    def check(self, message: str) -> None:
        """Ask for errors, when they have been logged: Refused, for `message`."""
        clock = self.transport.clock
        clock.sleep_until_s(clock.now_s() + LOGGED_S)
        self._ask_for_errors()
        if self.errors:
            raise Refused(self.errors[0][0], f"{self.errors[0][1]}: {message}")

    def _ask_for_errors(self) -> None:
        self.errors = []
        execution, _, command = self.ask("LEXE?;LCME?").partition(";")
        try:
            execution_code, command_code = int(execution), int(command)
        except ValueError:
            self.doubt()
            raise Corrupt(f"{execution!r} and {command!r} are no error numbers") from None
        if command_code:
            self.errors.append((command_code, COMMAND_ERRORS.get(command_code, "command error")))
        if execution_code:
            self.errors.append((execution_code, "execution error"))

    def _empty_error_queue(self) -> None:
        self.errors = []
        self._send("LEXE?;LCME?", self._answer_s)
        self.finish()

    def _send(self, message: str, answer_s: float) -> None:
        if len(message) + len(";*ESE?;*ESE 255\n") > LONGEST_LINE:
            raise ValueError(f"{message!r} does not fit into the instrument's {LONGEST_LINE} bytes")
        self._questions = message.count("?") + 1
        super()._send(message, answer_s)

    def _receive_answer(self, deadline_s: float) -> bytes:
        answers = b""
        while True:
            line = self.transport.receive_line(b"\n", deadline_s).strip()
            if line:
                answers = answers + b";" + line if answers else line
                if answers.count(b";") + 1 >= self._questions:
                    return answers

    def _uncalled(self) -> bool:
        return self.transport.has_more and bool(self.transport.drain().strip())

    def _await_token(self, attempt: int) -> None:
        self._wake = b"TERM 3" if attempt else b""
        super()._await_token(attempt)
