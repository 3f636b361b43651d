"""A scripted instrument: it expects certain bytes, gives certain answers, and nothing may be left over."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from rig.core.clock import VirtualClock
from rig.drivers import registry
from sim.instruments.instrument import Instrument


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
