"""The Lake Shore 335's and 336's emulator and driver: formats of the manual, drives and setpoints, limits, off; and the
maker's own package.
"""

from __future__ import annotations

import types
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from rig.core.clock import VirtualClock
from rig.core.errors import Corrupt, InstrumentError, OutOfStep, Refused
from rig.core.reading import Quality
from rig.drivers.controller import cools, drive_unit
from rig.drivers.lakeshore import TOKENS, LakeShoreController
from rig.drivers.registry import open_controller
from rig.ports.pseudo_terminal import PseudoTerminals
from sim.instruments.instrument import Instrument
from sim.instruments.lakeshore import LakeShore
from tests.rig.drivers.conversation import scripted
from tests.rig.drivers.far_ends import Host
from tests.rig.drivers.still_plant import StillPlant

Attach = Callable[[Instrument], str]


@pytest.fixture
def instrument(plant: StillPlant) -> LakeShore:
    return LakeShore(plant, update_s=0.0)


@pytest.fixture
def host(instrument: LakeShore) -> Host:
    return Host(instrument, b"\n")


# ---- emulator: what the manuals say ---------------------------------------------------------------


def test_formats_of_the_manual(host: Host, plant: StillPlant) -> None:
    plant.temperature_degC, plant.sink_degC = 25.0, 20.0
    dialogue = [
        ("*IDN?", "LSCI,MODEL335,335A123/#######,1.5"),
        ("CRDG? A", "+025.000"),
        ("KRDG? A", "+298.150"),
        ("CRDG? B", "+020.000"),
        ("RDGST? A", "000"),
        ("HTR? 1", "+000.0"),
        ("HTRST? 1", "0"),
        ("RANGE? 1", "0"),
        ("HTRSET? 1", "0,1,0,+1.000,1"),
        ("HTRSET 1,0,2,0,0.5,2", ""),
        ("HTRSET? 1", "0,2,0,+0.500,2"),
        ("OUTMODE 1,3,1,0", ""),
        ("OUTMODE? 1", "3,1,0"),
        ("MOUT 1,22.45", ""),
        ("MOUT? 1", "+22.45"),
        ("RANGE 1,3", ""),
        ("HTR? 1", "+022.4"),
        ("SETP 1,300.5", ""),
        ("SETP? 1", "+300.500"),
        ("TLIMIT B,450", ""),
        ("TLIMIT? B", "+0450.000"),
        ("INTYPE? A", "2,0,1,0,1"),
        ("RAMP 1,1,10.5", ""),
        ("RAMP? 1", "1,+10.50"),
        ("RANGE 1,0;RANGE? 1;HTR? 1", "0;+000.0"),
    ]
    for command, reply in dialogue:
        assert host.say(command) == reply, command
    assert plant.current_A == 0.0


@pytest.mark.parametrize(
    ("command", "bit"),
    [("BOGUS 1", 32), ("RANGE 1", 32), ("RANGE 1,9", 16), ("CRDG? Z", 16), ("MOUT 1,101", 16), ("TLIMIT A", 32)],
)
def test_errors_are_bits_of_the_event_status(host: Host, command: str, bit: int) -> None:
    assert host.say("*ESR?") == "128"  # power on
    host.say(command)
    assert int(host.say("*ESR?")) == bit
    assert host.say("*ESR?") == "000"


def test_enable_register_keeps_the_bits_that_are_used(host: Host) -> None:
    host.say("*ESE 255")
    assert host.say("*ESE?") == "181"
    for token in TOKENS:
        host.say(f"*ESE {token}")
        assert host.say("*ESE?") == f"{token:03d}"
    assert len(TOKENS) == 31


def test_ranges_are_tenths_of_the_power(host: Host, plant: StillPlant) -> None:
    for setting, power in ((3, 0.5), (2, 0.05), (1, 0.005), (0, 0.0)):
        host.say(f"OUTMODE 1,3,1,0;MOUT 1,50;RANGE 1,{setting}")
        assert plant.current_A == pytest.approx(power)


def test_temperature_limit_switches_all_outputs_off(host: Host, plant: StillPlant) -> None:
    host.say("OUTMODE 1,3,1,0;MOUT 1,50;RANGE 1,3;TLIMIT A,350")
    plant.temperature_degC = 76.0  # 349.15 K
    assert host.say("RANGE? 1") == "3"
    plant.temperature_degC = 77.0
    host.say("*ESR?")  # at the next sample
    assert host.say("RANGE? 1") == "0"
    assert plant.current_A == 0.0


def test_own_regulation_heats_and_does_not_cool(host: Host, plant: StillPlant) -> None:
    host.say("OUTMODE 1,1,1,0;PID 1,20,0,0;SETP 1,300.15;RANGE 1,3")
    assert plant.current_A == pytest.approx(0.4, abs=1e-6)  # 2 K below, 20 % per K
    plant.temperature_degC = 30.0
    host.say("*ESR?")
    assert plant.current_A == 0.0


