"""The very bytes that drivers and emulators exchange, as `conversations.txt` has them; and answers that are none."""

from __future__ import annotations

import codecs
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from rig.core import errors
from rig.core.clock import VirtualClock
from rig.core.errors import Corrupt, InstrumentError, Refused, TimedOut
from rig.drivers import registry
from rig.drivers.scpi import ScpiLink
from rig.drivers.scpi_meters import set_filter
from rig.ports.open import LineSettings, open_port
from rig.ports.transport import Transport
from sim.instruments.instrument import Instrument, emulated
from tests.rig.drivers.far_ends import Conversation, scripted
from tests.rig.drivers.still_plant import StillPlant

Attach = Callable[[Instrument], str]
Exchange = tuple[bytes, bytes]
Wrong = tuple[bytes, type[InstrumentError]]
TALKS: dict[str, list[Exchange]] = {}  # (request, reply) of each exchange, by heading: driver, and what it is about
WRONG: dict[tuple[str, bytes], list[Wrong]] = {}  # by driver and request: what is no reply


def read_conversations() -> None:
    heading, request = "", b""
    for line in Path(__file__).with_name("conversations.txt").read_text(encoding="utf-8").splitlines():
        kind, text = line[:1], line[2:]
        if kind == "=":
            heading = line[3:]
            TALKS[heading] = []
        elif kind == "!":
            name, _, text = text.partition("  # ")[0].partition(" ")
            WRONG.setdefault((heading, request), []).append((_bytes(text), getattr(errors, name)))
        elif kind == ">":
            request = _bytes(text)
        elif kind == "<":
            TALKS[heading].append((request, _bytes(text)))


def _bytes(text: str) -> bytes:
    return bytes(codecs.escape_decode(text.encode())[0])  # type: ignore[attr-defined]


read_conversations()


def read_ohms(meter: Any) -> None:
    meter.configure(True, 1.0, 1e-3)
    assert meter.read().value == pytest.approx(23456.789, rel=1e-7)
    assert meter.test_current_A == 1e-5
    meter.close()


def read_and_switch_off(controller: Any) -> None:
    assert controller.read_temperature().value == 25.0
    assert controller.off() is True


def drive_a_heater(controller: Any) -> None:
    assert str(controller.identify()) == "TCLab Arduino Uno, serial number , firmware 1.4.0"
    assert controller.transport.clock.now_s() > 2.0  # not before the board has started
    controller.configure(1.0, (10.0, 90.0), 5.0)
    controller.arm_current()
    controller.set_current_A(0.375)
    assert controller.read_temperature().value == 24.77
    assert controller.off() is True


ACTIONS: dict[str, Callable[[Any], None]] = {
    **dict.fromkeys(registry.METERS, read_ohms),
    "keithley2000 filter": lambda meter: set_filter(meter.link, ":SENS:FRES:AVER", 2),
    "srs_ldc500": read_and_switch_off,
    "lakeshore": read_and_switch_off,
    "tclab": drive_a_heater,
}


def talk(name: str, attach: Attach, clock: VirtualClock, exchanges: list[Exchange]) -> tuple[Any, Conversation]:
    driver = name.partition(" ")[0]
    return scripted(driver, attach, clock, exchanges, first_token=4 if driver == "lakeshore" else 7)


@pytest.mark.parametrize("name", TALKS)
def test_the_driver_holds_it(attach: Attach, clock: VirtualClock, name: str) -> None:
    instrument, conversation = talk(name, attach, clock, TALKS[name])
    ACTIONS[name](instrument)
    conversation.assert_over()


@pytest.mark.parametrize("name", TALKS)
def test_the_emulator_holds_it(plant: StillPlant, name: str) -> None:
    plant.resistance_ohm = 23456.789
    driver = name.partition(" ")[0]
    emulator = emulated(driver, plant)
    for index, (request, reply) in enumerate(TALKS[name]):
        emulator.receive(request, float(index))
        assert emulator.transmit(index + 0.9) == reply


# ---- answers that are none ------------------------------------------------------------------------


