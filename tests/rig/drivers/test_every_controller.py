"""What every controller keeps to: limits, arming, currents and setpoints that arrive, an output known to be off."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

from rig.core.clock import VirtualClock
from rig.core.errors import OutOfStep, Refused
from rig.core.reading import Quality
from rig.drivers.controller import OwnLimits, cools, drive_unit
from rig.drivers.registry import open_controller
from sim.instruments.instrument import Instrument, emulated
from tests.rig.drivers.far_ends import Conversation
from tests.rig.drivers.still_plant import StillPlant
from tests.rig.drivers.wire_cases import CONTROLLERS, Case

Attach = Callable[[Instrument], str]
pytestmark = pytest.mark.parametrize("case", CONTROLLERS, ids=str)
NAN = math.nan
LIMITS_DEGC = (10.0, 95.0)
BEYOND = ((1e39, LIMITS_DEGC), (1.0, (10.0, 1e39)), (1.0, (-1e39, 95.0)))  # no number of 32 bits
RESOLUTION_K = {"tclab": 0.33}  # of its thermometer
IDENTITIES = {
    "meerstetter": "Meerstetter TEC-1091, serial number 112, firmware 6.10 (8065-TEC SW G01)",
    "te_technology": "TE Technology TC-",
    "srs_ldc500": "SRS LDC501, serial number 098023, firmware 2.00",
    "lakeshore": "Lake Shore 335, serial number 335A123, firmware 1.5",
    "tclab": "TCLab Arduino Uno",
}
OWN_LIMITS = {  # that are read back after the configuration below
    "meerstetter": OwnLimits(0.9, *LIMITS_DEGC, 4.0, 0.0),
    "srs_ldc500": OwnLimits(0.9, *LIMITS_DEGC),
    "te_technology": OwnLimits(NAN, *LIMITS_DEGC),
    "te_technology tc-48-20": OwnLimits(),
    "lakeshore": OwnLimits(high_degC=95.0, ramp_K_per_s=0.0),
}


@pytest.fixture
def emulator(case: Case, plant: StillPlant) -> Any:
    return emulated(case.driver, plant, **case.emulator)


@pytest.fixture
def controller(case: Case, emulator: Any, attach: Attach, clock: VirtualClock) -> Any:
    return open_controller(case.driver, attach(emulator), clock, **case.options)


@pytest.fixture
def armed(controller: Any) -> Any:
    """For currents, or for setpoints if it takes no currents."""
    controller.configure(0.9, LIMITS_DEGC, 0.0)
    controller.arm_current() if controller.commands_current else controller.arm_setpoint()
    return controller


def heat(controller: Any, clock: VirtualClock) -> None:
    if controller.commands_current:
        controller.set_current_A(0.5)
    else:
        controller.set_setpoint_degC(90.0)
        clock.sleep_until_s(clock.now_s() + 1.0)
        controller.status()  # which lets the emulated world follow


def power_code(emulator: Any) -> bytes:
    return next(setting.read for setting in emulator._model.settings if setting.name == "power on")


# ---- who is there, limits, arming -----------------------------------------------------------------


def test_it_says_who_it_is(controller: Any, case: Case) -> None:
    assert str(controller.identify()).startswith(IDENTITIES[case.driver])
    if case.driver == "te_technology":
        assert controller.identify().model.lower().startswith(str(case.emulator.get("model", "tc-36-25")))


def test_another_instrument_is_refused(controller: Any, emulator: Any, case: Case) -> None:
    """Its commands would mean something else there."""
    if case.driver == "tclab":
        pytest.skip("test_conversations.py has boards that are none")
    if case.driver == "meerstetter":
        emulator._values[100] = 1402  # a laser driver of the same maker
    elif case.driver == "te_technology":
        emulator._reads |= {b"43": lambda: 1402, b"00": lambda: 1402}
    else:
        emulator.identity = "SOMEBODY ELSE,MODEL 1402,1,2"
    with pytest.raises((Refused, OutOfStep), match="1402"):
        controller.identify()


def test_limits_that_cannot_be_send_nothing(attach: Attach, clock: VirtualClock, case: Case) -> None:
    """A controller with half of a wrong configuration would guard the plate by the limits of somebody else."""
    controller = open_controller(case.driver, attach(silent := Conversation([])), clock, **case.options)
    no_limits = ((0.0, LIMITS_DEGC), (NAN, LIMITS_DEGC), (1.0, (95.0, 10.0)), (1.0, (NAN, 9.0)))
    for current_A, limits_degC in (*no_limits, *BEYOND):
        with pytest.raises(ValueError, match="expected"):
            controller.configure(current_A, limits_degC, 0.0)
    silent.assert_over()


def test_its_own_limits_are_what_was_configured(controller: Any, case: Case) -> None:
    controller.configure(0.9, LIMITS_DEGC, 4.0)
    found = controller.own_limits()
    expected = OWN_LIMITS.get(str(case), OWN_LIMITS.get(case.driver, OwnLimits()))
    for name in OwnLimits.__slots__:
        assert getattr(found, name) == pytest.approx(getattr(expected, name), abs=0.1, nan_ok=True), name
    assert found.faults(0.9, LIMITS_DEGC, 4.0) == []
    kept = (found.current_A, found.low_degC, found.high_degC, found.dead_man_s)
    assert len(found.faults(0.5, (9.0, 97.0), 5.0)) == sum(not math.isnan(value) for value in kept)


def test_nothing_is_commanded_before_it_is_configured_and_armed(controller: Any, plant: StillPlant) -> None:
    """Else a current could flow, or a setpoint be held, without limits."""
    current, setpoint = (lambda: controller.set_current_A(0.1)), (lambda: controller.set_setpoint_degC(30.0))
    for act in (current, setpoint, controller.arm_current, controller.arm_setpoint):
        with pytest.raises((Refused, ValueError)):
            act()
    controller.configure(0.8, (10.0, 95.0), 0.0)
    for act in (current, setpoint):
        with pytest.raises(Refused):
            act()
    assert plant.current_A == 0.0


def test_what_it_has_not_is_refused(controller: Any, case: Case) -> None:
    controller.configure(0.8, LIMITS_DEGC, 0.0)
    if not controller.has_ramp:
        with pytest.raises(Refused, match="no ramp"):
            controller.set_ramp_K_per_s(0.5)
        return
    controller.set_ramp_K_per_s(0.5)
    assert controller.own_limits().ramp_K_per_s == pytest.approx(0.5)
    for bad in (-1.0, NAN, math.inf, 1e39):
        with pytest.raises(ValueError, match="expected"):
            controller.set_ramp_K_per_s(bad)
    controller.set_ramp_K_per_s(0.0)
    assert controller.own_limits().ramp_K_per_s == 0.0


# ---- what is commanded, what is read --------------------------------------------------------------


def test_a_current_arrives_and_one_beyond_the_limit_does_not(armed: Any, plant: StillPlant, case: Case) -> None:
    if not armed.commands_current:
        for act in (armed.arm_current, lambda: armed.set_current_A(0.5)):
            with pytest.raises(Refused, match="setpoints"):
                act()
        assert armed.read_current().quality is Quality.INVALID
        return
    assert plant.current_A == 0.0
    full_A = 4.0 if case.limit == 1.0 else 1.0  # of the emulated heaters
    for current_A in (0.9, -0.9, 0.25) if cools(armed) else (0.9, 0.25):
        armed.set_current_A(current_A)
        assert plant.current_A == pytest.approx(full_A * current_A)
        assert armed.read_current().value == pytest.approx(current_A)
    assert armed.status().output_is_on
    for current_A in (0.91, -0.91, NAN, math.inf):
        with pytest.raises(ValueError, match="cannot cool" if current_A < 0.0 and not cools(armed) else "outside"):
            armed.set_current_A(current_A)
    assert plant.current_A == pytest.approx(full_A * 0.25)
    assert (drive_unit(armed) == "A") is cools(armed)
    with pytest.raises(Refused):
        armed.set_setpoint_degC(30.0)


def test_own_regulation_follows_its_setpoint(armed: Any, plant: StillPlant, clock: VirtualClock, case: Case) -> None:
    if case.driver == "tclab":
        for act in (armed.arm_setpoint, lambda: armed.set_setpoint_degC(30.0)):
            with pytest.raises(Refused, match="no regulation"):
                act()
        return
    plant.heating_K_per_A_s = 0.2 if case.limit > 1.0 else 0.01
    armed.arm_setpoint()
    clock.sleep_until_s(clock.now_s() + 5.0)
    assert armed.read_temperature().value == pytest.approx(25.0, abs=0.1)
    armed.set_setpoint_degC(40.0)
    clock.sleep_until_s(clock.now_s() + 600.0)
    assert armed.read_temperature().value == pytest.approx(40.0, abs=0.5 if cools(armed) else 5.0)
    for setpoint_degC in (9.9, 95.1, NAN):
        with pytest.raises(ValueError, match="outside"):
            armed.set_setpoint_degC(setpoint_degC)
    with pytest.raises(Refused):
        armed.set_current_A(0.1)
    plant.temperature_degC, plant.heating_K_per_A_s = 9.0, 0.0
    with pytest.raises(Refused, match="within"):
        armed.arm_setpoint()


def test_temperatures_and_an_open_sensor(controller: Any, plant: StillPlant, clock: VirtualClock, case: Case) -> None:
    controller.read_temperature()
    for value_degC in (41.5, -12.3):
        plant.temperature_degC = value_degC
        begin_s = clock.now_s()
        reading = controller.read_temperature()
        assert reading.quality is Quality.OK
        assert reading.value == pytest.approx(value_degC, abs=RESOLUTION_K.get(case.driver, 1e-3))
        assert begin_s < reading.time_s < clock.now_s() < begin_s + 0.2
    plant.temperature_degC = NAN
    assert controller.read_temperature().quality is Quality.INVALID


# ---- off ------------------------------------------------------------------------------------------


def test_off_is_confirmed_and_disarms(armed: Any, plant: StillPlant, clock: VirtualClock) -> None:
    heat(armed, clock)
    assert plant.current_A > 0.0
    assert armed.off() is True
    assert plant.current_A == 0.0
    for act in (lambda: armed.set_current_A(0.5), lambda: armed.set_setpoint_degC(30.0)):
        with pytest.raises(Refused):
            act()


def test_configuring_takes_the_output_off(armed: Any, plant: StillPlant, clock: VirtualClock) -> None:
    heat(armed, clock)
    armed.configure(0.9, LIMITS_DEGC, 0.0)
    assert plant.current_A == 0.0


def test_off_is_not_confirmed_if_a_switch_reads_on(armed: Any, emulator: Any, clock: VirtualClock, case: Case) -> None:
    heat(armed, clock)
    if case.driver == "meerstetter":
        emulator._measured[2010] = lambda: 2
        emulator._emergency_stop = lambda: None
    elif case.driver == "te_technology":
        emulator._reads[power_code(emulator)] = lambda: 1
    elif case.driver == "srs_ldc500":
        emulator.switch = lambda on: None
    elif case.driver == "lakeshore":
        emulator.changed = lambda: emulator.values.update({("RANGE", number): (3,) for number in emulator.outputs})
    else:
        emulator._heat = lambda number, percent: None
    assert armed.off() is False


def test_off_is_not_confirmed_if_a_current_is_shown(armed: Any, emulator: Any, clock: VirtualClock, case: Case) -> None:
    heat(armed, clock)
    if case.driver == "meerstetter":
        for parameter, shown in ((1020, 1.0), (1020, NAN), (104, 2)):
            before = dict(emulator._measured)
            emulator._measured[parameter] = lambda shown=shown: shown
            assert armed.off() is False
            emulator._measured |= before
        return
    if case.driver == "srs_ldc500":
        emulator.drive, emulator.output_A = (lambda: None), 1.0
    elif case.driver == "lakeshore":
        emulator.changed = lambda: [setattr(output, "percent", 50.0) for output in emulator.outputs.values()]
    else:
        pytest.skip("it measures no current")
    assert armed.off() is False


def test_one_that_was_switched_off_in_between_is_not_armed_any_more(
    armed: Any, emulator: Any, plant: StillPlant, clock: VirtualClock, case: Case
) -> None:
    """The next command would be taken for one that acts."""
    heat(armed, clock)
    armed.link.doubt() if case.driver != "meerstetter" else None
    armed.set_current_A(0.6) if armed.commands_current else armed.set_setpoint_degC(89.0)  # doubt disarms nothing
    if case.driver == "meerstetter":
        emulator._restart(clock.now_s())
        clock.sleep_until_s(clock.now_s() + 1.0)
        armed.set_current_A(0.7)  # volatile: it is taken, and does nothing
        assert plant.current_A == 0.0
        return
    if case.driver == "te_technology":
        emulator.values |= {"power on": 0} | ({"control deadband": 3} if emulator._model.has_address else {})
    elif case.driver == "srs_ldc500":
        emulator.switch(0.0)
    elif case.driver == "lakeshore":
        emulator.reset()
    else:
        emulator.heaters = {1: 0.0, 2: 0.0}  # as after a command that was garbled on its way
    armed.link.doubt()
    with pytest.raises(Refused, match="not armed"):
        armed.set_current_A(0.7) if armed.commands_current else armed.set_setpoint_degC(30.0)
