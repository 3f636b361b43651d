"""The far end of a line in tests: something that answers, something mute, a script; and a host for an emulator."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from rig.core.clock import VirtualClock
from rig.drivers import registry
from sim.instruments.instrument import Instrument


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


class Wrapped:
    """An instrument as it is; what a subclass does otherwise is what is wrong with it."""

    def __init__(self, instrument: Any) -> None:
        self.instrument = instrument

    def receive(self, data: bytes, time_s: float) -> None:
        self.instrument.receive(data, time_s)

    def transmit(self, time_s: float) -> bytes:
        data: bytes = self.instrument.transmit(time_s)
        return data

    def next_transmit_s(self) -> float | None:
        due: float | None = self.instrument.next_transmit_s()
        return due


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


class Conversation:
    """An `Instrument` that plays a transcript of (expected request, reply), `delay_s` after each request."""

    def __init__(self, transcript: Sequence[tuple[bytes, bytes]], delay_s: float = 0.001) -> None:
        self._transcript = list(transcript)
        self._delay_s = delay_s
        self._received = b""
        self._replies: list[tuple[float, bytes]] = []

    def receive(self, data: bytes, time_s: float) -> None:
        self._received += data
        while self._transcript and len(self._received) >= len(self._transcript[0][0]):
            expected, reply = self._transcript.pop(0)
            request, self._received = self._received[: len(expected)], self._received[len(expected) :]
            assert request == expected
            if reply:
                self._replies.append((time_s + self._delay_s, reply))

    def transmit(self, time_s: float) -> bytes:
        due = [reply for due_s, reply in self._replies if due_s <= time_s]
        self._replies = [entry for entry in self._replies if entry[0] > time_s]
        return b"".join(due)

    def next_transmit_s(self) -> float | None:
        return self._replies[0][0] if self._replies else None

    def assert_over(self) -> None:
        """Every line was spoken, and nothing else."""
        assert not self._transcript
        assert self._received == b""
        assert not self._replies


def scripted(
    name: str,
    attach: Callable[[Instrument], str],
    clock: VirtualClock,
    transcript: Sequence[tuple[bytes, bytes]],
    first_token: int = 7,
    **options: Any,
) -> tuple[Any, Conversation]:
    """A driver by its name whose instrument is such a conversation, and the conversation."""
    conversation = Conversation(transcript)
    open_one = registry.open_controller if name in registry.CONTROLLERS else registry.open_meter
    return open_one(name, attach(conversation), clock, first_token=first_token, **options), conversation
