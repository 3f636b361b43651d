"""The TE Technology emulator and driver: setpoint mode, units, EEPROM, alarms, an output known to be off."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from rig.core.clock import VirtualClock
from rig.core.errors import Corrupt, OutOfStep, Refused
from rig.core.reading import Quality
from rig.drivers.registry import open_controller
from rig.drivers.te_technology import TeTechnologyController
from sim.instruments.instrument import Instrument
from sim.instruments.te_technology import TeTechnology
from tests.rig.drivers.still_plant import StillPlant

Attach = Callable[[Instrument], str]
MODELS = ("tc-36-25", "tc-48-20")


@pytest.fixture(params=MODELS)
def model(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def tec(plant: StillPlant, model: str) -> TeTechnology:
    return TeTechnology(plant, model=model)


@pytest.fixture
def controller(attach: Attach, clock: VirtualClock, tec: TeTechnology, model: str) -> TeTechnologyController:
    units = "degC" if model == "tc-48-20" else None
    driver = open_controller("te_technology", attach(tec), clock, model=model, units=units)
    assert isinstance(driver, TeTechnologyController)
    return driver


@pytest.fixture
def armed(controller: TeTechnologyController) -> TeTechnologyController:
    controller.configure(4.0, (10.0, 95.0), 5.0)
    controller.arm_setpoint()
    return controller


def wait(clock: VirtualClock, tec: TeTechnology, duration_s: float) -> None:
    clock.sleep_until_s(clock.now_s() + duration_s)
    tec.transmit(clock.now_s())


# ---- emulator -------------------------------------------------------------------------------------


def say(tec: TeTechnology, code: bytes, value: int = 0, time_s: float = 0.0) -> int:
    body = b"00%b%08x" % (code, value & 0xFFFFFFFF)
    tec.receive(b"*%b%02x\r" % (body, sum(body) & 0xFF), time_s)
    reply = int(tec.transmit(time_s + 0.09)[1:9], 16)
    return reply - (reply >> 31 << 32)


@pytest.mark.parametrize("heating_sign", [1, -1])
def test_wiring(plant: StillPlant, heating_sign: int) -> None:
    tec = TeTechnology(plant, heating_sign=heating_sign)
    for index, (code, value) in enumerate(((b"1c", 3000), (b"2d", 1))):
        say(tec, code, value, 0.1 * index)
    tec.transmit(1.0)
    assert tec.power > 0
    assert plant.current_A * heating_sign > 0.0
    say(tec, b"2d", 0, 2.0)
    assert plant.current_A == 0.0


def test_a_value_that_cannot_be_is_acknowledged_and_not_kept(plant: StillPlant) -> None:
    tec = TeTechnology(plant)
    assert say(tec, b"2d", 7, 0.0) == 7
    assert say(tec, b"46", 0, 1.0) == 0


def test_eeprom_is_written_while_it_may_be(plant: StillPlant) -> None:
    tec = TeTechnology(plant)
    say(tec, b"1c", 3000, 0.0)
    assert tec.eeprom_writes == 1
    say(tec, b"34", 0, 1.0)
    written = tec.eeprom_writes
    for index in range(5):
        say(tec, b"1c", 3000 + index, 2.0 + index)
    assert tec.eeprom_writes == written


@pytest.mark.parametrize(("latch", "power"), [(0, True), (1, False)])
def test_alarms_shut_down_and_may_latch(plant: StillPlant, latch: int, power: bool) -> None:
    tec = TeTechnology(plant)
    settings = ((b"28", 2), (b"23", 4000), (b"24", 1000), (b"2e", 1), (b"2f", latch), (b"1c", 3000), (b"2d", 1))
    for index, (code, value) in enumerate(settings):
        say(tec, code, value, 0.1 * index)
    tec.transmit(1.0)
    assert plant.current_A > 0.0
    plant.temperature_degC = 41.0
    tec.transmit(2.0)
    assert (say(tec, b"05", 0, 2.0), plant.current_A) == (1, 0.0)
    plant.temperature_degC = 9.0
    tec.transmit(4.0)
    assert say(tec, b"05", 0, 4.0) == 2
    plant.temperature_degC = 20.0
    tec.transmit(5.0)
    assert (plant.current_A > 0.0) is power
    say(tec, b"33", 1, 5.5)
    tec.transmit(6.0)
    assert plant.current_A > 0.0
    plant.temperature_degC = math.nan
    tec.transmit(7.0)
    assert (say(tec, b"05", 0, 7.0), plant.current_A) == (16, 0.0)


# ---- driver ---------------------------------------------------------------------------------------


def test_identity(controller: TeTechnologyController, model: str) -> None:
    identity = controller.identify()
    assert identity.maker == "TE Technology"
    assert identity.model.lower().startswith(model)


def test_another_instrument_is_refused(controller: TeTechnologyController, tec: TeTechnology, model: str) -> None:
    tec._reads[b"43" if model == "tc-36-25" else b"00"] = lambda: 77
    with pytest.raises((Refused, OutOfStep), match="77"):
        controller.identify()


def test_it_commands_no_current(controller: TeTechnologyController, clock: VirtualClock) -> None:
    assert (controller.commands_current, controller.has_dead_man) == (False, False)
    controller.configure(4.0, (10.0, 95.0), 0.0)
    for action in (controller.arm_current, lambda: controller.set_current_A(0.5)):
        with pytest.raises(Refused, match="setpoints"):
            action()
    reading = controller.read_current()
    assert (reading.is_number, reading.quality) == (False, Quality.INVALID)
    assert math.isnan(reading.value)


def test_configuration(controller: TeTechnologyController, tec: TeTechnology, model: str) -> None:
    tec.values["power on"] = 1
    if model == "tc-36-25":
        tec.values |= {"setpoint source": 2, "control type": 2}
    controller.configure(4.0, (10.0, 95.0), 5.0)
    assert tec.values["power on"] == 0
    if model == "tc-36-25":
        names = (
            "EEPROM",
            "setpoint source",
            "control type",
            "shutdown if alarm",
            "low alarm",
            "high alarm",
            "alarm type",
        )
        assert [tec.values[name] for name in names] == [0, 0, 1, 1, 1000, 9500, 2]


def test_the_eeprom_is_spared(plant: StillPlant, attach: Attach, clock: VirtualClock) -> None:
    tec = TeTechnology(plant)
    controller = open_controller("te_technology", attach(tec), clock)
    controller.off()
    controller.configure(4.0, (10.0, 95.0), 0.0)
    controller.arm_setpoint()
    for step in range(50):
        controller.set_setpoint_degC(30.0 + 0.1 * step)
        controller.read_temperature()
    assert tec.eeprom_writes <= 3  # power off at first, said more than once, and what ends the writing


def test_a_value_that_is_not_kept_is_refused(plant: StillPlant, attach: Attach, clock: VirtualClock) -> None:
    tec = TeTechnology(plant)
    tec._reads[b"44"] = lambda: 2
    controller = open_controller("te_technology", attach(tec), clock)
    with pytest.raises(Refused, match="2b, and code 44 reads 2"):
        controller.configure(4.0, (10.0, 95.0), 0.0)


def test_own_regulation(
    armed: TeTechnologyController, tec: TeTechnology, plant: StillPlant, clock: VirtualClock
) -> None:
    plant.heating_K_per_A_s = 0.2
    assert armed.status().output_is_on
    wait(clock, tec, 5.0)
    assert armed.read_temperature().value == pytest.approx(25.0, abs=0.1)
    armed.set_setpoint_degC(40.0)
    wait(clock, tec, 600.0)
    assert armed.read_temperature().value == pytest.approx(40.0, abs=0.3)
    for setpoint_degC in (9.9, 95.1, math.nan):
        with pytest.raises(ValueError, match="outside"):
            armed.set_setpoint_degC(setpoint_degC)


def test_temperature_reading(controller: TeTechnologyController, plant: StillPlant, clock: VirtualClock) -> None:
    for value_degC in (41.5, -12.3, 0.0):
        plant.temperature_degC = value_degC
        reading = controller.read_temperature()
        assert (reading.value, reading.quality) == (pytest.approx(value_degC), Quality.OK)
    plant.temperature_degC = math.nan
    assert controller.read_temperature().quality is Quality.INVALID


def test_temperature_that_does_not_agree_with_itself(controller: TeTechnologyController, tec: TeTechnology) -> None:
    controller.read_temperature()
    readings = iter(range(2500, 3000, 15))
    tec._reads[b"01"] = lambda: next(readings)
    with pytest.raises(Corrupt, match="three readings"):
        controller.read_temperature()


@pytest.mark.parametrize("bad", [265, 253, 235, 247, 25])
@pytest.mark.parametrize("place", range(2))
def test_one_of_the_readings_that_is_wrong_is_outvoted(
    controller: TeTechnologyController, tec: TeTechnology, bad: int, place: int
) -> None:
    controller.read_temperature()
    texts = [250, 250, 250, 250, 250]
    texts[place] = bad
    readings = iter(texts)
    tec._reads[b"01"] = lambda: next(readings)
    assert controller.read_temperature().value == 250 / controller._model.per_degC


def test_fahrenheit(plant: StillPlant, attach: Attach, clock: VirtualClock) -> None:
    tec = TeTechnology(plant)
    tec.values["units"] = 0
    controller = open_controller("te_technology", attach(tec), clock)
    assert controller.read_temperature().value == pytest.approx(25.0, abs=0.006)
    controller.configure(4.0, (10.0, 95.0), 0.0)
    assert (tec.values["low alarm"], tec.values["high alarm"]) == (5000, 20300)
    controller.arm_setpoint()
    controller.set_setpoint_degC(30.0)
    assert tec.values["setpoint"] == 8600


def test_units_that_change_behind_our_back(plant: StillPlant, attach: Attach, clock: VirtualClock) -> None:
    tec = TeTechnology(plant)
    address = attach(tec)
    controller = open_controller("te_technology", address, clock)
    assert controller.read_temperature().value == 25.0
    tec.values["units"] = 0
    controller.transport.reopen()
    controller.link.doubt()  # as after silence
    assert controller.read_temperature().value == pytest.approx(25.0, abs=0.006)


def test_units_have_to_be_known(plant: StillPlant, attach: Attach, clock: VirtualClock) -> None:
    tec = TeTechnology(plant, model="tc-48-20")
    controller = open_controller("te_technology", attach(tec), clock, model="tc-48-20")
    with pytest.raises(Refused, match="units"):
        controller.read_temperature()


def test_alarm_in_the_status(armed: TeTechnologyController, tec: TeTechnology) -> None:
    code = b"05" if tec._model.per_degC == 100 else b"03"
    tec._reads[code] = lambda: 0b1001
    status = armed.status()
    assert (status.is_error, status.code, status.output_is_on) == (True, 9, True)
    assert "high" in status.text
    assert "over-current" in status.text
    with pytest.raises(Refused, match="over-current"):
        armed.arm_setpoint()


def test_off_is_confirmed(
    armed: TeTechnologyController, tec: TeTechnology, plant: StillPlant, clock: VirtualClock
) -> None:
    armed.set_setpoint_degC(90.0)
    wait(clock, tec, 1.0)
    assert plant.current_A > 0.0
    assert armed.off() is True
    assert plant.current_A == 0.0
    with pytest.raises(Refused, match="armed"):
        armed.set_setpoint_degC(30.0)


def test_off_is_not_confirmed_by_power_that_reads_on(armed: TeTechnologyController, tec: TeTechnology) -> None:
    tec._reads[b"46" if tec._model.per_degC == 100 else b"64"] = lambda: 1
    assert armed.off() is False


def test_off_comes_at_once_even_in_doubt(
    armed: TeTechnologyController, tec: TeTechnology, plant: StillPlant, clock: VirtualClock
) -> None:
    armed.set_setpoint_degC(90.0)
    wait(clock, tec, 1.0)
    armed.link.doubt()
    begin_s = clock.now_s()
    assert armed.off()
    assert (
        next(time_s for time_s, current_A in plant.currents if time_s > begin_s and current_A == 0.0) < begin_s + 0.05
    )


def test_off_gets_through_to_an_instrument_that_is_answering(
    armed: TeTechnologyController, tec: TeTechnology, plant: StillPlant, clock: VirtualClock
) -> None:
    armed.set_setpoint_degC(90.0)
    wait(clock, tec, 1.0)
    armed.link.transport.send(armed.link._frame(b"01", 0))  # who asked has died; what begins meanwhile is lost
    lost, begin_s = tec.lost_commands, clock.now_s()
    armed.link.doubt()
    assert armed.off()
    assert tec.lost_commands > lost
    off_s = next(time_s for time_s, current_A in plant.currents if time_s > begin_s and current_A == 0.0)
    assert off_s < begin_s + 0.09


def test_a_controller_that_was_switched_off_is_no_longer_armed(
    plant: StillPlant, attach: Attach, clock: VirtualClock
) -> None:
    tec = TeTechnology(plant)
    controller = open_controller("te_technology", attach(tec), clock)
    controller.configure(4.0, (10.0, 95.0), 0.0)
    controller.arm_setpoint()
    tec.values |= {"power on": 0, "control deadband": 3}
    controller.link.doubt()
    with pytest.raises(Refused, match="armed"):
        controller.set_setpoint_degC(30.0)


@pytest.mark.parametrize("options", [{"model": "tc-24-25"}, {"units": "K"}, {"address": 256}, {"nonsense": 1}])
def test_bad_options(attach: Attach, clock: VirtualClock, plant: StillPlant, options: dict[str, object]) -> None:
    address = attach(TeTechnology(plant))
    with pytest.raises(ValueError, match=r"expected|no option"):
        open_controller("te_technology", address, clock, **options)
    open_controller("te_technology", address, clock)  # the port was let go


def test_a_device_that_needs_a_pause(plant: StillPlant, attach: Attach, clock: VirtualClock) -> None:
    controller = open_controller("te_technology", attach(TeTechnology(plant, deaf_s=0.05)), clock, gap_s=0.06)
    assert controller.read_temperature().value == 25.0
    assert controller.off()
