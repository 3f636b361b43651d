"""The emulated Keithley 2000: messages, ranges, timing, triggers, errors."""

from __future__ import annotations

import math

import pytest

from sim.instruments.keithley2000 import RANGES, Keithley2000, Range
from tests.rig.drivers.far_ends import Host
from tests.rig.drivers.still_plant import StillPlant


@pytest.fixture
def meter(plant: StillPlant) -> Keithley2000:
    return Keithley2000(plant)


@pytest.fixture
def host(meter: Keithley2000) -> Host:
    return Host(meter)


def test_observed_exchange(host: Host, plant: StillPlant) -> None:
    """Observed between an independent client and a stand-in for the meter."""
    plant.resistance_ohm = 100.234567
    assert host.say(":CONF:FRES") == ""
    assert host.say(":CONF?") == '"FRES"'
    assert host.say(":SENS:FRES:RANG?") == "+1.00000000E+03"
    assert host.say(":READ?") == "+1.00234567E+02"
    assert host.say(":BOGUS") == ""
    assert host.say(":SYST:ERR?") == '-113,"Undefined header"'
    assert host.say(":SYST:ERR?") == '0,"No error"'


def test_identity(host: Host) -> None:
    assert host.say("*IDN?").startswith("KEITHLEY INSTRUMENTS INC.,MODEL 2000,")


@pytest.mark.parametrize("end", [b"\r", b"\n", b"\r\n", b"\n\r"])
def test_terminators(host: Host, end: bytes) -> None:
    assert host.say("*OPC?", end=end) == "1"
    assert host.say("*OPC?", end=end) == "1"


@pytest.mark.parametrize(
    "message",
    [
        ":SENSe:FRESistance:NPLCycles?",
        "sens:fres:nplc?",
        ":Sens1:Fres:NplC?",
        "FRES:NPLC?",
        ":FRES:NPLC?;",
        ";;:FRES:NPLC?",
        " :FRES:NPLC? ",
        ":FRES:DIG 6;NPLC?",
        "*CLS;:FRES:NPLC?",
    ],
)
def test_ways_to_write_a_header(host: Host, message: str) -> None:
    assert host.say(message) == "1.00"
    assert host.say(":SYST:ERR?") == '0,"No error"'


@pytest.mark.parametrize("name", ['"FRES"', "'fres'", '"FRESistance"', "'FRESISTANCE'"])
def test_function_in_either_quote(host: Host, name: str) -> None:
    host.say(f":SENS:FUNC {name}")
    assert host.say(":SENS:FUNC?") == '"FRES"'


@pytest.mark.parametrize(
    ("message", "code"),
    [
        (":SENS:FUNC FRES", -141),
        (":SENS:FUNC 'NONSENSE'", -224),
        (":SENS:FRES:NPLC 11", -222),
        (":SENS:FRES:NPLC nan", -222),
        (":SENS:FRES:NPLC", -109),
        (":SENS:FRES:NPLC five", -120),
        (":SENS:FRES:RANG 121e6", -222),
        (":READ", -113),
        ("*XYZ?", -113),
    ],
)
def test_refusals_go_into_the_queue(host: Host, message: str, code: int) -> None:
    assert host.say(message) == ""
    assert host.say(":SYST:ERR?").startswith(f"{code},")


def test_several_questions_are_answered_in_one_line(host: Host, plant: StillPlant) -> None:
    plant.resistance_ohm = 5000.0
    host.say(":CONF:RES")
    line = host.say(":SENS:RES:NPLC 0.5;:SENS:RES:NPLC?;:READ?;:SENS:RES:RANG?;:SENS:FUNC?")
    assert line == '0.50;+5.00000000E+03;+1.00000000E+04;"RES"'


def test_what_follows_an_error_in_a_message_is_dropped(host: Host) -> None:
    assert host.say(":BOGUS;*OPC?") == ""
    assert host.say("*OPC?;:BOGUS;*IDN?") == "1"


def test_error_queue_holds_ten(host: Host) -> None:
    for _ in range(13):
        host.say(":BOGUS")
    errors = [host.say(":SYST:ERR?") for _ in range(11)]
    assert errors[:9] == ['-113,"Undefined header"'] * 9
    assert errors[9] == '350,"Queue Overflow"'
    assert errors[10] == '0,"No error"'


@pytest.mark.parametrize(
    ("asked_ohm", "full_scale_ohm"), [(0, 100), (100, 100), (120, 100), (121, 1e3), (1e4, 1e4), (120e6, 1e8)]
)
def test_range_that_accommodates(host: Host, plant: StillPlant, asked_ohm: float, full_scale_ohm: float) -> None:
    host.say(":CONF:FRES")
    host.say(f":SENS:FRES:RANG {asked_ohm:g}")
    assert float(host.say(":SENS:FRES:RANG?")) == full_scale_ohm
    assert host.say(":SENS:FRES:RANG:AUTO?") == "0"
    expected = next(entry for entry in RANGES if entry.full_scale_ohm == full_scale_ohm)
    assert plant.test_current_A == expected.test_current_A


