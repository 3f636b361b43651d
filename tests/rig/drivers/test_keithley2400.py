"""The Keithley 2400's emulator and driver: output on and off, elements and sentinels, test currents by range."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from rig.core.clock import VirtualClock
from rig.core.errors import Corrupt, InstrumentError, OutOfStep, Refused
from rig.drivers.keithley2400 import TEST_CURRENTS_A, Keithley2400Meter
from rig.drivers.registry import open_meter
from rig.ports import protocol_sim
from sim.instruments.instrument import Instrument
from sim.instruments.keithley2400 import Keithley2400
from tests.rig.drivers.conversation import scripted
from tests.rig.drivers.far_ends import Host
from tests.rig.drivers.still_plant import StillPlant

Attach = Callable[[Instrument], str]
NAN, OVERFLOW = "+9.910000E+37", "+9.900000E+37"


@pytest.fixture
def smu(plant: StillPlant) -> Keithley2400:
    return Keithley2400(plant)


@pytest.fixture
def host(smu: Keithley2400) -> Host:
    return Host(smu)


# ---- emulator -------------------------------------------------------------------------------------


def test_recipe_of_the_manual(host: Host, plant: StillPlant) -> None:
    """Four-wire auto-ohms (p. 4-14)."""
    plant.resistance_ohm = 12345.67
    recipe = ("*RST", 'FUNC "RES"', "RES:MODE AUTO", "RES:RANG 20E3", ":SYST:RSEN ON", ":FORM:ELEM RES", ":OUTP ON")
    for message in recipe:
        assert host.say(message) == ""
    assert plant.test_current_A == 100e-6
    assert host.say(":READ?") == "+1.234567E+04"
    assert host.say(":OUTP OFF") == ""
    assert plant.test_current_A == 0.0
    assert host.say(":SYST:ERR?") == '0,"No error"'


@pytest.mark.parametrize(
    ("full_scale_ohm", "current_A"),
    [(20, 0.1), (200, 1e-2), (2e3, 1e-3), (2e4, 1e-4), (2e5, 1e-5), (2e6, 1e-6), (2e7, 1e-6), (2e8, 1e-7)],
)
def test_test_currents_of_the_manual(host: Host, plant: StillPlant, full_scale_ohm: float, current_A: float) -> None:
    host.say(f"FUNC 'RES';:RES:MODE AUTO;:RES:RANG {full_scale_ohm:g};:OUTP ON")
    assert plant.test_current_A == current_A
    assert float(host.say("RES:RANG?")) == full_scale_ohm
    assert TEST_CURRENTS_A[full_scale_ohm] == current_A


def test_five_elements(host: Host, plant: StillPlant) -> None:
    host.say('*RST;FUNC:CONC OFF;FUNC "RES";RES:MODE AUTO;RES:RANG 20E3;:OUTP ON')
    volts, amps, ohms, seconds, status = host.say(":READ?").split(",")
    assert (volts, amps, ohms) == (NAN, "+1.000000E-04", "+1.000000E+04")
    assert float(seconds) == pytest.approx(2.02, abs=0.02)
    assert int(float(status)) & 4096
    host.say("FUNC:CONC ON;FUNC:ALL")
    assert host.say(":READ?").startswith("+1.000000E+00,+1.000000E-04,+1.000000E+04,")
    host.say("FUNC:CONC OFF;FUNC 'VOLT';:SOUR:FUNC CURR;:SOUR:CURR 1E-3")
    assert host.say(":READ?").startswith(f"+1.000000E+01,+1.000000E-03,{NAN},")


def test_two_sentinels(host: Host, plant: StillPlant) -> None:
    host.say('FUNC "RES";RES:MODE AUTO;RES:RANG 20E3;:FORM:ELEM STAT,RES;:OUTP ON')
    plant.resistance_ohm = 21001.0
    assert host.say(":READ?") == f"{OVERFLOW},+4.097000E+03"
    plant.resistance_ohm = -math.inf
    assert host.say(":READ?").startswith("-9.900000E+37,")
    plant.resistance_ohm = math.nan
    assert host.say(":READ?").startswith(f"{NAN},")


@pytest.mark.parametrize("question", [":READ?", ":INIT", ":MEAS:RES?", ":READ?;*OPC?"])
def test_no_answer_with_the_output_off(host: Host, question: str) -> None:
    host.say('FUNC "RES";RES:MODE AUTO')
    assert host.say(question) == ""
    assert host.say(":SYST:ERR?") == '803,"Not permitted with OUTPUT off"'
    assert host.say(":FETC?") == ""
    assert host.say(":SYST:ERR?").startswith("-230,")


def test_output_for_a_reading_only(host: Host, plant: StillPlant) -> None:
    host.say('FUNC "RES";RES:MODE AUTO;RES:RANG 20E3;:FORM:ELEM RES;:SOUR:CLE:AUTO ON')
    seen: list[float] = []
    plant.set_test_current_A = seen.append  # type: ignore[method-assign]
    assert host.say(":READ?") == "+1.000000E+04"
    assert seen == [1e-4, 0.0]


def test_autorange_changes_the_current(host: Host, plant: StillPlant) -> None:
    host.say('FUNC "RES";RES:MODE AUTO;:FORM:ELEM CURR,RES;:OUTP ON')
    for resistance_ohm, current_A in ((15.0, 0.1), (2.05e4, 1e-4), (1.9e8, 1e-7)):
        plant.resistance_ohm = resistance_ohm
        text = host.say(":READ?", 5.0)
        assert [float(part) for part in text.split(",")] == pytest.approx([current_A, resistance_ohm])


def test_manual_ohms(host: Host, plant: StillPlant) -> None:
    plant.resistance_ohm = 100.0
    host.say(":SOUR:FUNC CURR;:SOUR:CURR 2E-3;:FUNC 'RES';:RES:MODE MAN;:FORM:ELEM VOLT,CURR,RES;:OUTP ON;:FUNC:ALL")
    assert plant.test_current_A == 2e-3
    assert host.say(":READ?") == "+2.000000E-01,+2.000000E-03,+1.000000E+02"
    host.say(":VOLT:PROT 0.1")
    assert host.say(":READ?") == "+1.000000E-01,+1.000000E-03,+1.000000E+02"
    host.say(":SOUR:FUNC VOLT;:SOUR:VOLT 0.05;:CURR:PROT 1")
    assert host.say(":READ?") == "+5.000000E-02,+5.000000E-04,+1.000000E+02"
    assert plant.test_current_A == pytest.approx(5e-4)


@pytest.mark.parametrize(
    ("message", "code"),
    [
        (":FUNC RES", -141),
        (":FUNC 'X'", -224),
        (":RES:RANG 211E6", -222),
        (":RES:MODE X", -224),
        (":SOUR:FUNC X", -224),
        (":FORM:ELEM X", -224),
        (":FORM:ELEM", -109),
        (":FUNC", -109),
        (":SOUR:CURR 2", -222),
        (":OUTP MAYBE", -120),
        (":BOGUS", -113),
    ],
)
def test_refusals_go_into_the_queue(host: Host, message: str, code: int) -> None:
    assert host.say(message) == ""
    assert host.say(":SYST:ERR?").startswith(f"{code},")


# ---- conversations --------------------------------------------------------------------------------

IN_STEP = [(b"\x18\r*ESE 8;*ESE?\r", b"8\n"), (b":SYST:ERR?;*ESE?;*ESE 9\r", b'0,"No error";8\n')]
CONFIGURE = [
    *IN_STEP,
    (b"*RST;:SYST:ERR?;*ESE?;*ESE 10\r", b'0,"No error";9\n'),
    (
        b':SENS:FUNC "RES";:SENS:RES:MODE AUTO;:SENS:RES:NPLC 1;:SYST:RSEN ON;:SYST:ERR?;*ESE?;*ESE 11\r',
        b'0,"No error";10\n',
    ),
    (b":SENS:RES:RANG:AUTO 0;:SENS:RES:RANG 200000;:SYST:ERR?;*ESE?;*ESE 12\r", b'0,"No error";11\n'),
    (b":FORM:ELEM CURR,RES;:SOUR:CLE:AUTO 0;:SYST:ERR?;*ESE?;*ESE 13\r", b'0,"No error";12\n'),
    (
        b":SENS:FUNC?;:SENS:RES:MODE?;:SENS:RES:NPLC?;:SYST:RSEN?;:SENS:RES:RANG:AUTO?;:SENS:RES:RANG?"
        b";:FORM:ELEM?;:SOUR:CLE:AUTO?;:OUTP?;*ESE?;*ESE 14\r",
        b'"CURR:DC","RES";AUTO;1.00;1;0;+2.000000E+05;CURR,RES;0;0;13\n',
    ),
]
OUTPUT_ON = (b":OUTP ON;:SYST:ERR?;*ESE?;*ESE 15\r", b'0,"No error";14\n')
READING = (
    b":READ?;:FETC?;*ESE?;*ESE 16\r",
    b"+1.000000E-05,+2.345679E+04;+1.000000E-05,+2.345679E+04;15\n",
)
CLOSING = (b":OUTP OFF;:OUTP?;*ESE?;*ESE 17\r", b"0;16\n")


def test_conversation_of_a_reading(attach: Attach, clock: VirtualClock) -> None:
    meter, conversation = scripted(
        "keithley2400", attach, clock, [*CONFIGURE, OUTPUT_ON, READING, CLOSING], first_token=7
    )
    meter.configure(True, 1.0, 1e-3)
    assert meter.read().value == 23456.79
    meter.close()
    conversation.assert_over()


def test_the_emulator_holds_the_same_conversation(plant: StillPlant) -> None:
    plant.resistance_ohm = 23456.789
    smu = Keithley2400(plant)
    for index, (request, reply) in enumerate([*CONFIGURE, OUTPUT_ON, READING, CLOSING]):
        smu.receive(request, float(index))
        assert smu.transmit(index + 0.9) == reply


@pytest.mark.parametrize(
    ("reply", "error"),
    [
        (b"+1.000000E-04,+2.345679E+04;+1.000000E-04,+2.345679E+04;15\n", OutOfStep),  # another current
        (b"+1.000000E-05,+2.345679E+04;+1.000000E-05,+2.345678E+04;15\n", Corrupt),
        (b"+2.345679E+04;+2.345679E+04;15\n", Corrupt),
        (b"+1.000000E-05,2.345679E+04;+1.000000E-05,2.345679E+04;15\n", Corrupt),
        (b"+1.000000E-05,+2.345679E+04;+1.000000E-05,+2.345679E+04;14\n", OutOfStep),
    ],
)
def test_what_is_no_answer(attach: Attach, clock: VirtualClock, reply: bytes, error: type[InstrumentError]) -> None:
    meter, conversation = scripted(
        "keithley2400", attach, clock, [*CONFIGURE, OUTPUT_ON, (READING[0], reply)], first_token=7
    )
    meter.configure(True, 1.0, 1e-3)
    with pytest.raises(error):
        meter.read()
    conversation.assert_over()
    assert meter.link.in_doubt


# ---- driver against the emulator ------------------------------------------------------------------


@pytest.fixture
def meter(attach: Attach, clock: VirtualClock, smu: Keithley2400) -> Keithley2400Meter:
    driver = open_meter("keithley2400", attach(smu), clock)
    assert isinstance(driver, Keithley2400Meter)
    return driver


def test_identity(meter: Keithley2400Meter, smu: Keithley2400) -> None:
    assert str(meter.identify()).startswith("Keithley 2400, serial number 1234567")
    smu.identity = "KEITHLEY INSTRUMENTS INC.,MODEL 2450,1,2"
    with pytest.raises(Refused, match="2450"):
        meter.identify()


@pytest.mark.parametrize("four_wire", [True, False])
def test_configuration(meter: Keithley2400Meter, smu: Keithley2400, plant: StillPlant, four_wire: bool) -> None:
    meter.configure(four_wire, 2.0, 1e-3)
    assert (smu.settings["RSEN"], smu.settings["NPLC"], smu.elements) == (int(four_wire), 2.0, ("CURR", "RES"))
    assert not smu.output_is_on
    assert plant.test_current_A == 0.0
    with pytest.raises(ValueError, match="power line cycles"):
        meter.configure(four_wire, 20.0, 1e-3)
    with pytest.raises(ValueError, match="test current"):
        meter.configure(four_wire, 1.0, 1e-8)


def test_output_is_off_before_and_after(meter: Keithley2400Meter, smu: Keithley2400, plant: StillPlant) -> None:
    meter.configure(True, 1.0, 1e-3)
    assert plant.test_current_A == 0.0
    meter.read()
    assert plant.test_current_A == 1e-5
    assert meter.off() is True
    assert plant.test_current_A == 0.0
    assert meter.read().value == pytest.approx(1e4)
    meter.close()
    assert plant.test_current_A == 0.0
    meter.close()


def test_off_is_not_confirmed_by_an_output_that_reads_on(meter: Keithley2400Meter, smu: Keithley2400) -> None:
    meter.configure(True, 1.0, 1e-3)
    meter.read()
    smu.switch_output = lambda on: None  # type: ignore[method-assign]
    assert meter.off() is False


def test_off_and_close_survive_an_unplugged_meter(meter: Keithley2400Meter) -> None:
    meter.configure(True, 1.0, 1e-3)
    protocol_sim.unregister("test-0")
    assert meter.off() is False
    meter.close()


def test_an_output_that_was_switched_off_by_hand_is_a_refusal(
    meter: Keithley2400Meter, smu: Keithley2400, plant: StillPlant
) -> None:
    meter.configure(True, 1.0, 1e-3)
    for _ in range(3):  # until the range has settled
        meter.read()
    smu.switch_output(False)
    with pytest.raises(Refused, match="OUTPUT off") as refused:
        meter.read()
    assert refused.value.code == 803
    assert plant.test_current_A == 0.0
    assert meter.read().value == pytest.approx(1e4)


def test_another_current_than_the_ranges_is_found_out(meter: Keithley2400Meter, smu: Keithley2400) -> None:
    meter.configure(True, 1.0, 1e-3)
    for _ in range(3):
        meter.read()
    smu.choose_range(2e5)  # behind our back
    with pytest.raises(OutOfStep, match="sourced"):
        meter.read()
    assert meter.read().value == pytest.approx(1e4)
