"""What single meters have of their own: sentinels, test currents, sources with an output, filters that average."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

from rig.core.clock import VirtualClock
from rig.core.errors import OutOfStep, Refused
from rig.core.reading import Quality
from rig.drivers.meter import Averaging, FormulaMeter, resistance_reading
from rig.drivers.registry import open_meter
from rig.drivers.scpi_meters import SourceMeter
from rig.ports import protocol_sim
from sim.instruments.instrument import Instrument, emulated
from sim.instruments.multimeters import Hp34401A, Keithley2000
from sim.instruments.source_meters import Keithley2400, Keithley2450
from tests.rig.drivers.far_ends import scripted
from tests.rig.drivers.still_plant import StillPlant

Attach = Callable[[Instrument], str]


@pytest.mark.parametrize(
    ("value_ohm", "quality"),
    [
        (9.9e37, Quality.OVERRANGE),
        (9.89999e37, Quality.OVERRANGE),
        (9.91e37, Quality.INVALID),
        (-9.9e37, Quality.OVERRANGE),
        (1e38, Quality.INVALID),
        (1e20, Quality.INVALID),
        (126.1, Quality.INVALID),
        (120.0, Quality.OK),
        (0.0, Quality.INVALID),
        (-1.0, Quality.INVALID),
    ],
)
def test_sentinels_by_magnitude_and_sign(value_ohm: float, quality: Quality) -> None:
    assert resistance_reading(value_ohm, 0.0, 126.0).quality is quality


@pytest.mark.parametrize(
    ("least_ohm", "largest_ohm", "most_A", "expected_A"),
    [
        (2e3, 2e4, 1e-3, 1e-5),  # the range of 100 kohm
        (1e3, 9e3, 1e-3, 1e-4),  # of 10 kohm
        (2e3, 3e5, 1e-3, 1e-5),  # of 1 Mohm, which has the current of the one below
        (100.0, 900.0, 1e-3, 1e-3),
        (100.0, 900.0, 1e-4, 1e-4),
        (10.0, 2e4, 1e-3, math.nan),  # a ten-thousandth of the range is no reading
        (1e3, 2e8, 1e-3, math.nan),
    ],
)
def test_one_test_current_for_a_span_of_resistances(
    attach: Attach, clock: VirtualClock, least_ohm: float, largest_ohm: float, most_A: float, expected_A: float
) -> None:
    meter, _ = scripted("keithley2000", attach, clock, [])
    assert meter.steady_test_current_A(least_ohm, largest_ohm, most_A) == pytest.approx(expected_A, nan_ok=True)


@pytest.mark.parametrize("nplc", [0.01, 0.5, 5.0])
def test_hp34401a_integration_times(attach: Attach, clock: VirtualClock, plant: StillPlant, nplc: float) -> None:
    meter = open_meter("hp34401a", attach(Hp34401A(plant)), clock)
    with pytest.raises(ValueError, match=r"0\.02, 0\.2, 1, 10, 100"):
        meter.configure(True, nplc, 1e-3)


def test_hp34401a_hears_short_messages_one_by_one(attach: Attach, clock: VirtualClock, plant: StillPlant) -> None:
    class Listener(Hp34401A):
        def receive(self, data: bytes, time_s: float) -> None:
            assert len(data) <= 100
            assert data == b"\x03" or not self.holds_off(time_s)
            super().receive(data, time_s)

    dmm = Listener(plant)
    meter = open_meter("hp34401a", attach(dmm), clock, first_token=99)
    meter.identify()
    meter.configure(True, 0.02, 1e-3)
    for resistance_ohm in (1e8, 1e2, 1e5):
        plant.resistance_ohm = resistance_ohm
        for _ in range(3):
            meter.read()
    assert not dmm.errors


# ---- sources with an output -------------------------------------------------------------------------


@pytest.fixture(params=["keithley2400", "keithley2450"])
def name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def smu(name: str, plant: StillPlant) -> Any:
    return emulated(name, plant)


@pytest.fixture
def meter(name: str, smu: Any, attach: Attach, clock: VirtualClock) -> Any:
    """Configured, its range found."""
    driver = open_meter(name, attach(smu), clock)
    driver.configure(True, 1.0, 1e-3)
    for _ in range(3):
        driver.read()
    return driver


def test_test_currents_of_the_manual(smu: Any, plant: StillPlant, name: str) -> None:
    """Table on page 4-14; not verified for the 2450."""
    smu.settings["OUTP"] = 1
    smu.enabled, smu.function, smu.settings["RES:MODE"] = {"RES"}, "RES", "AUTO"
    for full_scale_ohm, current_A in SourceMeter.TEST_CURRENTS_A.items():
        smu.choose_range(full_scale_ohm)
        assert plant.test_current_A == current_A


def test_closing_takes_the_test_current_away(meter: Any, plant: StillPlant) -> None:
    assert plant.test_current_A > 0.0
    meter.close()
    assert plant.test_current_A == 0.0
    meter.close()


def test_off_and_close_survive_an_unplugged_meter(meter: Any) -> None:
    protocol_sim.unregister("test-0")
    assert meter.off() is False
    meter.close()


def test_an_output_switched_off_by_hand_is_a_refusal(meter: Any, smu: Any, plant: StillPlant, name: str) -> None:
    smu.settings["OUTP"] = 0
    smu.send_test_current()
    with pytest.raises(Refused, match=r"OUTPUT off|Settings conflict: ") as refused:
        meter.read()
    assert refused.value.code == {"keithley2400": 803, "keithley2450": -221}[name]
    assert plant.test_current_A == 0.0
    assert meter.read().value == pytest.approx(1e4)


def test_another_current_than_the_ranges_is_found_out(meter: Any, smu: Any) -> None:
    smu.choose_range(2e5)  # behind our back
    with pytest.raises(OutOfStep, match="sourced"):
        meter.read()
    assert meter.read().value == pytest.approx(1e4)


# ---- a meter's own filter ---------------------------------------------------------------------------


FILTERING = {"keithley2000": Keithley2000, "keithley2400": Keithley2400, "keithley2450": Keithley2450}
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


def filtering(driver: str, plant: StillPlant, attach: Attach, clock: VirtualClock) -> tuple[Any, Any]:
    emulator = FILTERING[driver](plant)
    return open_meter(driver, attach(emulator), clock), emulator


@pytest.mark.parametrize("driver", FILTERING)
def test_a_reading_is_the_mean_and_its_time_the_middle(driver: str, attach: Attach, clock: VirtualClock) -> None:
    plant = RisingPlant()
    meter, _ = filtering(driver, plant, attach, clock)
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


@pytest.mark.parametrize("driver", FILTERING)
def test_a_meter_that_was_switched_off_gets_its_filter_again(driver: str, attach: Attach, clock: VirtualClock) -> None:
    plant = RisingPlant()
    meter, emulator = filtering(driver, plant, attach, clock)
    meter.configure(True, 1.0, 1e-3)
    meter.average(Averaging(2, EACH_S))
    emulator.reset()
    meter.link.doubt()
    meter.read()
    plant.sampled.clear()
    meter.read()
    assert len(plant.sampled) == 2


def test_a_filter_that_reads_back_another_is_refused(attach: Attach, clock: VirtualClock) -> None:
    meter, emulator = filtering("keithley2000", RisingPlant(), attach, clock)
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
    inner, _ = filtering("keithley2000", plant, attach, clock)
    meter = FormulaMeter(inner, "curvature_per_m", "2 * voltage_V")
    meter.configure(True, 1.0, 1e-3)
    meter.average(Averaging(3, EACH_S))
    plant.sampled.clear()
    assert meter.read().value == pytest.approx(2.0 * 1.2)


def test_off_does_not_wait_for_a_reading_that_is_under_way(attach: Attach, clock: VirtualClock) -> None:
    meter, emulator = filtering("keithley2000", RisingPlant(), attach, clock)
    meter.configure(True, 10.0, 1e-3)
    meter.average(Averaging(100))
    begin_s = clock.now_s()
    meter.start_reading()
    assert meter.off()
    assert clock.now_s() - begin_s < 0.3  # the reading takes 20 s
    assert emulator.function == "VOLT:DC"
    assert meter.read().is_number