@pytest.mark.parametrize("value_ohm", [0.5, 50.0, 700.0, 1.1e3, 2.2e4, 3e5, 4e6, 1.1e8])
def test_autorange_finds_the_range(host: Host, plant: StillPlant, value_ohm: float) -> None:
    plant.resistance_ohm = value_ohm
    host.say(":CONF:FRES")
    assert float(host.say(":READ?")) == pytest.approx(value_ohm, rel=1e-8)
    full_scale_ohm = float(host.say(":SENS:FRES:RANG?"))
    assert value_ohm <= 1.2 * full_scale_ohm
    assert value_ohm >= 0.1 * full_scale_ohm or full_scale_ohm == 100.0


@pytest.mark.parametrize(
    ("value_ohm", "text"),
    [
        (1201.0, "+9.90000000E+37"),
        (math.inf, "+9.90000000E+37"),
        (math.nan, "+9.91000000E+37"),
        (-3.0, "-3.00000000E+00"),
    ],
)
def test_beyond_a_fixed_range(host: Host, plant: StillPlant, value_ohm: float, text: str) -> None:
    host.say(":CONF:RES;:SENS:RES:RANG 1000")
    plant.resistance_ohm = value_ohm
    assert host.say(":READ?") == text


def test_open_input_overflows_in_autorange(host: Host, plant: StillPlant) -> None:
    plant.resistance_ohm = math.inf
    host.say(":CONF:RES")
    assert host.say(":READ?", 5.0) == "+9.90000000E+37"


def test_test_currents_are_one_table(plant: StillPlant) -> None:
    meter = Keithley2000(plant, ranges=(Range(1e3, 2e-3), Range(1e5, 3e-5)))
    host = Host(meter)
    host.say(":CONF:FRES;:SENS:FRES:RANG 1000")
    assert plant.test_current_A == 2e-3
    host.say(":SENS:FRES:RANG 5000")
    assert plant.test_current_A == 3e-5
    host.say(":CONF:VOLT")
    assert plant.test_current_A == 0.0


def test_a_reading_samples_the_middle_of_its_aperture(plant: StillPlant) -> None:
    meter = Keithley2000(plant, baudrate=9600, command_s=0.002, overhead_s=0.004)
    host = Host(meter)
    host.say(":CONF:FRES;:SENS:FRES:NPLC 5;:SENS:FRES:RANG 10000")
    begin_s = host.time_s
    meter.receive(b":READ?\r", begin_s)
    arrived_s = begin_s + 7 / 960 + 0.002
    due_s = begin_s
    while not (data := meter.transmit(due_s)):
        following = meter.next_transmit_s()
        assert following is not None
        assert following > due_s
        due_s = following
    assert plant.sampled_s == pytest.approx(arrived_s + 0.05)
    assert due_s == pytest.approx(arrived_s + 0.1 + 0.004 + len(data) / 960)


def test_commands_wait_for_a_reading(host: Host, meter: Keithley2000, plant: StillPlant) -> None:
    host.say(":CONF:FRES;:SENS:FRES:NPLC 10;:SENS:FRES:RANG 10000")
    meter.receive(b":READ?\r", host.time_s)
    meter.receive(b":SENS:FRES:RANG 100000\r*OPC?\r", host.time_s)
    meter.transmit(host.time_s + 0.15)
    assert plant.test_current_A == 1e-4
    assert host.say("") == "+1.00000000E+04\n1"
    assert plant.test_current_A == 1e-5


def test_initiate_and_fetch(host: Host, plant: StillPlant) -> None:
    host.say(":CONF:RES")
    host.say(":INIT")
    plant.resistance_ohm = 7.0  # too late
    assert host.say(":FETC?") == "+1.00000000E+04"
    assert host.say(":FETC?") == "+1.00000000E+04"
    assert host.say(":SENS:DATA:FRES?") == "+7.00000000E+00"


def test_fetch_waits_for_what_was_initiated(host: Host, meter: Keithley2000) -> None:
    host.say(":CONF:RES;:SENS:RES:NPLC 10")
    meter.receive(b":INIT\r:FETC?\r", host.time_s)
    assert meter.transmit(host.time_s + 0.15) == b""
    assert host.say("") == "+1.00000000E+04"


def test_trigger_count_and_delay(host: Host) -> None:
    host.say(":CONF:RES;:TRIG:COUN 3;:TRIG:DEL 0.2")
    assert host.say(":TRIG:COUN?;:TRIG:DEL?") == "3;0.200"
    assert host.say(":READ?", 0.5) == ""
    assert host.say("") == ",".join(["+1.00000000E+04"] * 3)


@pytest.mark.parametrize("character", [b"\x18", b"\x03"])
def test_abort_discards_everything(host: Host, meter: Keithley2000, character: bytes) -> None:
    host.say(":CONF:RES;:SENS:RES:NPLC 10")
    meter.receive(b"*IDN?\r:READ?\r*ID", host.time_s)
    meter.transmit(host.time_s + 0.02)
    meter.receive(character + b"*OPC?\r", host.time_s + 0.05)
    assert host.say("") == "1"
    assert host.say("") == ""
    assert host.say(":READ?") == "+1.00000000E+04"


def test_reset(host: Host, plant: StillPlant) -> None:
    host.say(":CONF:FRES;:SENS:FRES:NPLC 5;*ESE 17")
    host.say("*RST")
    assert host.say(":CONF?;:SENS:FRES:NPLC?;*ESE?") == '"VOLT:DC";1.00;17'
    assert plant.test_current_A == 0.0