def before_the_reading(driver: str) -> tuple[list[Exchange], bytes]:
    """Return the exchanges before the reading, and the request for it."""
    index = max(k for k, (request, _) in enumerate(TALKS[driver]) if (driver, request) in WRONG)
    return TALKS[driver][:index], TALKS[driver][index][0]


@pytest.mark.parametrize(
    ("driver", "reply", "error"), [(driver, *wrong) for (driver, _), wrongs in WRONG.items() for wrong in wrongs]
)
def test_a_wrong_answer_is_no_reading(
    attach: Attach, clock: VirtualClock, driver: str, reply: bytes, error: type[InstrumentError]
) -> None:
    """It would be recorded, and controlled by."""
    before, request = before_the_reading(driver)
    instrument, conversation = talk(driver, attach, clock, [*before, (request, reply)])
    with pytest.raises(error):
        ACTIONS[driver](instrument)
    conversation.assert_over()
    assert instrument.link.in_doubt


@pytest.mark.parametrize("reply", [b"25.648\r\n25.648\r\n9\r\n", b"25.648\r\n9\r\n25.648\r\n9", b""])
def test_srs_asks_why_an_answer_is_missing(attach: Attach, clock: VirtualClock, reply: bytes) -> None:
    before, request = before_the_reading("srs_ldc500")
    why = [(b"\n*ESE 11;*ESE?\n", b"11\r\n"), (b"LEXE?;LCME?;*ESE?;*ESE 12\n", b"0\r\n0\r\n11\r\n")]
    controller, conversation = talk("srs_ldc500", attach, clock, [*before, (request, reply), *why])
    with pytest.raises(TimedOut):
        controller.read_temperature()
    conversation.assert_over()


@pytest.mark.parametrize(
    "reply",
    [
        b"25.648\n9\n25.648\n9\n",
        b"25.648\n\r9\n\r25.648\n\r9\n\r",
        b"25.648;9;25.648;9\r\n",
        b"\r\n25.648\r\n9\r\n25.648\r\n9\r\n",
    ],
)
def test_srs_may_end_and_join_its_answers_as_it_likes(attach: Attach, clock: VirtualClock, reply: bytes) -> None:
    before, request = before_the_reading("srs_ldc500")
    again = (request.replace(b"10", b"11"), reply.replace(b"9", b"10"))
    controller, conversation = talk("srs_ldc500", attach, clock, [*before, (request, reply), again])
    assert [controller.read_temperature().value for _ in range(2)] == [25.648, 25.648]
    conversation.assert_over()


SRS_LINE = b"TTRD?;*ESE?;TTRD?;*ESE?;*ESE %d\n"


@pytest.mark.parametrize(
    ("answer", "why"),
    [
        (b"25.648\r\n%d\r\n25.649\r\n%d\r\n", "not twice"),
        (b"18.9256\r\n18.9256\r\n%d\r\n%d\r\n", "about a token"),  # an old answer before a lone token
    ],
)
def test_copies_that_differ_are_asked_for_again(attach: Attach, clock: VirtualClock, answer: bytes, why: str) -> None:
    before, _ = before_the_reading("srs_ldc500")
    differ = [(SRS_LINE % (10 + k), answer % (9 + k, 9 + k)) for k in range(3)]
    good = (SRS_LINE % 12, b"25.65\r\n11\r\n25.65\r\n11\r\n")
    controller, conversation = talk("srs_ldc500", attach, clock, [*before, *differ[:2], good])
    assert controller.read_temperature().value == 25.65
    conversation.assert_over()
    controller, conversation = talk("srs_ldc500", attach, clock, [*before, *differ])
    with pytest.raises(Corrupt, match=why):
        controller.read_temperature()
    conversation.assert_over()


