"""The Keithley 2450's emulator and driver: elements in the question, test currents by range, output, dated errors."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

from rig.core.clock import VirtualClock
from rig.core.errors import Corrupt, InstrumentError, OutOfStep, Refused
from rig.drivers.keithley2450 import Keithley2450Meter
from rig.drivers.registry import open_meter
from rig.ports.pseudo_terminal import PseudoTerminals
from sim.instruments.instrument import Instrument
from sim.instruments.keithley2450 import Keithley2450
from tests.rig.drivers.conversation import scripted
from tests.rig.drivers.far_ends import Host
from tests.rig.drivers.still_plant import StillPlant

Attach = Callable[[Instrument], str]


@pytest.fixture
def smu(plant: StillPlant) -> Keithley2450:
    return Keithley2450(plant)


@pytest.fixture
def host(smu: Keithley2450) -> Host:
    return Host(smu, b"\n")


# ---- emulator -------------------------------------------------------------------------------------


def test_ohms_as_the_manual_has_them(host: Host, plant: StillPlant) -> None:
    plant.resistance_ohm = 12345.678
    for message in ("*RST", 'SENS:FUNC "RES"', "SENS:RES:RANG 20E3", "SENS:RES:RSEN ON", "SENS:RES:NPLC 1", "OUTP ON"):
        assert host.say(message) == ""
    assert plant.test_current_A == 100e-6
    assert host.say("READ?") == "1.234568E+04"
    assert host.say('READ? "defbuffer1", SOUR, READ') == "1.000000E-04, 1.234568E+04"
    assert host.say('FETC? "defbuffer1",READ,SOUR') == "1.234568E+04, 1.000000E-04"
    host.say(":FORM:ASC:PREC 10")
    assert host.say(":READ?") == "1.234567800E+04"
    assert host.say(":SENS:RES:RANG?;RSEN?;:SENS:FUNC?") == '20000;1;"RES"'
    host.say("OUTP OFF")
    assert plant.test_current_A == 0.0


def test_beyond_the_range_and_no_number(host: Host, plant: StillPlant) -> None:
    host.say('SENS:FUNC "RES";:SENS:RES:RANG 20E3;:OUTP ON')
    for ohm, text in ((21001.0, "9.900000E+37"), (-math.inf, "-9.900000E+37"), (math.nan, "9.910000E+37")):
        plant.resistance_ohm = ohm
        assert host.say("READ?") == text
    plant.resistance_ohm = 21001.0
    host.say("SENS:RES:RANG:AUTO ON")
    assert host.say("READ?", 5.0) == "2.100100E+04"
    assert plant.test_current_A == 10e-6


def test_volts(host: Host, plant: StillPlant) -> None:
    plant.voltage_V = -0.25
    host.say('SOUR:FUNC CURR;:SOUR:CURR 0;:SENS:FUNC "VOLT:DC";:SENS:VOLT:RANG 2;:OUTP ON')
    assert host.say('READ? "defbuffer1",SOUR,READ') == "0.000000E+00, -2.500000E-01"
    plant.voltage_V = 3.0
    assert host.say("READ?") == "9.900000E+37"
    host.say(":SOUR:CURR 1E-3")
    plant.resistance_ohm = 500.0
    assert host.say("READ?") == "5.000000E-01"


@pytest.mark.parametrize(
    ("message", "error"),
    [
        (":BOGUS", "-113,"),
        (':SENS:FUNC "X"', "-224,"),
        (':READ? "defbuffer1",X', "-224,"),
        (":SENS:RES:RANG 1E9", "-222,"),
        (":READ?", "-221,"),  # with the output off
        (":MEAS:RES?", "-221,"),
    ],
)
def test_errors_have_a_date(host: Host, message: str, error: str) -> None:
    assert host.say(message) == ""
    found = host.say(":SYST:ERR?")
    assert found.startswith(error)
    assert found.endswith(';1;2026/01/01 00:00:00.000"')
    assert host.say(":SYST:ERR?") == '0,"No error;0;0 0"'


# ---- conversations ------------------------------------------------------------------------------

NONE = b'0,"No error;0;0 0"'
IN_STEP = [(b"\n*ESE 8;*ESE?\n", b"8\n"), (b":SYST:ERR?;*ESE?;*ESE 9\n", NONE + b";8\n")]
CONFIGURE = [
    *IN_STEP,
    (b"*RST;:SYST:ERR?;*ESE?;*ESE 10\n", NONE + b";9\n"),
    (b':SENS:FUNC "RES";:SENS:RES:NPLC 1;:SENS:RES:RSEN 1;:SYST:ERR?;*ESE?;*ESE 11\n', NONE + b";10\n"),
    (
        b":SENS:RES:RANG:AUTO 0;:SENS:RES:RANG 200000;:FORM:ASC:PREC 8;:SYST:ERR?;*ESE?;*ESE 12\n",
        NONE + b";11\n",
    ),
    (
        b":SENS:FUNC?;:SENS:RES:NPLC?;:SENS:RES:RSEN?;:SENS:RES:RANG:AUTO?;:SENS:RES:RANG?;:FORM:ASC:PREC?"
        b";:SOUR:FUNC?;:OUTP?;*ESE?;*ESE 13\n",
        b'"RES";1;1;0;200000;8;VOLT;0;12\n',
    ),
]
OUTPUT_ON = (b":OUTP ON;:SYST:ERR?;*ESE?;*ESE 14\n", NONE + b";13\n")
READING = (
    b':READ? "defbuffer1",SOUR,READ;:FETC? "defbuffer1",SOUR,READ;*ESE?;*ESE 15\n',
    b"1.0000000E-05, 2.3456789E+04;1.0000000E-05, 2.3456789E+04;14\n",
)
CLOSING = (b":OUTP OFF;:OUTP?;*ESE?;*ESE 16\n", b"0;15\n")


def test_conversation_of_a_reading(attach: Attach, clock: VirtualClock) -> None:
    meter, conversation = scripted(
        "keithley2450", attach, clock, [*CONFIGURE, OUTPUT_ON, READING, CLOSING], first_token=7
    )
    meter.configure(True, 1.0, 1e-3)
    assert meter.read().value == 23456.789
    meter.close()
    conversation.assert_over()


def test_the_emulator_holds_the_same_conversation(plant: StillPlant, smu: Keithley2450) -> None:
    plant.resistance_ohm = 23456.789
    for index, (request, reply) in enumerate([*CONFIGURE, OUTPUT_ON, READING, CLOSING]):
        smu.receive(request, float(index))
        assert smu.transmit(index + 0.9) == reply


@pytest.mark.parametrize(
    ("reply", "error"),
    [
        (b"1.0000000E-04, 2.3456789E+04;1.0000000E-04, 2.3456789E+04;14\n", OutOfStep),  # another current
        (b"1.0000000E-05, 2.3456789E+04;1.0000000E-05, 2.3456788E+04;14\n", Corrupt),
        (b"2.3456789E+04;2.3456789E+04;14\n", Corrupt),
        (b"1.0000000E-05, 2.3456789E+04;1.0000000E-05, 2.3456789E+04;13\n", OutOfStep),
    ],
)
def test_what_is_no_answer(attach: Attach, clock: VirtualClock, reply: bytes, error: type[InstrumentError]) -> None:
    meter, conversation = scripted(
        "keithley2450", attach, clock, [*CONFIGURE, OUTPUT_ON, (READING[0], reply)], first_token=7
    )
    meter.configure(True, 1.0, 1e-3)
    with pytest.raises(error):
        meter.read()
    conversation.assert_over()
    assert meter.link.in_doubt


# ---- driver against the emulator ------------------------------------------------------------------


@pytest.fixture
def meter(attach: Attach, clock: VirtualClock, smu: Keithley2450) -> Keithley2450Meter:
    driver = open_meter("keithley2450", attach(smu), clock)
    assert isinstance(driver, Keithley2450Meter)
    return driver


def test_identity(meter: Keithley2450Meter, smu: Keithley2450) -> None:
    assert str(meter.identify()) == "Keithley 2450, serial number 04096331, firmware 1.7.0e"
    smu.identity = "KEITHLEY INSTRUMENTS INC.,MODEL 2400,1,2"
    with pytest.raises(Refused, match="2400"):
        meter.identify()


def test_output_is_off_before_and_after(meter: Keithley2450Meter, smu: Keithley2450, plant: StillPlant) -> None:
    meter.configure(False, 1.0, 1e-3)
    assert (plant.test_current_A, smu.settings["RES:RSEN"]) == (0.0, 0)
    meter.read()
    assert plant.test_current_A == 1e-5
    assert meter.off() is True
    assert plant.test_current_A == 0.0
    assert meter.read().value == pytest.approx(1e4)
    smu.switch_output = lambda on: None  # type: ignore[method-assign]
    assert meter.off() is False


def test_an_output_that_was_switched_off_by_hand_is_a_refusal(meter: Keithley2450Meter, smu: Keithley2450) -> None:
    meter.configure(True, 1.0, 1e-3)
    for _ in range(3):
        meter.read()
    smu.switch_output(False)
    with pytest.raises(Refused, match="Settings conflict: ") as refused:
        meter.read()
    assert refused.value.code == -221


def test_a_voltage(attach: Attach, clock: VirtualClock, plant: StillPlant) -> None:
    address = attach(Keithley2450(plant))
    detector = open_meter(
        "keithley2450", address, clock, formula="2 * voltage_V", output="curvature_per_m", range_V=1.0
    )
    plant.voltage_V = -0.25
    detector.configure(True, 0.1, 1e-3)
    assert detector.read().value == pytest.approx(-0.5)
    assert plant.test_current_A == 0.0


# ---- PyMeasure ------------------------------------------------------------------------------------


@pytest.mark.filterwarnings("ignore")
def test_pymeasure(plant: StillPlant) -> None:
    pytest.importorskip("pyvisa_py", reason="pyvisa-py is not installed")
    keithley = pytest.importorskip("pymeasure.instruments.keithley", reason="PyMeasure is not installed")
    with PseudoTerminals({"meter": Keithley2450(plant)}) as terminals:
        meter: Any = keithley.Keithley2450(
            f"ASRL{terminals.paths['meter']}::INSTR", visa_library="@py", read_termination="\n", timeout=2000
        )
        try:
            assert "MODEL 2450" in meter.id
            plant.resistance_ohm = 1234.5
            meter.measure_resistance(nplc=0.1, resistance=2e3, auto_range=False)
            meter.wires = 4
            assert (meter.wires, meter.resistance_range, meter.resistance_nplc) == (4, 2e3, 0.1)
            meter.enable_source()
            assert meter.resistance == 1234.5
            assert plant.test_current_A == 1e-3
            meter.source_mode = "current"
            meter.source_current = 5e-4
            meter.compliance_voltage = 10.0
            assert meter.compliance_voltage == 10.0
            meter.measure_voltage(nplc=0.1, voltage=2.0, auto_range=False)
            assert meter.voltage == pytest.approx(0.61725)
            meter.disable_source()
            assert not int(meter.ask("OUTP?"))
            assert plant.test_current_A == 0.0
        finally:
            meter.adapter.close()