def test_a_reading_stays_for_a_tenth_of_a_second(plant: StillPlant) -> None:
    instrument = LakeShore(plant)
    instrument.receive(b"CRDG? A\n", 0.0)
    assert instrument.transmit(0.05) == b"+025.000\r\n"
    plant.temperature_degC = 26.0
    instrument.receive(b"CRDG? A\n", 0.06)
    assert instrument.transmit(0.08) == b"+025.000\r\n"
    instrument.receive(b"CRDG? A\n", 0.2)
    assert instrument.transmit(0.25) == b"+026.000\r\n"


# ---- conversations ------------------------------------------------------------------------------

IN_STEP = [(b"\n*ESE 20;*ESE?\n", b"020\r\n"), (b"*ESR?;*ESE?;*ESE 1;*ESE?;*ESE 21\n", b"128;020;001\r\n")]
READING = (
    b"CRDG? A;RDGST? A;*ESE?;CRDG? A;RDGST? A;*ESE?;*ESE 1;*ESE?;*ESE 32\n",
    b"+025.000;000;021;+025.000;000;021;001\r\n",
)
OFF = (
    b"RANGE 1,0;RANGE? 1;RANGE? 1;HTR? 1;*ESE?;*ESE 1;*ESE?;*ESE 33\n",
    b"0;0;+000.0;032;001\r\n",
)


def test_conversation_of_a_reading(attach: Attach, clock: VirtualClock) -> None:
    controller, conversation = scripted("lakeshore", attach, clock, [*IN_STEP, READING, OFF], first_token=4)
    assert controller.read_temperature().value == 25.0
    assert controller.off() is True
    conversation.assert_over()


def test_the_emulator_holds_the_same_conversation(instrument: LakeShore) -> None:
    for index, (request, reply) in enumerate([*IN_STEP, READING, OFF]):
        instrument.receive(request, float(index))
        assert instrument.transmit(index + 0.9) == reply


@pytest.mark.parametrize(
    ("reply", "error"),
    [
        (b"+025.000;000;021;+025.000;000;020;001\r\n", OutOfStep),  # what another line has left
        (b"+025.000;000;021;+025.000;000;021;004\r\n", OutOfStep),  # another line's own
        (b"+025.000;000;021;+025.000;000;000;001\r\n", OutOfStep),  # it has restarted
        (b"+025.000;000;021;021;001\r\n", Corrupt),
        (b"+025.000\r\n", OutOfStep),
    ],
)
def test_what_is_no_answer(attach: Attach, clock: VirtualClock, reply: bytes, error: type[InstrumentError]) -> None:
    controller, conversation = scripted("lakeshore", attach, clock, [*IN_STEP, (READING[0], reply)], first_token=4)
    with pytest.raises(error):
        controller.read_temperature()
    conversation.assert_over()
    assert controller.link.in_doubt


def test_two_copies_that_differ_are_asked_for_again(attach: Attach, clock: VirtualClock) -> None:
    hurt = (READING[0], READING[1].replace(b"+025", b"+035", 1))
    good = (READING[0].replace(b"32", b"33"), READING[1].replace(b"021", b"032"))
    controller, conversation = scripted("lakeshore", attach, clock, [*IN_STEP, hurt, good], first_token=4)
    assert controller.read_temperature().value == 25.0
    conversation.assert_over()


# ---- driver against the emulator -----------------------------------------------------------------


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


def test_a_heater_takes_a_drive(controller: LakeShoreController, plant: StillPlant) -> None:
    assert (drive_unit(controller), cools(controller)) == ("of full drive", False)
    with pytest.raises(Refused, match="not armed for drives"):
        controller.set_current_A(0.5)
    controller.arm_current()
    assert plant.current_A == 0.0
    controller.set_current_A(0.5)
    assert plant.current_A == pytest.approx(0.5)
    assert controller.read_current().value == pytest.approx(0.5)
    assert controller.status().text == "high, open loop"
    for drive, why in ((-0.1, "cannot cool"), (0.9, "outside"), (float("nan"), "outside")):
        with pytest.raises(ValueError, match=why):
            controller.set_current_A(drive)
    assert plant.current_A == pytest.approx(0.5)
    assert controller.off()
    assert plant.current_A == 0.0


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
    with pytest.raises(Refused, match="not armed for drives"):
        driver.set_current_A(0.1)


def test_a_sensor_without_temperatures_is_refused(attach: Attach, clock: VirtualClock, instrument: LakeShore) -> None:
    instrument.input_types["A"][-1] = 3
    driver = open_controller("lakeshore", attach(instrument), clock)
    with pytest.raises(Refused, match="sensor's units"):
        driver.configure(1.0, (10.0, 90.0), 5.0)


