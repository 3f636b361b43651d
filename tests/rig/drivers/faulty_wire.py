"""A bad cable: bytes arrive late, in pieces, twice, garbled, or not at all. Deterministic by seed.

What is under way keeps its order, as on a wire; only `stale` and `foreign` bring bytes that no wire would.
"""

from __future__ import annotations

import random
from collections import deque

from sim.instruments.instrument import Instrument

REPLY_FAULTS = (
    "late",
    "split",
    "stale",
    "repeated",
    "glued",
    "lost",
    "foreign",
    "garbage",
    "flipped",
    "short",
)
REQUEST_FAULTS = ("request lost", "request garbled")


CORRUPTION = ("garbage", "flipped", "short", "request garbled")
DISORDER = tuple(fault for fault in REPLY_FAULTS + REQUEST_FAULTS if fault not in CORRUPTION)


class FaultyWire:
    """Wraps `instrument`. `rate`: of replies, and of requests, that are hurt. `foreign`: others' traffic.

    late_s: delays of a late reply, s. longest_burst: characters in a row that a corruption changes.
    """

    def __init__(
        self,
        instrument: Instrument,
        *,
        seed: int,
        rate: float,
        foreign: bytes,
        faults: tuple[str, ...] = REPLY_FAULTS + REQUEST_FAULTS,
        late_s: tuple[float, ...] = (0.05, 0.2, 0.7, 2.0),
        longest_burst: int = 3,
    ) -> None:
        self.instrument = instrument
        self._random = random.Random(seed)
        self.rate = rate
        self._foreign = foreign
        self._late_s, self._longest_burst = late_s, longest_burst
        self._reply_faults = [fault for fault in faults if fault in REPLY_FAULTS]
        self._request_faults = [fault for fault in faults if fault in REQUEST_FAULTS]
        self._under_way: list[tuple[float, bytes]] = []
        self._history: deque[bytes] = deque(maxlen=21)
        self.counts: dict[str, int] = {}

    def receive(self, data: bytes, time_s: float) -> None:
        if self._request_faults and self._random.random() < self.rate:
            fault = self._pick(self._request_faults)
            if fault == "request lost":
                return
            data = self.garble(data)
        self.instrument.receive(data, time_s)

    def transmit(self, time_s: float) -> bytes:
        data = self.instrument.transmit(time_s)
        if data:
            self._damage(data, time_s)
        ready = b""
        while self._under_way and self._under_way[0][0] <= time_s:
            ready += self._under_way.pop(0)[1]
        return ready

    def next_transmit_s(self) -> float | None:
        due = [self.instrument.next_transmit_s()] + [when for when, _ in self._under_way[:1]]
        return min((when for when in due if when is not None), default=None)

    def _pick(self, faults: list[str]) -> str:
        fault = self._random.choice(faults)
        self.counts[fault] = self.counts.get(fault, 0) + 1
        return fault

    def _damage(self, data: bytes, time_s: float) -> None:
        self._history.append(data)
        chance = self._random
        if not self._reply_faults or chance.random() >= self.rate:
            self._send(time_s, data)
            return
        fault = self._pick(self._reply_faults)
        cut = chance.randrange(len(data) + 1)
        if fault == "late":
            self._send(time_s + chance.choice(self._late_s), data)
        elif fault == "split":
            self._send(time_s, data[:cut])
            self._send(time_s + chance.choice((0.001, 0.03, 0.2, 1.0)), data[cut:])
        elif fault == "stale":
            self._send(time_s, chance.choice(self._history))
            self._send(time_s + chance.choice((0.0, 0.01, 0.3)), data)
        elif fault == "repeated":
            self._send(time_s, data)
            self._send(time_s + chance.choice((0.0, 0.001, 0.02, 0.12, 0.5)), data)
        elif fault == "glued":
            self._send(time_s + 0.3, data)  # arrives together with the next one
        elif fault == "foreign":
            self._send(time_s, self._foreign + data)
        elif fault == "garbage":
            noise = chance.randbytes(chance.randrange(1, 12))
            self._send(time_s, data[:cut] + noise + data[cut:])
        elif fault == "flipped":
            self._send(time_s, self.garble(data))
        elif fault == "short":
            self._send(time_s, data[:cut] + data[cut + 1 :])

    def garble(self, data: bytes) -> bytes:
        """A burst: one to three bytes in a row become something else, likely of the same kind."""
        hurt = bytearray(data)
        begin = self._random.randrange(len(hurt))
        for place in range(begin, min(begin + self._random.randrange(1, self._longest_burst + 1), len(hurt))):
            hurt[place] = self._random.choice(
                (*b"0123456789ABCDEF+-.;", hurt[place] ^ (1 << self._random.randrange(8)))
            )
        return bytes(hurt)

    def _send(self, time_s: float, data: bytes) -> None:
        if data:
            latest_s = self._under_way[-1][0] if self._under_way else time_s
            self._under_way.append((max(time_s, latest_s), data))
