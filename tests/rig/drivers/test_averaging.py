"""A meter's own filter: the mean of integrations one after the other, when it was taken, and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from rig.core.clock import VirtualClock
from rig.core.errors import Corrupt, Refused
from rig.drivers.meter import Averaging, FormulaMeter
from rig.drivers.registry import open_meter
from rig.drivers.scpi_meters import set_filter
from sim.instruments.instrument import Instrument
from sim.instruments.multimeters import Hp34401A, Keithley2000
from sim.instruments.source_meters import Keithley2400, Keithley2450
from tests.rig.drivers.still_plant import StillPlant

Attach = Callable[[Instrument], str]
METERS = {"keithley2000": Keithley2000, "keithley2400": Keithley2400, "keithley2450": Keithley2450}
EACH_S = 0.024  # 20 ms of integration and 4 ms of overhead of the emulated meters


class RisingPlant(StillPlant):
    """Its resistance rises by 1 ohm from one integration to the next; when they were is kept."""

    def __init__(self) -> None:
        super().__init__()
        self.sampled: list[float] = []

    def read_resistance_ohm(self, test_current_A: float) -> float:
        self.sampled.append(self.time_s)
        return 1e4 + len(self.sampled)

    def read_voltage_V(self) -> float:
        self.sampled.append(self.time_s)
        return 1.0 + 0.1 * len(self.sampled)


def opened(driver: str, plant: StillPlant, attach: Attach, clock: VirtualClock) -> tuple[Any, Any]:
    emulator = METERS[driver](plant)
    return open_meter(driver, attach(emulator), clock), emulator


@pytest.mark.parametrize("driver", METERS)
def test_a_reading_is_the_mean_and_its_time_the_middle(driver: str, attach: Attach, clock: VirtualClock) -> None:
    plant = RisingPlant()
    meter, _ = opened(driver, plant, attach, clock)
    meter.configure(True, 1.0, 1e-3)
    meter.average(Averaging(3, EACH_S))
    meter.read()  # the range is found
    for _ in range(3):
        plant.sampled.clear()
        reading = meter.read()
        assert len(plant.sampled) == 3  # a stack of its own: nothing of the reading before
        assert reading.value == pytest.approx(1e4 + 2.0, rel=1e-6)
        assert reading.time_s == pytest.approx(plant.sampled[1], abs=0.002)
    meter.average(Averaging())
    plant.sampled.clear()
    meter.read()
    assert len(plant.sampled) == 1


@pytest.mark.parametrize("driver", METERS)
def test_a_meter_that_was_switched_off_gets_its_filter_again(driver: str, attach: Attach, clock: VirtualClock) -> None:
    plant = RisingPlant()
    meter, emulator = opened(driver, plant, attach, clock)
    meter.configure(True, 1.0, 1e-3)
    meter.average(Averaging(2, EACH_S))
    emulator.reset()
    meter.link.doubt()
    meter.read()
    plant.sampled.clear()
    meter.read()
    assert len(plant.sampled) == 2


class Garbled:
    """A link on which a character of the filter's settings has flipped."""

    doubted = False

    def command(self, message: str) -> None: ...

    def answers(self, message: str, count: int) -> list[str]:
        return ["REP", "r", "1"]

    def doubt(self) -> None:
        self.doubted = True


def test_a_garbled_setting_is_a_fault_of_the_line() -> None:
    link: Any = Garbled()
    with pytest.raises(Corrupt, match="'R'"):
        set_filter(link, ":SENS:FRES:AVER", 2)
    assert link.doubted


def test_a_filter_that_reads_back_another_is_refused(attach: Attach, clock: VirtualClock) -> None:
    meter, emulator = opened("keithley2000", RisingPlant(), attach, clock)
    meter.configure(True, 1.0, 1e-3)
    emulator.settings = Forgetful(emulator.settings)
    with pytest.raises(Refused, match="filter reads back"):
        meter.average(Averaging(2))
    assert meter.averaging == Averaging()
    begin_s = clock.now_s()
    assert meter.read().is_number
    assert clock.now_s() - begin_s < 0.1  # and not the ten that it took for two


class Forgetful(dict[str, Any]):
    """Settings of a meter that does not take a filter's count."""

    def __setitem__(self, name: str, value: Any) -> None:
        super().__setitem__(name, 10 if name.endswith("AVER:COUN") else value)


def test_a_meter_without_a_filter_refuses(attach: Attach, clock: VirtualClock) -> None:
    meter: Any = open_meter("hp34401a", attach(Hp34401A(RisingPlant())), clock)
    meter.configure(True, 1.0, 1e-3)
    with pytest.raises(Refused, match="34401A"):
        meter.average(Averaging(2))
    assert meter.read().is_number


def test_a_voltage_that_stands_for_something_is_averaged_too(attach: Attach, clock: VirtualClock) -> None:
    plant = RisingPlant()
    inner, _ = opened("keithley2000", plant, attach, clock)
    meter = FormulaMeter(inner, "curvature_per_m", "2 * voltage_V")
    meter.configure(True, 1.0, 1e-3)
    meter.average(Averaging(3, EACH_S))
    plant.sampled.clear()
    assert meter.read().value == pytest.approx(2.0 * 1.2)


def test_off_does_not_wait_for_a_reading_that_is_under_way(attach: Attach, clock: VirtualClock) -> None:
    meter, emulator = opened("keithley2000", RisingPlant(), attach, clock)
    meter.configure(True, 10.0, 1e-3)
    meter.average(Averaging(100))
    begin_s = clock.now_s()
    meter.start_reading()
    assert meter.off()
    assert clock.now_s() - begin_s < 0.3  # the reading takes 20 s
    assert emulator.function == "VOLT:DC"
    assert meter.read().is_number
