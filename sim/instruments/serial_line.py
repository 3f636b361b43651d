"""The sending half of an emulated instrument: replies on their way, each with the time at which the host has it."""

from __future__ import annotations

from collections import deque

from sim.instruments.instrument import Plant


class SerialLine:
    """What every emulator has. Its `receive`, and when work under way will reply, are its own."""

    def __init__(self, plant: Plant) -> None:
        self._plant = plant
        self._partial = b""
        self._replies: deque[tuple[float, bytes]] = deque()

    def transmit(self, time_s: float) -> bytes:
        """See `Instrument.transmit`."""
        self._plant.advance_to(time_s)
        replies = self._replies
        if not replies or replies[0][0] > time_s:
            return b""
        data = replies.popleft()[1]
        while replies and replies[0][0] <= time_s:
            data += replies.popleft()[1]
        return data

    def next_transmit_s(self) -> float | None:
        """See `Instrument.next_transmit_s`."""
        return self._replies[0][0] if self._replies else self._next_reply_s()

    def _next_reply_s(self) -> float | None:
        """When the work under way will have a reply, s; None where there is none."""
        raise NotImplementedError
