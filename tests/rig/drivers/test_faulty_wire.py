"""Whatever the wire does, a number that comes out was read after the question, or an error comes out."""

from __future__ import annotations

import pytest

from rig.core.clock import VirtualClock
from rig.drivers.registry import open_meter
from sim.instruments.instrument import emulated
from tests.rig.drivers.faulty_wire import REPLY_FAULTS, REQUEST_FAULTS, FaultyWire
from tests.rig.drivers.still_plant import StillPlant
from tests.rig.drivers.wire_cases import CONTROLLERS, METERS, Attach, Case, controller_on, exchange

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
    controller, wire = controller_on(attach, clock, case, plant, seed, REPLY_FAULTS + REQUEST_FAULTS)
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
    emulator = emulated(case.driver, plant, **case.emulator)
    wire = FaultyWire(emulator, seed=seed, rate=0.0, foreign=case.foreign)
    meter = open_meter(case.driver, attach(wire), clock, **case.options, first_token=seed + 1)
    meter.configure(True, 1.0, 1e-3)
    meter.read()
    wire.rate = 0.5
    if meter.off():
        assert plant.test_current_A == 0.0
    wire.rate = 0.0
    clock.sleep_until_s(clock.now_s() + 10.0)
    assert meter.off()
    assert plant.test_current_A == 0.0
