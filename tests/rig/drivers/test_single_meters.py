"""What single meters have of their own: which sentinels, one test current, short messages, sources with an output."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

from rig.core.clock import VirtualClock
from rig.core.errors import OutOfStep, Refused
from rig.core.reading import Quality
from rig.drivers.meter import resistance_reading
from rig.drivers.registry import open_meter
from rig.drivers.scpi_meters import SourceMeter
from rig.ports import protocol_sim
from sim.instruments.instrument import Instrument, emulated
from sim.instruments.multimeters import Hp34401A
from tests.rig.drivers.conversation import scripted
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
def test_hp34401a_has_five_integration_times(
    attach: Attach, clock: VirtualClock, plant: StillPlant, nplc: float
) -> None:
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
    smu.switch_output(True)
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


def test_an_output_that_was_switched_off_by_hand_is_a_refusal(
    meter: Any, smu: Any, plant: StillPlant, name: str
) -> None:
    smu.switch_output(False)
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
