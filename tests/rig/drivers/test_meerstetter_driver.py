"""The Meerstetter driver against the emulator: limits, arming, refusals, an output known to be off."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from rig.core.clock import VirtualClock
from rig.core.errors import Refused
from rig.core.reading import Quality
from rig.drivers.meerstetter import MeerstetterController
from rig.drivers.registry import open_controller
from sim.instruments.instrument import Instrument
from sim.instruments.meerstetter import MeerstetterTec
from tests.rig.drivers.conversation import Conversation
from tests.rig.drivers.still_plant import StillPlant

Attach = Callable[[Instrument], str]


@pytest.fixture
def tec(plant: StillPlant) -> MeerstetterTec:
    return MeerstetterTec(plant)


@pytest.fixture
def controller(attach: Attach, clock: VirtualClock, tec: MeerstetterTec) -> MeerstetterController:
    driver = open_controller("meerstetter", attach(tec), clock)
    assert isinstance(driver, MeerstetterController)
    return driver


@pytest.fixture
def armed(controller: MeerstetterController) -> MeerstetterController:
    controller.configure(2.0, (10.0, 95.0), 3.0)
    controller.arm_current()
    return controller


def test_identity(controller: MeerstetterController) -> None:
    identity = controller.identify()
    assert (identity.maker, identity.model, identity.serial_number) == ("Meerstetter", "TEC-1091", "112")
    assert identity.firmware == "6.10 (8065-TEC SW G01)"


def test_another_device_is_refused(attach: Attach, clock: VirtualClock) -> None:
    laser_driver = MeerstetterTec(StillPlant(), device_type=1402)
    with pytest.raises(Refused, match="1402"):
        open_controller("meerstetter", attach(laser_driver), clock).identify()


def test_configure_sets_limits_and_spares_the_flash(
    controller: MeerstetterController, tec: MeerstetterTec, clock: VirtualClock
) -> None:
    controller.configure(2.5, (10.0, 95.0), 3.0)
    values = tec._values
    assert (values[2030], values[4010], values[4011], values[2060], values[108]) == (2.5, 10.0, 95.0, 3.0, 1)
    controller.arm_current()
    for step in range(50):
        controller.set_current_A(0.01 * step)
        clock.sleep_until_s(clock.now_s() + 0.1)
    assert tec.flash_writes == 0


def test_configure_takes_the_output_off(armed: MeerstetterController, plant: StillPlant, tec: MeerstetterTec) -> None:
    armed.set_current_A(1.0)
    armed.configure(2.0, (10.0, 95.0), 3.0)
    assert plant.current_A == 0.0
    assert tec.status == 1


def test_limit_beyond_the_device_is_refused(controller: MeerstetterController) -> None:
    with pytest.raises(ValueError, match=r"current limit 5 A: this device takes at most 4 A"):
        controller.configure(5.0, (10.0, 95.0), 0.0)


def test_a_device_that_does_not_keep_a_value_is_refused(controller: MeerstetterController, tec: MeerstetterTec) -> None:
    tec._measured[2030] = lambda: 1.0
    with pytest.raises(Refused, match=r"2030 was set to 2\.0 and reads 1\.0"):
        controller.configure(2.0, (10.0, 95.0), 0.0)


@pytest.mark.parametrize("dead_man_s", [0.01, math.nan])
def test_a_dead_man_that_cannot_be_sends_nothing(attach: Attach, clock: VirtualClock, dead_man_s: float) -> None:
    silent = Conversation([])
    with pytest.raises(ValueError, match="expected"):
        open_controller("meerstetter", attach(silent), clock).configure(1.0, (10.0, 95.0), dead_man_s)
    silent.assert_over()


@pytest.mark.parametrize("current_A", [2.01, -2.01, math.nan, math.inf])
def test_current_outside_the_limit_is_not_clipped(
    armed: MeerstetterController, plant: StillPlant, current_A: float
) -> None:
    armed.set_current_A(0.5)
    with pytest.raises(ValueError, match="outside"):
        armed.set_current_A(current_A)
    assert plant.current_A == 0.5


def test_current_arrives_and_is_read(armed: MeerstetterController, plant: StillPlant, clock: VirtualClock) -> None:
    assert plant.current_A == 0.0
    for current_A in (2.0, -2.0, 0.25):
        armed.set_current_A(current_A)
        assert plant.current_A == current_A
        assert armed.read_current().value == current_A
    status = armed.status()
    assert (status.text, status.is_error, status.output_is_on) == ("running", False, True)


def test_positive_heats_however_it_is_wired(attach: Attach, clock: VirtualClock, plant: StillPlant) -> None:
    tec = MeerstetterTec(plant, heating_sign=-1)
    tec._values[3034] = 0  # as the firmware knows
    controller = open_controller("meerstetter", attach(tec), clock)
    controller.configure(2.0, (10.0, 95.0), 0.0)
    controller.arm_current()
    controller.set_current_A(1.5)
    assert plant.current_A == 1.5
    assert controller.read_current().value == 1.5


def test_temperature_reading(controller: MeerstetterController, plant: StillPlant, clock: VirtualClock) -> None:
    clock.sleep_until_s(5.0)
    plant.temperature_degC = 41.5
    reading = controller.read_temperature()
    assert (reading.value, reading.quality) == (41.5, Quality.OK)
    assert reading.time_s == pytest.approx(5.0 + 21 / 5760)
    plant.temperature_degC = math.nan
    assert controller.read_temperature().quality is Quality.INVALID


def test_own_regulation(controller: MeerstetterController, plant: StillPlant, clock: VirtualClock) -> None:
    plant.heating_K_per_A_s = 0.5
    controller.configure(2.0, (10.0, 95.0), 0.0)
    controller.arm_setpoint()
    clock.sleep_until_s(clock.now_s() + 5.0)
    assert controller.read_temperature().value == pytest.approx(25.0, abs=0.01)
    controller.set_setpoint_degC(40.0)
    clock.sleep_until_s(clock.now_s() + 300.0)
    assert controller.read_temperature().value == pytest.approx(40.0, abs=0.1)
    for setpoint_degC in (9.9, 95.1, math.nan):
        with pytest.raises(ValueError, match="outside"):
            controller.set_setpoint_degC(setpoint_degC)
    with pytest.raises(Refused, match="armed"):
        controller.set_current_A(0.1)


def test_setpoint_is_not_armed_outside_the_limits(controller: MeerstetterController, plant: StillPlant) -> None:
    controller.configure(2.0, (30.0, 95.0), 0.0)
    with pytest.raises(Refused, match="object temperature"):
        controller.arm_setpoint()


def test_a_tripped_device_does_not_arm(controller: MeerstetterController, tec: MeerstetterTec) -> None:
    controller.configure(2.0, (10.0, 95.0), 0.0)
    tec.trip(138)
    status = controller.status()
    assert (status.is_error, status.output_is_on, status.code) == (True, False, 138)
    assert "above" in status.text
    with pytest.raises(Refused, match="does not come on"):
        controller.arm_current()


def test_dead_man(armed: MeerstetterController, plant: StillPlant, clock: VirtualClock) -> None:
    armed.set_current_A(1.0)
    clock.sleep_until_s(clock.now_s() + 10.0)
    assert not armed.status().output_is_on
    assert plant.current_A == 0.0


# ---- off ------------------------------------------------------------------------------------------


def test_off_is_confirmed(armed: MeerstetterController, plant: StillPlant) -> None:
    armed.set_current_A(1.0)
    assert armed.off() is True
    assert plant.current_A == 0.0
    with pytest.raises(Refused, match="armed"):
        armed.set_current_A(1.0)


@pytest.mark.parametrize(("parameter", "reads"), [(1020, 1.0), (1020, math.nan), (104, 2)])
def test_off_is_not_confirmed_by_a_device_that_still_drives(
    armed: MeerstetterController, tec: MeerstetterTec, parameter: int, reads: float
) -> None:
    """A current, none that is a number, or a status that runs."""
    tec._measured[parameter] = lambda: reads
    assert armed.off() is False


def test_off_is_not_confirmed_by_an_enable_that_reads_on(armed: MeerstetterController, tec: MeerstetterTec) -> None:
    tec._measured[2010] = lambda: 2
    tec._emergency_stop = lambda: None  # type: ignore[method-assign]
    assert armed.off() is False


def test_an_enable_that_reads_on_does_not_matter_after_an_emergency_stop(
    armed: MeerstetterController, plant: StillPlant, tec: MeerstetterTec
) -> None:
    armed.set_current_A(1.0)
    tec._measured[2010] = lambda: 2
    assert armed.off() is True
    assert plant.current_A == 0.0
    assert armed.status().code == 11
