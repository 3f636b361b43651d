"""Whatever the wire does, a number that comes out was read after the question, or an error comes out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import pytest
from faulty_wire import REPLY_FAULTS, REQUEST_FAULTS, FaultyWire
from still_plant import StillPlant

from rig.clock import VirtualClock
from rig.drivers.controller import TemperatureController
from rig.drivers.registry import open_controller, open_meter
from rig.errors import InstrumentError
from rig.reading import Quality
from sim.instruments.instrument import Instrument
from sim.instruments.registry import emulated_controller, emulated_meter

Attach = Callable[[Instrument], str]
EVERY_FAULT = [*[(fault,) for fault in REPLY_FAULTS + REQUEST_FAULTS], REPLY_FAULTS + REQUEST_FAULTS]
EXCHANGES = 400


@dataclass(frozen=True)
class Case:
    """An instrument by its driver's name, and what one of its family would say unasked.

    first: name of the option that fixes the first token or number. resolution_K: of a reading; the tell-tale
    temperature rises by `rate_K_per_s`, so that a reading tells its time within the quotient of the two.
    """

    driver: str
    foreign: bytes
    first: str = "first_token"
    rate_K_per_s: float = 0.01
    resolution_K: float = 1e-5
    fault_rate: float = 0.2
    emulator: dict[str, Any] = field(default_factory=dict)
    options: dict[str, Any] = field(default_factory=dict)

    def __str__(self) -> str:
        return " ".join([self.driver, *(str(value) for value in self.emulator.values())])


CONTROLLERS = (
    Case("meerstetter", b"!0015AB41CD2F28D5C2\r", first="first_sequence"),
    Case("te_technology", b"*00000bb8ec^", rate_K_per_s=0.5, resolution_K=0.01, fault_rate=0.1),
    Case(
        "te_technology",
        b"*012cf6^",
        rate_K_per_s=1.0,
        resolution_K=0.1,
        fault_rate=0.1,
        emulator={"model": "tc-48-20"},
        options={"model": "tc-48-20", "units": "degC"},
    ),
    Case("srs_ldc500", b"31.25\r\n", rate_K_per_s=0.1, resolution_K=1e-3),
    Case("srs_ldc500", b"31.25;31.25;999\r\n", rate_K_per_s=0.1, resolution_K=1e-3, emulator={"joined": True}),
)
METERS = (
    Case("keithley2000", b"+1.23456789E+03\n"),
    Case("hp34401a", b"+1.23456789E+03\r\n"),
    Case("keithley2400", b"+1.000000E-05,+1.234568E+03\n"),
    Case("keithley2400", b"+1.000000E-05,+1.234568E+03\n", options={"output_between_readings": False}),
)


class TellTale(StillPlant):
    """Readings tell their time: temperature 10 + rate t, resistance 1000 + 10 t, so that an old one is seen."""

    def __init__(self, rate_K_per_s: float) -> None:
        super().__init__()
        self.rate_K_per_s = rate_K_per_s

    def read_temperature_degC(self) -> float:
        return 10.0 + self.rate_K_per_s * self.time_s

    def read_resistance_ohm(self, test_current_A: float) -> float:
        return 1e3 + 10.0 * self.time_s


def controller_on(
    attach: Attach, clock: VirtualClock, case: Case, plant: StillPlant, seed: int, faults: tuple[str, ...]
) -> tuple[TemperatureController, FaultyWire]:
    """A configured and armed controller behind a wire that is still good."""
    emulator = emulated_controller(case.driver, plant, **case.emulator)
    wire = FaultyWire(emulator, seed=seed, rate=0.0, foreign=case.foreign, faults=faults)
    controller = open_controller(case.driver, attach(wire), clock, **case.options, **{case.first: seed + 1})
    controller.configure(4.0, (-100.0, 500.0) if case.driver != "srs_ldc500" else (-100.0, 240.0), 0.0)
    if controller.commands_current:
        controller.arm_current()
    else:
        controller.arm_setpoint()
    return controller, wire


def test_foreign_frames_are_well_formed() -> None:
    for case in CONTROLLERS:
        if case.driver == "te_technology":
            assert b"%02x^" % (sum(case.foreign[1:-3]) & 0xFF) == case.foreign[-3:]


@pytest.mark.parametrize("case", CONTROLLERS, ids=str)
@pytest.mark.parametrize("faults", EVERY_FAULT, ids=lambda faults: faults[0] if len(faults) == 1 else "all")
@pytest.mark.parametrize("seed", range(3))
def test_controller_never_gives_a_wrong_number(
    clock: VirtualClock, attach: Attach, faults: tuple[str, ...], seed: int, case: Case
) -> None:
    controller, wire = controller_on(attach, clock, case, TellTale(case.rate_K_per_s), seed, faults)
    tolerance_s = 1e-3 + 0.6 * case.resolution_K / case.rate_K_per_s
    wire._rate = case.fault_rate
    right = 0
    for _ in range(EXCHANGES):
        begin_s = clock.now_s()
        try:
            reading = controller.read_temperature()
        except InstrumentError:
            continue
        finally:
            clock.sleep_until_s(clock.now_s() + 0.01)
        if not reading.is_number:
            continue
        sampled_s = (reading.value - 10.0) / case.rate_K_per_s
        assert begin_s - tolerance_s <= sampled_s <= clock.now_s() + tolerance_s
        if case.driver != "meerstetter":  # whose answer may be that to the same question, asked before
            assert abs(reading.time_s - sampled_s) <= tolerance_s + 0.06
        right += 1
    assert sum(wire.counts.values()) > EXCHANGES / 10
    assert right > EXCHANGES / 4


@pytest.mark.parametrize("case", METERS, ids=str)
@pytest.mark.parametrize("faults", EVERY_FAULT, ids=lambda faults: faults[0] if len(faults) == 1 else "all")
@pytest.mark.parametrize("seed", range(3))
def test_meter_never_gives_a_wrong_number(
    clock: VirtualClock, attach: Attach, faults: tuple[str, ...], seed: int, case: Case
) -> None:
    emulator = emulated_meter(case.driver, TellTale(0.0), **case.emulator)
    wire = FaultyWire(emulator, seed=seed, rate=0.0, foreign=case.foreign, faults=faults)
    meter = open_meter(case.driver, attach(wire), clock, **case.options, **{case.first: seed + 1})
    meter.configure(True, 1.0, 1e-3)
    wire._rate = 0.2
    right = 0
    for _ in range(EXCHANGES):
        begin_s = clock.now_s()
        try:
            reading = meter.read_resistance()
        except InstrumentError:
            continue
        finally:
            clock.sleep_until_s(clock.now_s() + 0.01)
        if reading.quality in (Quality.OVERRANGE, Quality.INVALID):
            assert not reading.is_number
            continue
        assert begin_s - 1e-3 <= (reading.value - 1e3) / 10.0 <= clock.now_s()
        assert reading.time_s == pytest.approx((reading.value - 1e3) / 10.0, abs=2e-3)
        right += 1
    assert sum(wire.counts.values()) > EXCHANGES / 20
    assert right > EXCHANGES / 4


@pytest.mark.parametrize("case", CONTROLLERS, ids=str)
@pytest.mark.parametrize("seed", range(20))
def test_output_that_is_reported_off_is_off(clock: VirtualClock, attach: Attach, seed: int, case: Case) -> None:
    plant = StillPlant()
    controller, wire = controller_on(attach, clock, case, plant, seed, REPLY_FAULTS + REQUEST_FAULTS)
    if controller.commands_current:
        controller.set_current_A(3.0)
    else:
        controller.set_setpoint_degC(40.0)
    clock.sleep_until_s(clock.now_s() + 0.2)
    wire.transmit(clock.now_s())
    assert plant.current_A > 1.0
    wire._rate = 0.5
    if controller.off():
        assert plant.current_A == 0.0
    wire._rate = 0.0
    clock.sleep_until_s(clock.now_s() + 10.0)  # for what is still under way
    assert controller.off()
    assert plant.current_A == 0.0


@pytest.mark.parametrize("case", METERS[2:], ids=str)
@pytest.mark.parametrize("seed", range(10))
def test_test_current_that_is_reported_off_is_off(clock: VirtualClock, attach: Attach, seed: int, case: Case) -> None:
    plant = StillPlant()
    emulator = emulated_meter(case.driver, plant, **case.emulator)
    wire = FaultyWire(emulator, seed=seed, rate=0.0, foreign=case.foreign)
    meter = open_meter(case.driver, attach(wire), clock, **case.options, first_token=seed + 1)
    meter.configure(True, 1.0, 1e-3)
    meter.read_resistance()
    wire._rate = 0.5
    if meter.off():
        assert plant.test_current_A == 0.0
    wire._rate = 0.0
    clock.sleep_until_s(clock.now_s() + 10.0)
    assert meter.off()
    assert plant.test_current_A == 0.0
