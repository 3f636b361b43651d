"""Whatever the wire does, a number that comes out was read after the question, or an error comes out."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from faulty_wire import REPLY_FAULTS, REQUEST_FAULTS, FaultyWire
from still_plant import StillPlant

from rig.clock import VirtualClock
from rig.drivers.registry import open_controller, open_meter
from rig.errors import InstrumentError
from rig.reading import Quality
from sim.instruments.instrument import Instrument
from sim.instruments.keithley2000 import Keithley2000
from sim.instruments.meerstetter import MeerstetterTec

Attach = Callable[[Instrument], str]
EVERY_FAULT = [*[(fault,) for fault in REPLY_FAULTS + REQUEST_FAULTS], REPLY_FAULTS + REQUEST_FAULTS]
EXCHANGES = 400


class TellTale(StillPlant):
    """Readings tell their time: temperature t / 100, resistance 1000 + 10 t, so that an old one is seen."""

    def read_temperature_degC(self) -> float:
        return 10.0 + self.time_s / 100.0

    def read_resistance_ohm(self, test_current_A: float) -> float:
        return 1e3 + 10.0 * self.time_s


@pytest.mark.parametrize("faults", EVERY_FAULT, ids=lambda faults: faults[0] if len(faults) == 1 else "all")
@pytest.mark.parametrize("seed", range(3))
def test_controller_never_gives_a_wrong_number(
    clock: VirtualClock, attach: Attach, faults: tuple[str, ...], seed: int
) -> None:
    foreign = b"!0015AB41CD2F28D5C2\r"
    wire = FaultyWire(MeerstetterTec(TellTale()), seed=seed, rate=0.0, foreign=foreign, faults=faults)
    controller = open_controller("meerstetter", attach(wire), clock, first_sequence=seed)
    controller.configure(4.0, (-100.0, 500.0), 0.0)
    controller.arm_current()
    wire._rate = 0.2
    right = 0
    for _ in range(EXCHANGES):
        begin_s = clock.now_s()
        try:
            reading = controller.read_temperature()
        except InstrumentError:
            continue
        finally:
            clock.sleep_until_s(clock.now_s() + 0.01)
        assert begin_s - 1e-3 <= (reading.value - 10.0) * 100.0 <= clock.now_s()
        right += 1
    assert sum(wire.counts.values()) > EXCHANGES / 10
    assert right > EXCHANGES / 4


@pytest.mark.parametrize("faults", EVERY_FAULT, ids=lambda faults: faults[0] if len(faults) == 1 else "all")
@pytest.mark.parametrize("seed", range(3))
def test_meter_never_gives_a_wrong_number(
    clock: VirtualClock, attach: Attach, faults: tuple[str, ...], seed: int
) -> None:
    foreign = b"+1.23456789E+03\n"
    wire = FaultyWire(Keithley2000(TellTale()), seed=seed, rate=0.0, foreign=foreign, faults=faults)
    meter = open_meter("keithley2000", attach(wire), clock, first_token=seed + 1)
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


@pytest.mark.parametrize("seed", range(20))
def test_output_that_is_reported_off_is_off(clock: VirtualClock, attach: Attach, seed: int) -> None:
    plant = StillPlant()
    wire = FaultyWire(MeerstetterTec(plant), seed=seed, rate=0.0, foreign=b"!0015AE8F97\r")
    controller = open_controller("meerstetter", attach(wire), clock, first_sequence=seed)
    controller.configure(4.0, (-100.0, 500.0), 0.0)
    controller.arm_current()
    controller.set_current_A(3.0)
    wire._rate = 0.5
    if controller.off():
        assert plant.current_A == 0.0
    wire._rate = 0.0
    clock.sleep_until_s(clock.now_s() + 10.0)  # for what is still under way
    assert controller.off()
    assert plant.current_A == 0.0
