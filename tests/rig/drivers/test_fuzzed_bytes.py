"""Whatever bytes come down the wire, emulators and drivers live: a reading or an error of the one tree, in time."""

from __future__ import annotations

import itertools
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rig.core.clock import VirtualClock
from rig.core.errors import InstrumentError
from rig.core.reading import Reading
from rig.drivers.registry import open_controller, open_meter
from rig.ports import protocol_sim
from sim.instruments.instrument import Instrument, emulated
from tests.rig.drivers.far_ends import Answering
from tests.rig.drivers.still_plant import StillPlant
from tests.rig.drivers.wire_cases import CONTROLLERS, METERS, Case

FEW = settings(max_examples=15, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
KINDS = [b"*#!^\r\n;:? ", b"0123456789abcdefABCDEF+-.,E", b"READFTCHISNOUPVLMX*\"'\x03\x18\x00\xff\xb2\xb3\xb9"]
noise = st.lists(
    st.one_of(
        st.binary(max_size=40), *(st.lists(st.sampled_from(list(kind)), max_size=30).map(bytes) for kind in KINDS)
    ),
    max_size=12,
)
_numbers = itertools.count()


def emulator_of(case: Case) -> Any:
    return emulated(case.driver, StillPlant(), **case.emulator)


def driver_on(case: Case, instrument: Instrument, clock: VirtualClock) -> tuple[Any, str]:
    name = f"fuzz-{next(_numbers)}"
    address = protocol_sim.register(name, instrument, clock)
    opener = open_meter if case.meter else open_controller
    return opener(case.driver, address, clock, **case.options, first_token=1), name


@pytest.mark.parametrize("case", CONTROLLERS + METERS, ids=str)
@given(pieces=noise)
@FEW
def test_emulators_live(case: Case, pieces: list[bytes]) -> None:
    emulator, clock = emulator_of(case), VirtualClock()
    time_s = 0.0
    for piece in pieces:
        emulator.receive(piece, time_s)
        time_s += 0.05
        emulator.transmit(time_s)
        due_s = emulator.next_transmit_s()
        assert due_s is None or due_s >= 0.0
    clock.sleep_until_s(time_s + 30.0)
    driver, name = driver_on(case, emulator, clock)
    try:
        driver.identify()  # and still answers
    finally:
        protocol_sim.unregister(name)


def test_digits_that_are_none() -> None:
    """Superscripts are digits to Python, and no numbers."""
    for case in CONTROLLERS + METERS:
        emulator = emulator_of(case)
        for text in (b"TMOD \xb3", b"*ESE 3\xb3", b"TCUR \xb2", b"TERM \xb9", b":SENS:FRES:NPLC \xb2"):
            emulator.receive(text + b"\r\n", 0.0)
        emulator.transmit(5.0)


class Babbler(Answering):
    """Answers every request with the next of some pieces."""

    def __init__(self, pieces: list[bytes]) -> None:
        super().__init__()
        self._pieces = iter(itertools.cycle(pieces or [b""]))

    def receive(self, data: bytes, time_s: float) -> None:
        self.answer(time_s + 0.004, next(self._pieces))


@pytest.mark.parametrize("case", CONTROLLERS + METERS, ids=str)
@given(pieces=noise)
@FEW
def test_drivers_live(case: Case, pieces: list[bytes]) -> None:
    clock = VirtualClock()
    driver, name = driver_on(case, Babbler(pieces), clock)
    calls: list[Any] = (
        [driver.identify, driver.read]
        if case.meter
        else [driver.identify, driver.read_temperature, driver.status, driver.own_limits, driver.read_current]
    )
    try:
        for call in calls:
            begin_s = clock.now_s()
            try:
                found = call()
            except InstrumentError:
                pass
            else:
                assert not isinstance(found, Reading) or found.value == found.value or not found.is_number
            assert clock.now_s() - begin_s < 60.0
        assert driver.off() is False
        driver.close()
    finally:
        protocol_sim.unregister(name)
