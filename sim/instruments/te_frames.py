"""TE Technology frames, the device's side: requests taken apart, replies put together.

Sources: TC-36-25 RS232 manual, Appendix C p. 42 to 50; TC-48-20 manual, Appendix B p. 48 to 54.

    TC-36-25   request  *  address(2)  code(2)  data(8)  sum(2)  CR       reply  *  data(8)  sum(2)  ^
               short    *  address(2)  code(2)           sum(2)  CR       (reads only)
    TC-48-20   request  *              code(2)  data(4)  sum(2)  CR       reply  *  data(4)  sum(2)  ^
               read     *              code(2)           sum(2)  CR

All numbers are lower-case hexadecimal, data in two's complement. The sum is the low 8 bits of the sum of the characters
between `*` and itself. Nothing in a reply says which request it answers.
"""

from __future__ import annotations

from dataclasses import dataclass

DIGITS = frozenset(b"0123456789abcdef")


@dataclass(frozen=True, slots=True)
class Framing:
    """A model's frames: digits of the data; whether a request has an address."""

    digits: int
    has_address: bool

    def bad_sum(self) -> bytes:
        """The reply to a request whose sum is wrong: `*XXXXXXXXc0^` or `*XXXX60^`."""
        return _frame(b"X" * self.digits)

    def reply(self, value: int) -> bytes:
        """The reply with a value."""
        return _frame(b"%0*x" % (self.digits, value & (16**self.digits - 1)))

    def request(self, line: bytes) -> tuple[bytes, bytes, int | None] | None:
        """Address, code and value (None in a short read) of what stood between `*` and the end; None: not valid.

        That a wrong length is met like a wrong sum is an assumption.
        """
        head = 4 if self.has_address else 2
        body = line[:-2]
        if len(body) not in (head, head + self.digits) or not DIGITS.issuperset(line):
            return None
        if b"%02x" % (sum(body) & 0xFF) != line[-2:]:
            return None
        data = body[head:]
        return body[: head - 2] or b"00", body[head - 2 : head], _value(data) if data else None


TC_36_25 = Framing(digits=8, has_address=True)
TC_48_20 = Framing(digits=4, has_address=False)


def _frame(data: bytes) -> bytes:
    return b"*%b%02x^" % (data, sum(data) & 0xFF)


def _value(data: bytes) -> int:
    value = int(data, 16)
    return value - 16 ** len(data) if value >= 16 ** len(data) // 2 else value
