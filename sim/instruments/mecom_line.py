"""The line of a device that speaks MeCom: requests on their way, each answered when its last character has arrived."""

from __future__ import annotations

from collections import deque

from sim.instruments import mecom
from sim.instruments.instrument import Plant
from sim.instruments.serial_line import SerialLine

LONGEST_PARTIAL = 256  # bytes that are kept of a line without an end: five times the longest request
REPLY_LENGTH = {True: 20, False: 12}  # characters, by whether something is read


class MeComLine(SerialLine):
    """baudrate: of the line, 1/s; inf takes no time. response_s: from a request's last character to its reply's first.

    The device is asked by `_reply_to`, and how much later than `response_s` it begins to reply by `_later_s`.
    """

    def __init__(self, plant: Plant, *, baudrate: float, response_s: float, start_s: float) -> None:
        super().__init__(plant)
        self._byte_s = 10.0 / baudrate  # start bit, eight bits, stop bit
        self._response_s = response_s
        self._requests: deque[tuple[tuple[bytes, bytes, bytes], float]] = deque()
        self._receiving_until_s = self._sending_until_s = start_s

    def receive(self, data: bytes, time_s: float) -> None:
        """See `Instrument.receive`."""
        lines = (self._partial + data).split(b"\r")
        self._partial = lines.pop()[-LONGEST_PARTIAL:]
        arrival_s = max(time_s, self._receiving_until_s) + len(data) * self._byte_s
        self._receiving_until_s = arrival_s
        for line in lines:
            request = mecom.request(line)
            if request is None:
                continue
            length = REPLY_LENGTH[request[1][:1] == b"?"]
            begin_s = max(arrival_s + self._response_s + self._later_s(), self._sending_until_s)
            self._sending_until_s = due_s = begin_s + length * self._byte_s
            self._requests.append((request, due_s))
            self._plant.schedule(arrival_s, self._act)

    def _next_reply_s(self) -> float | None:
        return self._requests[0][1] if self._requests else None

    def _act(self, time_s: float) -> None:
        request, due_s = self._requests.popleft()
        reply = self._reply_to(*request, time_s)
        if reply:
            self._replies.append((due_s, reply))

    def _later_s(self) -> float:
        raise NotImplementedError

    def _reply_to(self, head: bytes, payload: bytes, crc: bytes, time_s: float) -> bytes:
        """The reply's frame; empty where the device is silent."""
        raise NotImplementedError
