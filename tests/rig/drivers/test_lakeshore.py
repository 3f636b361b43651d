"""The Lake Shore 335's and 336's driver: the heater's setup, units of setpoints, settings that read back late."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from rig.core.clock import VirtualClock
from rig.core.errors import Refused
from rig.core.reading import Quality
from rig.drivers.lakeshore import LakeShoreController
from rig.drivers.registry import open_controller
from sim.instruments.instrument import Instrument
from sim.instruments.lakeshore import LakeShore
from tests.rig.drivers.conversation import scripted
from tests.rig.drivers.still_plant import StillPlant
from tests.rig.drivers.test_conversations import TALKS

Attach = Callable[[Instrument], str]


@pytest.fixture
def instrument(plant: StillPlant) -> LakeShore:
    return LakeShore(plant, update_s=0.0)


@pytest.fixture
def controller(attach: Attach, clock: VirtualClock, instrument: LakeShore) -> LakeShoreController:
    driver = open_controller("lakeshore", attach(instrument), clock)
    assert isinstance(driver, LakeShoreController)
    driver.configure(0.8, (10.0, 90.0), 5.0)
    return driver


@pytest.mark.parametrize("model", ["335", "336"])
def test_identity_and_configuration(attach: Attach, clock: VirtualClock, plant: StillPlant, model: str) -> None:
    instrument = LakeShore(plant, model=model)
    instrument.outputs[1].setup[-2] = 1.5
    driver = open_controller("lakeshore", attach(instrument), clock)
    assert str(driver.identify()) == f"Lake Shore {model}, serial number 335A123, firmware 1.5"
    driver.configure(1.0, (10.0, 90.0), 5.0)
    assert instrument.outputs[1].setup[-2:] == [1.5, 2.0]  # the heater as it was, shown as power
    assert (instrument.outputs[1].mode, instrument.outputs[1].stays_on, instrument.outputs[1].range) == (3, 0, 0)
    assert driver.own_limits().faults(1.0, (10.0, 90.0), 5.0) == []
    assert driver.own_limits().high_degC == pytest.approx(90.0)
    instrument.identity = "LSCI,MODEL340,1,1.0"
    with pytest.raises(Refused, match="340"):
        driver.identify()


def test_largest_current_of_the_heater(attach: Attach, clock: VirtualClock, instrument: LakeShore) -> None:
    driver = open_controller("lakeshore", attach(instrument), clock, max_current_A=0.707)
    driver.configure(1.0, (10.0, 90.0), 5.0)
    assert instrument.outputs[1].setup == [0.0, 1.0, 0.0, 0.707, 2.0]


@pytest.mark.parametrize(
    "options", [{"input": "E"}, {"output": 3}, {"range": "highest"}, {"max_current_A": 0.0}, {"max_current_A": 3.0}]
)
def test_options_that_it_does_not_take(
    attach: Attach, clock: VirtualClock, instrument: LakeShore, options: dict[str, Any]
) -> None:
    with pytest.raises(ValueError, match="is expected"):
        open_controller("lakeshore", attach(instrument), clock, **options)


@pytest.mark.parametrize(("units", "shown"), [(1, 313.15), (2, 40.0)])
def test_setpoints_count_in_the_sensors_units(
    attach: Attach, clock: VirtualClock, plant: StillPlant, units: int, shown: float
) -> None:
    instrument = LakeShore(plant)
    instrument.input_types["A"][-1] = units
    driver = open_controller("lakeshore", attach(instrument), clock)
    driver.configure(1.0, (10.0, 90.0), 5.0)
    driver.arm_setpoint()
    assert plant.current_A == 0.0
    driver.set_setpoint_degC(40.0)
    assert instrument.outputs[1].setpoint == pytest.approx(shown)
    clock.sleep_until_s(clock.now_s() + 0.5)
    driver.read_temperature()
    assert plant.current_A == pytest.approx(1.0)
    with pytest.raises(ValueError, match="outside"):
        driver.set_setpoint_degC(95.0)
    with pytest.raises(Refused, match="not armed for currents"):
        driver.set_current_A(0.1)


def test_a_sensor_without_temperatures_is_refused(attach: Attach, clock: VirtualClock, instrument: LakeShore) -> None:
    instrument.input_types["A"][-1] = 3
    driver = open_controller("lakeshore", attach(instrument), clock)
    with pytest.raises(Refused, match="sensor's units"):
        driver.configure(1.0, (10.0, 90.0), 5.0)


def test_what_it_says_of_itself(controller: LakeShoreController, instrument: LakeShore, plant: StillPlant) -> None:
    plant.temperature_degC = float("nan")
    assert controller.read_temperature().quality is Quality.INVALID
    assert controller.status().text == "off, open loop, sensor: invalid"
    plant.temperature_degC = 25.0
    instrument.outputs[1].heater_error = 1
    assert controller.status().is_error
    with pytest.raises(Refused, match="heater open"):
        controller.arm_current()


def test_a_setting_that_reads_back_late(
    attach: Attach, clock: VirtualClock, controller: LakeShoreController, instrument: LakeShore
) -> None:
    controller.arm_setpoint()
    output = instrument.outputs[1]
    kept = output.setpoint
    changed = instrument.changed

    def late(_: Any) -> None:
        wanted, output.setpoint = output.setpoint, kept
        instrument._plant.schedule(clock.now_s() + 0.3, lambda _: setattr(output, "setpoint", wanted))
        instrument.changed = changed  # type: ignore[method-assign]

    instrument.changed = late  # type: ignore[method-assign]
    controller.set_setpoint_degC(40.0)
    assert output.setpoint == pytest.approx(313.15)


def test_a_setting_that_is_not_taken(controller: LakeShoreController, instrument: LakeShore) -> None:
    controller.arm_current()
    instrument.changed = lambda output: setattr(output, "manual_percent", 3.0)  # type: ignore[method-assign]
    with pytest.raises(Refused, match="MOUT"):
        controller.set_current_A(0.5)


@pytest.mark.parametrize("rate", [0.001, 2.0])
def test_a_ramp_beyond_the_instruments_is_refused(controller: LakeShoreController, rate: float) -> None:
    with pytest.raises(ValueError, match="ramp"):
        controller.set_ramp_K_per_s(rate)


def test_two_copies_that_differ_are_asked_for_again(attach: Attach, clock: VirtualClock) -> None:
    *before, (asked, answered), _ = TALKS["lakeshore"]
    hurt = (asked, answered.replace(b"+025", b"+035", 1))
    good = (asked.replace(b"32", b"33"), answered.replace(b"021", b"032"))
    controller, conversation = scripted("lakeshore", attach, clock, [*before, hurt, good], first_token=4)
    assert controller.read_temperature().value == 25.0
    conversation.assert_over()
