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
    """Speaks to one emulated instrument and keeps the time; patience_s: from a message to its answer."""

    def __init__(self, instrument: Any, end: bytes = b"\r", patience_s: float = 2.0) -> None:
        self.instrument, self._end, self._patience_s = instrument, end, patience_s
        self.time_s = 0.0

    def say(self, message: str, patience_s: float | None = None, end: bytes | None = None) -> str:
        self.instrument.receive(message.encode("latin-1") + (self._end if end is None else end), self.time_s)
        self.wait(self._patience_s if patience_s is None else patience_s)
        return str(self.instrument.transmit(self.time_s).decode("latin-1").rstrip("\r\n"))

    def wait(self, duration_s: float) -> None:
        self.time_s += duration_s
        self.instrument._plant.advance_to(self.time_s)