@pytest.mark.parametrize("one", [b"94.77", b"4.77", b"26.09"])
@pytest.mark.parametrize("place", range(3))
def test_one_wrong_conversion_is_never_the_reading(attach: Attach, clock: VirtualClock, one: bytes, place: int) -> None:
    three = [b"24.77", b"24.45", b"24.77"]
    good = (b"T1\nT1\nT1\nP2 0.10\n", b"\r\n".join((*three, b"0.10\r\n")))
    three[place] = one
    hurt = (b"T1\nT1\nT1\nP2 0.09\n", b"\r\n".join((*three, b"0.09\r\n")))
    controller, conversation = talk("tclab", attach, clock, [TALKS["tclab"][0], hurt, good])
    assert controller.read_temperature().value == 24.77
    conversation.assert_over()


@pytest.mark.parametrize("text", [b"TCLab Firmware Version 1.1.0", b"TClab Firmware 0.03", b"Stop", b"24.77"])
def test_who_is_no_board_of_ours(attach: Attach, clock: VirtualClock, text: bytes) -> None:
    controller, _ = talk("tclab", attach, clock, [TALKS["tclab"][0], (b"VER\nP2 0.09\n", text + b"\r\n0.09\r\n")])
    with pytest.raises(Refused, match=r"too old|is no TCLab"):
        controller.identify()


# ---- SCPI: identity, refusals, silence ------------------------------------------------------------

IN_STEP = TALKS["keithley2000"][:2]


def test_an_identity_is_asked_for_alone(attach: Attach, clock: VirtualClock) -> None:
    again = [(b"\x18\r*ESE 10;*ESE?\r", b"10\n"), (b":SYST:ERR?;*ESE?;*ESE 11\r", b'0,"No error";10\n')]
    name = (b"*IDN?\r", b"KEITHLEY INSTRUMENTS INC.,MODEL 2000,0812345,A20  /A02\r\n")
    meter, conversation = talk("keithley2000", attach, clock, [*IN_STEP, name, *again])
    identity = meter.identify()
    assert (identity.model, identity.serial_number, identity.firmware) == ("2000", "0812345", "A20  /A02")
    conversation.assert_over()


def test_half_a_configuration_is_none(attach: Attach, clock: VirtualClock) -> None:
    refused = (TALKS["keithley2000"][2][0], b'-113,"Undefined header";9\n')
    meter, conversation = talk("keithley2000", attach, clock, [*IN_STEP, refused])
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
    meter, conversation = talk("keithley2000", attach, clock, IN_STEP + explained)
    with pytest.raises(Refused, match="Undefined header: :NONSENSE"):
        meter.link.ask(":NONSENSE?")
    conversation.assert_over()


def test_after_silence_the_line_is_brought_in_step_first(attach: Attach, clock: VirtualClock) -> None:
    *configured, settings, reading = TALKS["keithley2000"]
    after = [
        (reading[0], b""),
        (b"\x18\r*ESE 14;*ESE?\r", b"+2.34567890E+04;+2.34567890E+04;12\n14\n"),  # late, then in step
        (b":SYST:ERR?;*ESE?;*ESE 15\r", b'0,"No error";14\n'),
        (settings[0].replace(b"12", b"16"), settings[1].replace(b";11\n", b";15\n")),
        (b":READ?;:FETC?;*ESE?;*ESE 17\r", b"+5.00000000E+04;+5.00000000E+04;16\n"),
    ]
    meter, conversation = talk("keithley2000", attach, clock, [*configured, settings, *after])
    meter.configure(True, 1.0, 1e-3)
    with pytest.raises(TimedOut):
        meter.read()
    assert meter.read().value == 5e4
    conversation.assert_over()


def test_a_proof_that_broke_off_leaves_the_line_in_doubt(attach: Attach, clock: VirtualClock) -> None:
    """A reply that came twice passed for the answer of the error queue, and the next reading was asked for while the
    instrument was still at it: integrated later than its time said."""
    twice = [(b"\x18\r*ESE 8;*ESE?\r", b"8\n"), (b":SYST:ERR?;*ESE?;*ESE 9\r", b"8\n")]
    port = open_port(attach(Conversation(twice)), LineSettings(9600))
    link = ScpiLink(Transport(port, clock), byte_s=1e-3, first_token=7)
    with pytest.raises(Corrupt, match="error queue"):
        link.resynchronise(trials=1)
    assert link.in_doubt
