"""What stands at the far end of a line in tests: something that answers, something mute; and a host for an emulator."""

from __future__ import annotations

from typing import Any


class Answering:
    """An `Instrument` that puts its answers with `answer`; what it is told is up to `receive`."""

    def __init__(self) -> None:
        self._due: list[tuple[float, bytes]] = []

    def answer(self, due_s: float, data: bytes) -> None:
        self._due.append((due_s, data))

    def receive(self, data: bytes, time_s: float) -> None:
        """Mute, unless somebody says otherwise."""

    def transmit(self, time_s: float) -> bytes:
        ready = b"".join(data for due_s, data in self._due if due_s <= time_s)
        self._due = [entry for entry in self._due if entry[0] > time_s]
        return ready

    def next_transmit_s(self) -> float | None:
        return self._due[0][0] if self._due else None


class Host:
    """Speaks to one emulated meter and keeps the time."""

    def __init__(self, meter: Any, end: bytes = b"\r") -> None:
        self.meter, self._end = meter, end
        self.time_s = 0.0

    def say(self, message: str, patience_s: float = 2.0, end: bytes | None = None) -> str:
        self.meter.receive(message.encode() + (self._end if end is None else end), self.time_s)
        self.time_s += patience_s
        return str(self.meter.transmit(self.time_s).decode().rstrip("\r\n"))
