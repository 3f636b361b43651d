"""MeCom from the host's side: a question, and the proof that an answer belongs to it.

Source: Meerstetter "MeCom Protocol Specification" 5117C, and the receiver's rule in Meerstetter's own C code.

Every new command gets the next sequence number (random at first); a command that is sent again after
silence keeps its number. An answer counts if address, sequence number and CRC are right; for a set it must
also carry the CRC of that set. Anything else on the line is skipped, so late, foreign, repeated and garbled
frames cost time but never a value.
"""

from __future__ import annotations

import contextlib
import random
import struct
from binascii import crc_hqx, unhexlify
from collections.abc import Iterator
from math import isfinite

from rig.core.errors import Corrupt, Refused, TimedOut
from rig.ports.transport import Transport

TRIALS = 3  # one frame may be hurt, and its repetition by the same disturbance
TRIAL_S = 0.1  # beyond the time on the wire
PATIENT_S = 0.6  # the same while nothing is controlled yet: an adapter may hand over half an answer 0.4 s late
LONGEST_FRAME = 40
MEANINGS = {
    1: "command unknown",
    2: "device busy",
    3: "general error",
    4: "format error",
    5: "parameter unknown",
    6: "parameter is read-only",
    7: "value out of range",
    8: "instance unknown",
    9: "parameter failure",
}

_float32 = struct.Struct(">f")
_int32 = struct.Struct(">i")


class MecomLink:
    """One device. address: its own, or 0 for whichever is on the line. baudrate: of the line, 1/s."""

    def __init__(
        self,
        transport: Transport,
        *,
        address: int = 0,
        instance: int = 1,
        baudrate: float = 57600.0,
        first_sequence: int | None = None,
        trial_s: float = TRIAL_S,
    ) -> None:
        if not 0 <= address <= 254:
            raise ValueError(f"a MeCom address is 0..254, not {address}")
        if not 1 <= instance <= 255:
            raise ValueError(f"an instance of a MeCom device is 1..255, not {instance}")
        self.transport = transport
        self._address = b"%02X" % address
        self.instance = b"%02X" % instance
        self._sequence = random.randrange(0x10000) if first_sequence is None else first_sequence
        self._trial_s = trial_s + 2 * LONGEST_FRAME * 10.0 / baudrate
        self._byte_s = 10.0 / baudrate
        self._read_payloads: dict[int, bytes] = {}
        self.sent_s = 0.0

    @contextlib.contextmanager
    def patiently(self) -> Iterator[None]:
        """Wait longer for each answer, inside this context: for a start, and never while something is controlled."""
        before, self._trial_s = self._trial_s, self._trial_s + PATIENT_S - TRIAL_S
        try:
            yield
        finally:
            self._trial_s = before

    def shout(self, payload: bytes) -> None:
        """Send a command at once; nobody waits for its acknowledgement."""
        self._sequence = (self._sequence + 1) & 0xFFFF
        body = b"#%b%04X%b" % (self._address, self._sequence, payload)
        self.transport.send(body + b"%04X\r" % crc_hqx(body, 0))

    def shout_int(self, parameter: int, value: int) -> None:
        """Set an INT32 parameter; nobody waits."""
        self.shout(b"VS%04X%b%08X" % (parameter, self.instance, value & 0xFFFFFFFF))

    def query(self, payload: bytes, trials: int = TRIALS) -> bytes:
        """The data that answer `payload`. TimedOut, Corrupt (all trials garbled), Refused, Disconnected."""
        return self._exchange(payload, False, trials)

    def command(self, payload: bytes, trials: int = TRIALS) -> None:
        """Send a command that is acknowledged. Errors as `query`."""
        self._exchange(payload, True, trials)

    def read_float(self, parameter: int, trials: int = TRIALS) -> float:
        """A FLOAT32 parameter, in its unit; nan is possible."""
        value: float = _float32.unpack(self._read(parameter, trials))[0]
        return value

    def read_int(self, parameter: int, trials: int = TRIALS) -> int:
        """An INT32 parameter."""
        value: int = _int32.unpack(self._read(parameter, trials))[0]
        return value

    def write_float(self, parameter: int, value: float, trials: int = TRIALS) -> None:
        """Set a FLOAT32 parameter; nan and what does not fit are a ValueError."""
        if not isfinite(value):
            raise ValueError(f"parameter {parameter} cannot be set to {value}")
        try:
            text = _float32.pack(value).hex().upper()
        except OverflowError:
            raise ValueError(f"parameter {parameter}: {value} does not fit into a FLOAT32") from None
        self._exchange(b"VS%04X%b%b" % (parameter, self.instance, text.encode()), True, trials)

    def write_int(self, parameter: int, value: int, trials: int = TRIALS) -> None:
        """Set an INT32 parameter; what does not fit is a ValueError."""
        if not -0x80000000 <= value <= 0x7FFFFFFF:
            raise ValueError(f"parameter {parameter}: {value} does not fit into an INT32")
        self._exchange(b"VS%04X%b%08X" % (parameter, self.instance, value & 0xFFFFFFFF), True, trials)

    def _read(self, parameter: int, trials: int) -> bytes:
        payload = self._read_payloads.get(parameter)
        if payload is None:
            payload = self._read_payloads[parameter] = b"?VR%04X%b" % (parameter, self.instance)
        text = self._exchange(payload, False, trials)
        try:
            if len(text) != 8:
                raise ValueError
            return unhexlify(text)
        except ValueError:
            raise Corrupt(f"parameter {parameter}: {text!r} is no 32-bit value") from None

    def _exchange(self, payload: bytes, is_set: bool, trials: int) -> bytes:
        self._sequence = (self._sequence + 1) & 0xFFFF
        body = b"#%b%04X%b" % (self._address, self._sequence, payload)
        crc = b"%04X" % crc_hqx(body, 0)
        frame = body + crc + b"\r"
        head = b"!" + body[1:7]
        transport = self.transport
        clock = transport.clock
        garbled = 0
        for _ in range(trials):
            transport.send(frame)
            sent_s = clock.now_s()
            deadline_s = sent_s + self._trial_s
            self.sent_s = sent_s + len(frame) * self._byte_s
            try:
                while True:
                    line = transport.receive_line(b"\r", deadline_s)
                    start = line.rfind(b"!")
                    if start:
                        line = line[start:] if start > 0 else b""
                    if len(line) == 11:
                        if is_set and line == head + crc:
                            return b""
                        continue
                    if crc_hqx(line[:-4], 0) != _number(line[-4:]) or len(line) < 11:
                        garbled += 1
                        continue
                    if line[:7] != head and not self._is_broadcast_answer(line, head):
                        continue
                    answer = line[7:-4]
                    if answer[:1] == b"+":
                        code = _number(answer[1:])
                        raise Refused(code, MEANINGS.get(code, "device error") + f": {payload.decode()}")
                    if not is_set:
                        return answer
            except TimedOut:
                continue
        if garbled:
            raise Corrupt(transport.told(f"{garbled} garbled frames and no answer to {payload.decode()}"))
        expected = f"expected one within {self._trial_s:.2g} s of one of {trials} trials"
        raise TimedOut(transport.told(f"no answer to {payload.decode()}; {expected}"))

    def _is_broadcast_answer(self, line: bytes, head: bytes) -> bool:
        """To address 0 a device answers with 00 or, by the specification's prose, with its own."""
        return self._address == b"00" and line[3:7] == head[3:7] and line[:1] == b"!"


def _number(text: bytes) -> int:
    """Value of hexadecimal digits; -1 where they are not."""
    try:
        return int.from_bytes(unhexlify(text), "big")
    except ValueError:
        return -1
