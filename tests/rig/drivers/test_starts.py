"""A start over a line that hiccups once: one reply in two halves, 0.4 s apart, and the start is done all the same."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from rig.core.clock import VirtualClock
from rig.drivers.registry import open_controller, open_meter
from sim.instruments.instrument import Instrument, emulated
from tests.rig.drivers.still_plant import StillPlant
from tests.rig.drivers.wire_cases import CONTROLLERS, METERS, Case

Attach = Callable[[Instrument], str]
LATE_S = 0.4


class OneHalfLate:
    """A wire that hands over the second half of one reply late; what comes behind it waits."""

    def __init__(self, instrument: Instrument, number: int) -> None:
        self._instrument, self._number = instrument, number
        self.replies = 0
        self._under_way: list[tuple[float, bytes]] = []

    def receive(self, data: bytes, time_s: float) -> None:
        self._instrument.receive(data, time_s)

    def transmit(self, time_s: float) -> bytes:
        data = self._instrument.transmit(time_s)
        if data:
            latest_s = self._under_way[-1][0] if self._under_way else time_s
            if self.replies == self._number:
                half = len(data) // 2
                self._under_way += [(time_s, data[:half]), (time_s + LATE_S, data[half:])]
            else:
                self._under_way.append((max(time_s, latest_s), data))
            self.replies += 1
        ready = b"".join(piece for due_s, piece in self._under_way if due_s <= time_s)
        self._under_way = [entry for entry in self._under_way if entry[0] > time_s]
        return ready

    def next_transmit_s(self) -> float | None:
        due = [self._instrument.next_transmit_s()] + [due_s for due_s, _ in self._under_way[:1]]
        return min((due_s for due_s in due if due_s is not None), default=None)


def start_controller(attach: Attach, clock: VirtualClock, case: Case, number: int) -> int:
    """As a bench is opened: off, who is it, limits. Returns how many replies there were."""
    emulator = emulated(case.driver, StillPlant(), **case.emulator)
    wire = OneHalfLate(emulator, number)
    controller = open_controller(case.driver, attach(wire), clock, **case.options, first_token=7)
    assert controller.off()
    controller.identify()
    controller.configure(1.0, (10.0, 95.0), 5.0)
    assert getattr(emulator, "status_until_reset", None) is None  # no emergency stop
    controller.close()
    return wire.replies


def start_meter(attach: Attach, clock: VirtualClock, case: Case, number: int) -> int:
    wire = OneHalfLate(emulated(case.driver, StillPlant(), **case.emulator), number)
    meter = open_meter(case.driver, attach(wire), clock, **case.options, first_token=7)
    meter.identify()
    meter.configure(True, 1.0, 1e-3)
    meter.transport.close()
    return wire.replies


@pytest.mark.parametrize("case", [*CONTROLLERS, *METERS], ids=str)
def test_one_reply_in_two_halves_ends_no_start(attach: Attach, clock: VirtualClock, case: Case) -> None:
    start = start_meter if case.meter else start_controller
    replies = start(attach, clock, case, -1)
    assert replies > 3
    for number in range(replies):
        start(attach, clock, case, number)
