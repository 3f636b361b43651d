"""The Keithley 2000 driver: the very bytes, ranges by test current, overrange, a line out of step."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from rig.core.clock import VirtualClock
from rig.core.errors import Corrupt, InstrumentError, OutOfStep, Refused, TimedOut
from rig.core.reading import Quality
from rig.drivers.keithley2000 import Keithley2000Meter
from rig.drivers.meter import on_since_s, resistance_reading
from rig.drivers.registry import open_meter
from sim.instruments.instrument import Instrument
from sim.instruments.keithley2000 import Keithley2000
from tests.rig.drivers.conversation import scripted
from tests.rig.drivers.still_plant import StillPlant

Attach = Callable[[Instrument], str]

IN_STEP = [(b"\x18\r*ESE 8;*ESE?\r", b"8\n"), (b":SYST:ERR?;*ESE?;*ESE 9\r", b'0,"No error";8\n')]
CONFIGURE = [
    *IN_STEP,
    (
        b":CONF:FRES;:INIT:CONT 0;:TRIG:COUN 1;:SENS:FRES:NPLC 1;:SYST:ERR?;*ESE?;*ESE 10\r",
        b'0,"No error";9\n',
    ),
    (b":SENS:FRES:RANG:AUTO 0;:SENS:FRES:RANG 100000;:SYST:ERR?;*ESE?;*ESE 11\r", b'0,"No error";10\n'),
    (
        b":SENS:FUNC?;:SENS:FRES:NPLC?;:SENS:FRES:RANG:AUTO?;:SENS:FRES:RANG?;*ESE?;*ESE 12\r",
        b'"FRES";1.00;0;+1.00000000E+05;11\n',
    ),
]
READING = [(b":READ?;:FETC?;*ESE?;*ESE 13\r", b"+2.34567890E+04;+2.34567890E+04;12\n")]


def test_conversation_of_a_reading(attach: Attach, clock: VirtualClock) -> None:
    meter, conversation = scripted("keithley2000", attach, clock, CONFIGURE + READING)
    meter.configure(True, 1.0, 1e-3)
    reading = meter.read()
    assert (reading.value, reading.quality) == (23456.789, Quality.OK)
    assert meter.test_current_A == 1e-5
    conversation.assert_over()


def test_the_emulator_holds_the_same_conversation(plant: StillPlant) -> None:
    plant.resistance_ohm = 23456.789
    meter = Keithley2000(plant)
    time_s = 0.0
    for request, reply in CONFIGURE + READING:
        meter.receive(request, time_s)
        time_s += 1.0
        assert meter.transmit(time_s) == reply


def test_conversation_of_an_identification(attach: Attach, clock: VirtualClock) -> None:
    again = [(b"\x18\r*ESE 10;*ESE?\r", b"10\n"), (b":SYST:ERR?;*ESE?;*ESE 11\r", b'0,"No error";10\n')]
    name = (b"*IDN?\r", b"KEITHLEY INSTRUMENTS INC.,MODEL 2000,0812345,A20  /A02\r\n")
    meter, conversation = scripted("keithley2000", attach, clock, [*IN_STEP, name, *again])
    identity = meter.identify()
    assert (identity.model, identity.serial_number, identity.firmware) == ("2000", "0812345", "A20  /A02")
    conversation.assert_over()


def test_conversation_of_a_refusal(attach: Attach, clock: VirtualClock) -> None:
    refused = [(CONFIGURE[2][0], b'-113,"Undefined header";9\n')]
    meter, conversation = scripted("keithley2000", attach, clock, CONFIGURE[:2] + refused)
    with pytest.raises(Refused, match="Undefined header") as error:
        meter.configure(True, 1.0, 1e-3)
    assert error.value.code == -113
    conversation.assert_over()
    with pytest.raises(Refused, match="not configured"):
        meter.start_reading()


def test_silence_is_explained_by_the_error_queue(attach: Attach, clock: VirtualClock) -> None:
    explained = [
        (b":NONSENSE?;*ESE?;*ESE 10\r", b""),
        (b"\x18\r*ESE 11;*ESE?\r", b"11\n"),
        (b":SYST:ERR?;*ESE?;*ESE 12\r", b'-113,"Undefined header";11\n'),
        (b":SYST:ERR?;*ESE?;*ESE 13\r", b"0,No error;12\n"),
    ]
    meter, conversation = scripted("keithley2000", attach, clock, IN_STEP + explained)
    with pytest.raises(Refused, match="Undefined header: :NONSENSE"):
        meter.link.ask(":NONSENSE?")
    conversation.assert_over()


@pytest.mark.parametrize(
    ("reply", "error"),
    [
        (b"+2.34567890E+04;+2.34567890E+04;11\n", OutOfStep),  # the reading before, once more
        (b"+2.34567890E+04;+2.34567890E+04;0\n", OutOfStep),  # restarted in between
        (b"+2.34567890E+04;+2.34567891E+04;12\n", Corrupt),  # a flipped digit
        (b"+2.3456789E+04;+2.34567890E+04;12\n", Corrupt),  # a lost one
        (b"+2.34567890E+04;12\n", Corrupt),
        (b"2.34567890E+04;2.34567890E+04;12\n", Corrupt),
        (b"+2.3\xff567890E+04;+2.3\xff567890E+04;12\n", Corrupt),
        (b"+2.34567890E+04\n", Corrupt),
        (b"KEITHLEY INSTRUMENTS INC.,MODEL 2000,0812345,A20  /A02\n", Corrupt),
        (b"\n", Corrupt),
        (b"+2.34567890E+04;+2.34567890E+04;12", TimedOut),  # no terminator
        (b"", TimedOut),
    ],
)
def test_what_is_no_answer(attach: Attach, clock: VirtualClock, reply: bytes, error: type[InstrumentError]) -> None:
    meter, conversation = scripted("keithley2000", attach, clock, [*CONFIGURE, (READING[0][0], reply)])
    meter.configure(True, 1.0, 1e-3)
    with pytest.raises(error):
        meter.read()
    conversation.assert_over()
    assert meter.link.in_doubt


def test_after_silence_the_line_is_brought_in_step_first(attach: Attach, clock: VirtualClock) -> None:
    after = [
        (READING[0][0], b""),
        (b"\x18\r*ESE 14;*ESE?\r", b"+2.34567890E+04;+2.34567890E+04;12\n14\n"),  # late, then in step
        (b":SYST:ERR?;*ESE?;*ESE 15\r", b'0,"No error";14\n'),
        (CONFIGURE[4][0].replace(b"12", b"16"), CONFIGURE[4][1].replace(b";11\n", b";15\n")),
        (b":READ?;:FETC?;*ESE?;*ESE 17\r", b"+5.00000000E+04;+5.00000000E+04;16\n"),
    ]
    meter, conversation = scripted("keithley2000", attach, clock, CONFIGURE + after)
    meter.configure(True, 1.0, 1e-3)
    with pytest.raises(TimedOut):
        meter.read()
    assert meter.read().value == 5e4
    conversation.assert_over()


# ---- against the emulator -------------------------------------------------------------------------


@pytest.fixture
def dmm(plant: StillPlant) -> Keithley2000:
    return Keithley2000(plant)


@pytest.fixture
def meter(attach: Attach, clock: VirtualClock, dmm: Keithley2000) -> Keithley2000Meter:
    driver = open_meter("keithley2000", attach(dmm), clock)
    assert isinstance(driver, Keithley2000Meter)
    return driver


def test_identity(meter: Keithley2000Meter) -> None:
    assert str(meter.identify()) == "Keithley 2000, serial number 1234567, firmware A20  /A02"


@pytest.mark.parametrize(("four_wire", "function"), [(True, "FRES"), (False, "RES")])
def test_configuration(meter: Keithley2000Meter, dmm: Keithley2000, four_wire: bool, function: str) -> None:
    meter.configure(four_wire, 5.0, 1e-3)
    assert dmm.function == function
    assert dmm.settings[f"{function}:NPLC"] == 5.0
    assert dmm.settings[f"{function}:RANG:AUTO"] == 0


def test_first_reading_after_a_change_of_range_is_settling(meter: Keithley2000Meter, plant: StillPlant) -> None:
    meter.configure(True, 1.0, 1e-3)
    plant.resistance_ohm = 5e4
    assert meter.read().quality is Quality.OK
    plant.resistance_ohm = 5e3
    assert [meter.read().quality for _ in range(3)] == [Quality.OK, Quality.SETTLING, Quality.OK]
    assert meter.test_current_A == 1e-4


def test_overrange_is_a_quality_and_the_next_range_is_tried(meter: Keithley2000Meter, plant: StillPlant) -> None:
    meter.configure(True, 1.0, 1e-3)
    plant.resistance_ohm = 3e5
    reading = meter.read()
    assert (reading.value, reading.quality) == (math.inf, Quality.OVERRANGE)
    assert meter.read().value == pytest.approx(3e5)
    plant.resistance_ohm = math.inf
    for _ in range(5):
        assert meter.read().quality is Quality.OVERRANGE
    assert meter.full_scale == 1e8


@pytest.mark.parametrize("resistance_ohm", [-5.0, 0.0, math.nan])
def test_impossible_resistance_is_invalid(meter: Keithley2000Meter, plant: StillPlant, resistance_ohm: float) -> None:
    meter.configure(True, 1.0, 1e-3)
    plant.resistance_ohm = resistance_ohm
    assert meter.read().quality is Quality.INVALID


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


def test_time_is_the_middle_of_the_integration(
    meter: Keithley2000Meter, plant: StillPlant, clock: VirtualClock
) -> None:
    meter.configure(True, 2.0, 1e-3)
    clock.sleep_until_s(10.0)
    reading = meter.read()
    assert reading.time_s == pytest.approx(plant.sampled_s)
    assert 10.02 < reading.time_s < 10.06


def test_a_reading_can_wait_while_other_things_happen(
    meter: Keithley2000Meter, plant: StillPlant, clock: VirtualClock
) -> None:
    meter.configure(True, 1.0, 1e-3)
    begin_s = clock.now_s()
    meter.start_reading()
    assert clock.now_s() == begin_s
    clock.sleep_until_s(begin_s + 0.09)
    assert meter.finish_reading().value == pytest.approx(1e4)
    assert clock.now_s() == begin_s + 0.09


def test_a_reading_that_came_while_nobody_looked_is_taken_however_late(
    meter: Keithley2000Meter, clock: VirtualClock
) -> None:
    """A controller that is silent keeps the loop from its meter for longer than an answer may take."""
    meter.configure(True, 1.0, 1e-3)
    meter.start_reading()
    clock.sleep_until_s(clock.now_s() + 5.0)
    assert meter.finish_reading().value == pytest.approx(1e4)


def test_readings_cannot_be_mixed_up(meter: Keithley2000Meter) -> None:
    meter.configure(True, 1.0, 1e-3)
    with pytest.raises(OutOfStep):
        meter.finish_reading()
    meter.start_reading()
    with pytest.raises(OutOfStep):
        meter.start_reading()
    assert meter.read().is_number


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


def test_it_is_known_since_when_the_test_current_of_a_new_range_is_on(
    meter: Keithley2000Meter, plant: StillPlant
) -> None:
    meter.configure(True, 1.0, 1e-3)
    plant.resistance_ohm = 5e3
    meter.read()
    assert math.isnan(on_since_s(meter))
    changed = meter.read()
    on_s = on_since_s(meter)
    assert changed.time_s - on_s == pytest.approx(0.01)  # half of a line's period: the integration begins with it
    meter.read()
    assert on_since_s(meter) == on_s
    meter.off()
    meter.read()
    assert math.isnan(on_since_s(meter))
