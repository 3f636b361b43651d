"""Whatever the line does: a number was read after its question, off is off, a start comes about, nothing hangs."""

from __future__ import annotations

import itertools
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from rig.core.clock import VirtualClock
from rig.core.errors import Disconnected, InstrumentError, TimedOut
from rig.core.reading import Reading
from rig.drivers.controller import OFF_S
from rig.drivers.registry import open_controller, open_meter
from rig.ports import protocol_sim
from sim.instruments.instrument import Instrument, emulated
from tests.rig.drivers.far_ends import Answering
from tests.rig.drivers.faulty_wire import REPLY_FAULTS, REQUEST_FAULTS, FaultyWire
from tests.rig.drivers.still_plant import StillPlant
from tests.rig.drivers.wire_cases import CONTROLLERS, METERS, Attach, Case, exchange, on_wire

# ---- faults of a wire -------------------------------------------------------------------------------


EVERY_FAULT = [*[(fault,) for fault in REPLY_FAULTS + REQUEST_FAULTS], REPLY_FAULTS + REQUEST_FAULTS]
EXCHANGES = 400
SEEDS = [0, *(pytest.param(seed, marks=pytest.mark.long) for seed in (1, 2))]  # each fault and driver with one


@pytest.mark.parametrize("case", CONTROLLERS + METERS, ids=str)
@pytest.mark.parametrize("faults", EVERY_FAULT, ids=lambda faults: faults[0] if len(faults) == 1 else "all")
@pytest.mark.parametrize("seed", SEEDS)
def test_no_number_is_wrong(faults: tuple[str, ...], seed: int, case: Case) -> None:
    """Whoever trusts a number heats by it."""
    tally, wrong = exchange(case, seed, faults, EXCHANGES)
    assert wrong == []
    assert tally.right > EXCHANGES / 4
    assert tally.faults > EXCHANGES / 20


@pytest.mark.parametrize("case", CONTROLLERS, ids=str)
@pytest.mark.parametrize("seed", range(20))
def test_output_that_is_reported_off_is_off(clock: VirtualClock, attach: Attach, seed: int, case: Case) -> None:
    plant = StillPlant()
    controller, wire = on_wire(attach, clock, case, plant, seed, REPLY_FAULTS + REQUEST_FAULTS)
    if controller.commands_current:
        controller.set_current_A(case.strong)
    else:
        controller.set_setpoint_degC(40.0)
    clock.sleep_until_s(clock.now_s() + 0.2)
    wire.transmit(clock.now_s())
    assert plant.current_A > 1.0
    wire.rate = 0.5
    if controller.off():
        assert plant.current_A == 0.0
    wire.rate = 0.0
    clock.sleep_until_s(clock.now_s() + 10.0)  # for what is still under way
    assert controller.off()
    assert plant.current_A == 0.0


@pytest.mark.parametrize("case", METERS, ids=str)
@pytest.mark.parametrize("seed", range(10))
def test_test_current_that_is_reported_off_is_off(clock: VirtualClock, attach: Attach, seed: int, case: Case) -> None:
    plant = StillPlant()
    meter, wire = on_wire(attach, clock, case, plant, seed, REPLY_FAULTS + REQUEST_FAULTS)
    meter.read()
    wire.rate = 0.5
    if meter.off():
        assert plant.test_current_A == 0.0
    wire.rate = 0.0
    clock.sleep_until_s(clock.now_s() + 10.0)
    assert meter.off()
    assert plant.test_current_A == 0.0


# ---- off whatever happens ---------------------------------------------------------------------------


@pytest.mark.parametrize("case", CONTROLLERS, ids=str)
def test_a_silent_device(attach: Attach, clock: VirtualClock, case: Case) -> None:
    controller = open_controller(case.driver, attach(Answering()), clock, **case.options)
    with pytest.raises(TimedOut):
        controller.read_temperature()
    begin_s = clock.now_s()
    assert controller.off() is False
    assert clock.now_s() - begin_s < OFF_S + 0.15  # with one time-out more, as docs/safety.md says


@pytest.mark.parametrize("case", CONTROLLERS, ids=str)
def test_an_unplugged_device(attach: Attach, clock: VirtualClock, plant: StillPlant, case: Case) -> None:
    controller, wire = on_wire(attach, clock, case, plant, 1, ())
    if controller.commands_current:
        controller.set_current_A(case.strong)
    protocol_sim.unregister("test-0")
    with pytest.raises(Disconnected):
        controller.read_temperature()
    assert controller.off() is False
    protocol_sim.register("test-0", wire, clock)
    assert controller.off() is True
    assert plant.current_A == 0.0


@pytest.mark.parametrize("case", CONTROLLERS, ids=str)
def test_a_closed_port(attach: Attach, clock: VirtualClock, plant: StillPlant, case: Case) -> None:
    controller, _ = on_wire(attach, clock, case, plant, 1, ())
    if controller.commands_current:
        controller.set_current_A(case.strong)
    controller.close()
    controller.close()
    assert controller.off() is True
    assert plant.current_A == 0.0


# ---- a start over a line that hiccups once ----------------------------------------------------------


SECOND_HALF_S = 0.4


class OneHalfLate(FaultyWire):
    """A wire that hands over the second half of one reply late; what comes behind it waits."""

    def __init__(self, instrument: Instrument, number: int) -> None:
        super().__init__(instrument, seed=0, rate=0.0, foreign=b"", faults=())
        self._number, self.replies = number, 0

    def _damage(self, data: bytes, time_s: float) -> None:
        half = len(data) // 2 if self.replies == self._number else len(data)
        self._send(time_s, data[:half])
        self._send(time_s + SECOND_HALF_S, data[half:])
        self.replies += 1


def start(attach: Attach, clock: VirtualClock, case: Case, number: int) -> int:
    """As a bench is opened: off, who is it, limits. Returns how many replies there were."""
    emulator = emulated(case.driver, StillPlant(), **case.emulator)
    wire = OneHalfLate(emulator, number)
    driver: Any = (open_meter if case.meter else open_controller)(
        case.driver, attach(wire), clock, **case.options, first_token=7
    )
    assert case.meter or driver.off()
    driver.identify()
    driver.configure(True, 1.0, 1e-3) if case.meter else driver.configure(1.0, (10.0, 95.0), 5.0)
    assert getattr(emulator, "status_until_reset", None) is None  # no emergency stop
    driver.transport.close()
    return wire.replies


@pytest.mark.parametrize("case", [*CONTROLLERS, *METERS], ids=str)
def test_one_reply_in_two_halves_ends_no_start(attach: Attach, clock: VirtualClock, case: Case) -> None:
    replies = start(attach, clock, case, -1)
    assert replies > 3
    for number in range(replies):
        start(attach, clock, case, number)


# ---- any bytes --------------------------------------------------------------------------------------


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
