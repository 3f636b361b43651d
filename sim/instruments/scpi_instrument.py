"""A SCPI instrument at the end of a serial line: bytes in, messages in turn, answers out, an error queue.

Source: IEEE 488.2-1992 (one answer line for the questions of one message, joined with `;`), SCPI-1999 volume 2,
21.8 (error queue). What the commands do is in the instruments that build on this.

A message acts `command_s` after its terminator (CR, LF or both) has arrived; messages wait while one of them waits
for a measurement. An error drops the rest of its message.
"""

from __future__ import annotations

from collections import deque
from math import inf
from typing import ClassVar

from sim.instruments.instrument import Plant
from sim.instruments.scpi import Call, CommandTree, ScpiError
from sim.instruments.serial_line import SerialLine

LONGEST_MESSAGE = 2048  # characters that its buffer holds; more are lost


class ScpiInstrument(SerialLine):
    """What all of them share. byte_s: time of one character on the wire, s; 0 takes no time.

    The class attributes say which characters abort, how the error queue speaks, and whether an error drops the rest.
    """

    ABORTS: ClassVar[tuple[bytes, ...]] = (b"\x03", b"\x18")
    QUEUE_LENGTH: ClassVar[int] = 10
    QUEUE_OVERFLOW: ClassVar[str] = '350,"Queue Overflow"'
    NO_ERROR: ClassVar[str] = '0,"No error"'
    DROPS_REST: ClassVar[bool] = True

    def __init__(self, plant: Plant, *, byte_s: float, terminator: bytes, command_s: float, start_s: float) -> None:
        super().__init__(plant)
        self._byte_s = byte_s
        self._terminator = terminator
        self._command_s = command_s
        # the line
        self._messages: deque[tuple[float, str]] = deque()
        self._receiving_until_s = self._sending_until_s = start_s
        # the message at work
        self._calls: deque[Call] = deque()
        self._answers: list[str] = []
        self._waiting = False
        self._free_s = start_s
        self._ready_s = start_s
        self._now_s = start_s
        self._tree = CommandTree()
        self.errors: deque[str] = deque()

    # ---- the line -------------------------------------------------------------------------------

    def receive(self, data: bytes, time_s: float) -> None:
        """See `Instrument.receive`."""
        for character in self.ABORTS:
            if character in data:
                self._device_clear()
                data = data[data.rfind(character) + 1 :]
        arrival_s = max(time_s, self._receiving_until_s) + len(data) * self._byte_s
        self._receiving_until_s = arrival_s
        lines = (self._partial + data).replace(b"\n", b"\r").split(b"\r")
        self._partial = lines.pop()[-LONGEST_MESSAGE:]
        for line in lines:
            if line:
                self._messages.append((arrival_s + self._command_s, line.decode("latin-1")))
                self._plant.schedule(arrival_s + self._command_s, self._work)

    def _next_reply_s(self) -> float | None:
        if self._waiting:
            return self._ready_s
        if self._calls:
            return self._free_s
        return self._messages[0][0] if self._messages else None

    def _device_clear(self) -> None:
        self._partial = b""
        self._messages.clear()
        self._replies.clear()
        self._calls.clear()
        self._answers.clear()
        self.abort()
        self._free_s = self._sending_until_s = self._receiving_until_s = -inf

    def abort(self) -> None:
        """Back to idle, without a reading."""
        self._waiting = False

    # ---- messages -------------------------------------------------------------------------------

    def _work(self, time_s: float) -> None:
        """Go on with what has arrived, as far as it can be done at `time_s`."""
        self._now_s = time_s
        while not self._waiting:
            if time_s < self._free_s:
                if self._calls or self._messages:
                    self._plant.schedule(self._free_s, self._work)
                return
            if self._calls:
                self._run(self._calls.popleft())
            elif self._messages and self._messages[0][0] <= time_s:
                self._calls.extend(self._tree.parse(self._messages.popleft()[1]))
            else:
                return
            if not (self._calls or self._waiting):
                self._reply(time_s)

    def _run(self, call: Call) -> None:
        try:
            answer = call()
        except ScpiError as error:
            self.push_error(str(error))
            if self.DROPS_REST:
                self._calls.clear()
            return
        if answer is not None:
            self._answers.append(answer)

    def _reply(self, time_s: float) -> None:
        if self._answers:
            text = ";".join(self._answers).encode("latin-1") + self._terminator
            self._answers.clear()
            due_s = max(time_s, self._sending_until_s) + len(text) * self._byte_s
            self._sending_until_s = due_s
            self._replies.append((due_s, text))

    # ---- errors ---------------------------------------------------------------------------------

    def push_error(self, text: str) -> None:
        """Into the error queue; what no longer fits replaces the last entry by an overflow."""
        if len(self.errors) < self.QUEUE_LENGTH:
            self.errors.append(text)
        else:
            self.errors[-1] = self.QUEUE_OVERFLOW

    def next_error(self) -> str:
        """The oldest entry of the error queue, which loses it."""
        return self.errors.popleft() if self.errors else self.NO_ERROR