def test_ramp(controller: LakeShoreController, instrument: LakeShore) -> None:
    controller.set_ramp_K_per_s(0.5)
    assert (instrument.outputs[1].ramps, instrument.outputs[1].ramp_K_per_min) == (1, 30.0)
    assert controller.own_limits().ramp_K_per_s == pytest.approx(0.5)
    controller.set_ramp_K_per_s(0.0)
    assert controller.own_limits().ramp_K_per_s == 0.0
    for bad in (-1.0, 0.001, 2.0, float("nan")):
        with pytest.raises(ValueError, match="ramp"):
            controller.set_ramp_K_per_s(bad)


def test_what_it_says_of_itself(controller: LakeShoreController, instrument: LakeShore, plant: StillPlant) -> None:
    plant.temperature_degC = float("nan")
    assert controller.read_temperature().quality is Quality.INVALID
    assert controller.status().text == "off, open loop, sensor: invalid"
    plant.temperature_degC = 25.0
    instrument.outputs[1].heater_error = 1
    assert controller.status().is_error
    with pytest.raises(Refused, match="heater open"):
        controller.arm_current()


def test_a_controller_that_was_switched_off_is_not_armed_any_more(
    controller: LakeShoreController, instrument: LakeShore, plant: StillPlant
) -> None:
    controller.arm_current()
    controller.set_current_A(0.5)
    controller.link.doubt()
    controller.set_current_A(0.6)  # doubt alone disarms nothing
    instrument.reset()
    controller.link.doubt()
    with pytest.raises(Refused, match="not armed"):
        controller.set_current_A(0.7)
    assert plant.current_A == 0.0


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


@pytest.mark.parametrize("name", ["range", "percent"])
def test_off_is_not_confirmed_by_an_output_that_reads_on(
    controller: LakeShoreController, instrument: LakeShore, name: str
) -> None:
    controller.arm_current()
    controller.set_current_A(0.5)
    value = {"range": 3, "percent": 50.0}[name]
    instrument.changed = lambda output: setattr(output, name, value)  # type: ignore[method-assign]
    assert controller.off() is False


# ---- the maker's own package ----------------------------------------------------------------------


@pytest.fixture
def makers_client(plant: StillPlant, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    pytest.importorskip("lakeshore", reason="lakeshore is not installed")
    from lakeshore import Model335, generic_instrument

    with PseudoTerminals({"it": LakeShore(plant, update_s=0.0)}) as terminals:
        path = terminals.paths["it"]
        port = types.SimpleNamespace(device=path, vid=0x1FB9, pid=0x0300, serial_number="335A123")
        monkeypatch.setattr(generic_instrument, "comports", lambda: [port])
        client = Model335(57600)
        yield client
        client.disconnect_usb()


def test_makers_client(makers_client: Any, plant: StillPlant) -> None:
    from lakeshore import InstrumentException

    model = makers_client
    assert (model.model_number, model.serial_number) == ("MODEL335", "335A123")
    plant.temperature_degC = 61.7
    assert model.get_celsius_reading("A") == 61.7
    assert model.get_all_kelvin_reading() == [334.85, 293.15]
    assert not model.get_input_reading_status("A").invalid_reading
    model.set_heater_setup_one(model.HeaterResistance.HEATER_50_OHM, 0.5, model.HeaterOutputDisplay.POWER)
    assert model.get_heater_setup(1)["max_current"] == 0.5
    model.set_heater_output_mode(1, model.HeaterOutputMode.OPEN_LOOP, model.InputSensor.CHANNEL_A)
    assert model.get_heater_output_mode(1)["mode"] == model.HeaterOutputMode.OPEN_LOOP
    model.set_manual_output(1, 40.0)
    assert model.get_manual_output(1) == 40.0
    model.set_heater_range(1, model.HeaterRange.HIGH)
    assert model.get_heater_range(1) == model.HeaterRange.HIGH
    assert plant.current_A == pytest.approx(0.4)
    assert model.get_heater_output(1) == 40.0
    assert model.get_heater_status(1) == model.HeaterError.NO_ERROR
    model.set_control_setpoint(1, 320.0)
    assert model.get_control_setpoint(1) == 320.0
    model.set_temperature_limit("A", 400.0)
    assert model.get_temperature_limit("A") == 400.0
    model.set_setpoint_ramp_parameter(1, True, 10.5)
    assert model.get_setpoint_ramp_parameter(1) == {"ramp_enable": True, "rate_value": 10.5}
    model.set_heater_pid(1, 40.0, 30.0, 10.0)
    assert model.get_heater_pid(1) == {"gain": 40.0, "integral": 30.0, "derivative": 10.0}
    with pytest.raises(InstrumentException, match="Execution"):
        model.command("RANGE 1,9")
    with pytest.raises(InstrumentException, match="Command"):
        model.command("BOGUS")
    model.all_heaters_off()
    assert plant.current_A == 0.0
