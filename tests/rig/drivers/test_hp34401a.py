"""The 34401A's emulator and driver: remote mode, one question at a time, readings that are kept or not, ranges."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from rig.core.clock import VirtualClock
from rig.core.errors import Corrupt, InstrumentError, OutOfStep, Refused, TimedOut
from rig.drivers.hp34401a import Hp34401AMeter
from rig.drivers.registry import open_meter
from rig.ports.open import LineSettings
from sim.instruments.hp34401a import Hp34401A
from sim.instruments.instrument import Instrument
from tests.rig.drivers.conversation import scripted
from tests.rig.drivers.far_ends import Host
from tests.rig.drivers.still_plant import StillPlant

Attach = Callable[[Instrument], str]


@pytest.fixture
def dmm(plant: StillPlant) -> Hp34401A:
    return Hp34401A(plant)


@pytest.fixture
def host(dmm: Hp34401A) -> Host:
    host = Host(dmm, end=b"\n")
    host.say("SYST:REM")
    return host


# ---- emulator -------------------------------------------------------------------------------------


def test_recipe_of_the_fact_sheet(host: Host, plant: StillPlant) -> None:
    plant.resistance_ohm = 456.789
    assert host.say("*IDN?").startswith("HEWLETT-PACKARD,34401A,0,")
    assert host.say("CONF:FRES 1000,0.001") == ""
    assert host.say("FUNC?") == '"FRES"'
    assert host.say("FRES:RANG?") == "+1.00000000E+03"
    assert host.say("FRES:RANG:AUTO?") == "0"
    assert host.say("READ?") == "+4.56789000E+02"
    assert host.say("INIT") == ""
    assert host.say("FETC?") == "+4.56789000E+02"
    assert host.say('FUNC "RES"') == ""
    assert host.say("FUNC?") == '"RES"'
    assert host.say("MEAS:RES?", 3.0) == "+4.56789000E+02"
    assert host.say("SYST:ERR?") == '+0,"No error"'


def test_overload(host: Host, plant: StillPlant) -> None:
    host.say("CONF:RES 1000")
    plant.resistance_ohm = 1201.0
    assert host.say("READ?") == "+9.90000000E+37"
    plant.resistance_ohm = -math.inf
    assert host.say("READ?") == "-9.90000000E+37"


def test_before_remote_mode_it_takes_little(dmm: Hp34401A) -> None:
    host = Host(dmm, end=b"\n")
    assert host.say("*IDN?").startswith("HEWLETT")
    assert host.say("CONF:RES") == ""
    assert dmm.function == "VOLT"
    assert host.say("READ?") == ""
    assert host.say("SYST:ERR?") == '550,"Command not allowed in local"'
    host.say("SYST:RWL")
    host.say("CONF:RES")
    assert dmm.function == "RES"
    host.say("SYST:LOC")
    assert host.say("FUNC?") == ""


@pytest.mark.parametrize("name", ['"FRES"', "'fres'", '"FRESistance"'])
def test_function_in_either_quote(host: Host, name: str) -> None:
    host.say(f"SENS:FUNC {name}")
    assert host.say(":sense:function?") == '"FRES"'


@pytest.mark.parametrize(("nplc", "kept"), [("0.02", 0.02), ("0.1", 0.2), ("10", 10), ("MAX", 100), ("MIN", 0.02)])
def test_integration_times(host: Host, nplc: str, kept: float) -> None:
    host.say(f"RES:NPLC {nplc}")
    assert float(host.say("RES:NPLC?")) == kept


@pytest.mark.parametrize(
    ("message", "code"),
    [
        ("FETC?", -230),
        ("FUNC 'X'", -224),
        ("RES:RANG 121e6", -222),
        ("BOGUS", -113),
        ("READ", -113),
        ("*ESE 256", -222),
    ],
)
def test_refusals_go_into_the_queue(host: Host, message: str, code: int) -> None:
    assert host.say(message) == ""
    assert host.say("SYST:ERR?").startswith(f"{code},")


def test_a_reading_is_kept_by_initiate_only(host: Host, plant: StillPlant) -> None:
    host.say("CONF:RES 10000")
    host.say("INIT")
    plant.resistance_ohm = 5000.0
    assert host.say("FETC?;FETC?") == "+1.00000000E+04;+1.00000000E+04"
    assert host.say("READ?") == "+5.00000000E+03"
    assert host.say("FETC?") == ""
    assert host.say("DATA:POIN?") == "+0"


def test_it_holds_off_while_an_answer_is_due(host: Host, dmm: Hp34401A) -> None:
    host.say("CONF:RES 10000")
    dmm.receive(b"READ?\n", host.time_s)
    dmm.transmit(host.time_s + 0.02)
    dmm.receive(b"FUNC?\n", host.time_s + 0.02)  # fits into the ten characters
    dmm.receive(b"FUNC?\n", host.time_s + 0.03)  # does not
    assert host.say("") == '+1.00000000E+04\r\n"RES"'
    assert host.say("") == ""  # ends what has arrived of the second
    assert host.say("SYST:ERR?") == '512,"RS-232 overrun error"'
    assert host.say("FUNC?") == '"RES"'


def test_a_long_message_does_not_fit(host: Host) -> None:
    host.say("*CLS;" * 20 + "FUNC?")
    assert host.say("SYST:ERR?") == '+0,"No error"'
    assert host.say("*CLS;" * 21 + "FUNC?") != '"VOLT"'


def test_control_c_discards_everything(host: Host, dmm: Hp34401A) -> None:
    host.say("CONF:RES 10000;:RES:NPLC 100")
    dmm.receive(b"READ?\n", host.time_s)
    dmm.transmit(host.time_s + 0.5)
    dmm.receive(b"\x03", host.time_s + 0.5)
    dmm.receive(b"*OPC?\n", host.time_s + 0.6)
    assert host.say("") == "1"
    assert host.say("") == ""


def test_two_stop_bits(plant: StillPlant) -> None:
    dmm = Hp34401A(plant, baudrate=9600, command_s=0.0)
    dmm.remote = True
    dmm.receive(b"*OPC?\n", 0.0)
    assert dmm.transmit(6 * 11 / 9600) == b""
    assert dmm.next_transmit_s() == pytest.approx((6 + 3) * 11 / 9600)


# ---- conversations --------------------------------------------------------------------------------

IN_STEP = [
    (b"\x03", b""),
    (b"\nSYST:REM\n*ESE 8;*ESE?\n", b"+8\r\n"),
    (b":SYST:ERR?;*ESE?;*ESE 9\n", b'+0,"No error";+8\r\n'),
]
CONFIGURE = [
    *IN_STEP,
    (
        b":CONF:FRES;:TRIG:COUN 1;:SAMP:COUN 1;:FRES:NPLC 1;:SYST:ERR?;*ESE?;*ESE 10\n",
        b'+0,"No error";+9\r\n',
    ),
    (b":FRES:RANG 100000;:SYST:ERR?;*ESE?;*ESE 11\n", b'+0,"No error";+10\r\n'),
    (
        b":FUNC?;:FRES:NPLC?;:FRES:RANG:AUTO?;:FRES:RANG?;*ESE?;*ESE 12\n",
        b'"FRES";+1.00000000E+00;0;+1.00000000E+05;+11\r\n',
    ),
]
READING = (b"INIT;FETC?;FETC?;*ESE?;*ESE 13\n", b"+2.34567890E+04;+2.34567890E+04;+12\r\n")


def test_conversation_of_a_reading(attach: Attach, clock: VirtualClock) -> None:
    meter, conversation = scripted("hp34401a", attach, clock, [*CONFIGURE, READING])
    meter.configure(True, 1.0, 1e-3)
    assert meter.read().value == 23456.789
    assert meter.test_current_A == 1e-5
    conversation.assert_over()


def test_the_emulator_holds_the_same_conversation(plant: StillPlant) -> None:
    plant.resistance_ohm = 23456.789
    dmm = Hp34401A(plant)
    for index, (request, reply) in enumerate([*CONFIGURE, READING]):
        dmm.receive(request, float(index))
        assert dmm.transmit(index + 0.9) == reply


@pytest.mark.parametrize(
    ("reply", "error"),
    [
        (b"+2.34567890E+04;+2.34567890E+04;+11\r\n", Corrupt),  # the reading before: a token with a sign
        (b"+2.34567890E+04;+2.34567890E+04;11\r\n", OutOfStep),
        (b"+2.34567890E+04;+2.34567891E+04;+12\r\n", Corrupt),
        (b"+2.34567890E+04;+12\r\n", Corrupt),
        (b"+2.34567890E+04;+2.34567890E+04;+12\r", TimedOut),
    ],
)
def test_what_is_no_answer(attach: Attach, clock: VirtualClock, reply: bytes, error: type[InstrumentError]) -> None:
    meter, conversation = scripted("hp34401a", attach, clock, [*CONFIGURE, (READING[0], reply)])
    meter.configure(True, 1.0, 1e-3)
    with pytest.raises(error):
        meter.read()
    conversation.assert_over()
    assert meter.link.in_doubt


# ---- driver against the emulator ------------------------------------------------------------------


@pytest.fixture
def meter(attach: Attach, clock: VirtualClock, dmm: Hp34401A) -> Hp34401AMeter:
    driver = open_meter("hp34401a", attach(dmm), clock)
    assert isinstance(driver, Hp34401AMeter)
    return driver


def test_line_and_identity(meter: Hp34401AMeter, dmm: Hp34401A) -> None:
    assert LineSettings(9600, 7, "E", 2) == meter.LINE
    assert meter.LINE.byte_s == pytest.approx(11 / 9600)
    assert str(meter.identify()).startswith("HP 34401A")
    dmm.identity = "KEITHLEY INSTRUMENTS INC.,MODEL 2000,1,2"
    with pytest.raises(Refused, match="2000"):
        meter.identify()


@pytest.mark.parametrize("nplc", [0.01, 0.5, 5.0, math.nan])
def test_integration_times_are_five(meter: Hp34401AMeter, nplc: float) -> None:
    with pytest.raises(ValueError, match=r"0\.02, 0\.2, 1, 10, 100"):
        meter.configure(True, nplc, 1e-3)


@pytest.mark.parametrize(("four_wire", "function"), [(True, "FRES"), (False, "RES")])
def test_configuration(meter: Hp34401AMeter, dmm: Hp34401A, four_wire: bool, function: str) -> None:
    meter.configure(four_wire, 10.0, 1e-3)
    assert (dmm.function, dmm.settings[f"{function}:NPLC"], dmm.settings[f"{function}:RANG:AUTO"]) == (function, 10, 0)
    assert dmm.remote


def test_messages_are_short_and_alone(attach: Attach, clock: VirtualClock, plant: StillPlant) -> None:
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


def test_off_stops_the_test_current(meter: Hp34401AMeter, dmm: Hp34401A, plant: StillPlant) -> None:
    meter.configure(True, 0.2, 1e-3)
    meter.read()
    assert plant.test_current_A > 0.0
    assert meter.off()
    assert plant.test_current_A == 0.0
    assert meter.read().value == pytest.approx(1e4)
    assert plant.test_current_A == meter.test_current_A
    dmm.choose_function = lambda function: None  # type: ignore[method-assign]
    assert not meter.off()
