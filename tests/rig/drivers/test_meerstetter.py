"""The Meerstetter driver: limits, flash, dead man; captured MeCom exchanges, for the emulator and for the link."""

from __future__ import annotations

import math
from binascii import crc_hqx
from collections.abc import Callable

import pytest

from rig.core.clock import VirtualClock
from rig.core.errors import Corrupt, Refused, TimedOut
from rig.drivers.meerstetter import MecomLink, MeerstetterController
from rig.drivers.registry import open_controller
from rig.ports.open import LineSettings, open_port
from rig.ports.transport import Transport
from sim.instruments.instrument import Instrument
from sim.instruments.meerstetter import MeerstetterTec
from tests.rig.drivers.far_ends import Conversation
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


def test_the_flash_is_spared(controller: MeerstetterController, tec: MeerstetterTec, clock: VirtualClock) -> None:
    controller.configure(2.5, (10.0, 95.0), 3.0)
    values = tec._values
    assert (values[2030], values[4010], values[4011], values[2060], values[108]) == (2.5, 10.0, 95.0, 3.0, 1)
    controller.arm_current()
    for step in range(50):
        controller.set_current_A(0.01 * step)
        clock.sleep_until_s(clock.now_s() + 0.1)
    assert tec.flash_writes == 0


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


def test_an_enable_that_reads_on_does_not_matter_after_an_emergency_stop(
    armed: MeerstetterController, plant: StillPlant, tec: MeerstetterTec
) -> None:
    armed.set_current_A(1.0)
    tec._measured[2010] = lambda: 2
    assert armed.off() is True
    assert plant.current_A == 0.0
    assert armed.status().code == 11


def test_a_limit_that_somebody_changed_is_told(controller: MeerstetterController) -> None:
    controller.configure(3.5, (12.0, 85.0), 4.0)
    controller.link.write_float(2060, 0.0)
    assert controller.own_limits().faults(3.5, (12.0, 85.0), 4.0) == ["dead man: reads back 0 s, 4 s is configured"]


# ---- captured exchanges ---------------------------------------------------------------------------

# Source: Meerstetter 5117C and 5136AL (official captures), tests of the sciglob library for the target of 20.0.
# request and reply without their CR, the call of a link that makes it, and what that returns
OBJECT_DEGC = pytest.approx(25.648026, abs=1e-6)
Call = Callable[[MecomLink], object]
TEMPERATURE: Call = lambda mecom: mecom.read_float(1000)  # noqa: E731
CAPTURED: list[tuple[bytes, bytes, Call, object]] = [
    (b"#0015AA?IF62AE", b"!0015AA8065-TEC SW G01     7199", lambda it: it.query(b"?IF"), b"8065-TEC SW G01     "),
    (b"#0115AA?IF257D", b"!0115AA8065-TEC SW G01     342D", lambda it: it.query(b"?IF"), b"8065-TEC SW G01     "),
    (b"#0015AB?VR0064018000", b"!0015AB000004411DBD", lambda it: it.read_int(100), 1089),
    (b"#0015AC?VR0066018125", b"!0015AC000000706F2C", lambda it: it.read_int(102), 112),
    (b"#0015AB?VR03E801C21A", b"!0015AB41CD2F28D5C2", TEMPERATURE, OBJECT_DEGC),
    (b"#0015B0VS0BB80141AE0000C482", b"!0015B0C482", lambda it: it.write_float(3000, 21.75), None),
    (b"#0015AEVS07DA01000000028F97", b"!0015AE8F97", lambda it: it.write_int(2010, 2), None),
    (b"#0015AC?VR04D2017BFE", b"!0015AC+0532DA", lambda it: it.read_int(1234), Refused),
    (b"#00BDE2RS9780", b"!00BDE29780", lambda it: it.command(b"RS"), None),
    (b"#000000VS0BB80141A00000551C", b"!000000551C", lambda it: it.write_float(3000, 20.0), None),
]
ASK, RIGHT = CAPTURED[4][0] + b"\r", CAPTURED[4][1] + b"\r"


@pytest.mark.parametrize(("request_", "reply"), [entry[:2] for entry in CAPTURED])
def test_emulator_gives_the_captured_reply(plant: StillPlant, request_: bytes, reply: bytes) -> None:
    plant.temperature_degC = 25.648026
    tec = MeerstetterTec(plant, device_type=1089, serial_number=112)
    tec.receive(request_ + b"\r", 0.0)
    assert tec.transmit(0.05) == reply + b"\r"


def framed(body: bytes) -> bytes:
    return body + b"%04X\r" % crc_hqx(body, 0)


def link(attach: Attach, clock: VirtualClock, instrument: Instrument, request: bytes = ASK) -> MecomLink:
    """A link whose next command has the address and the number of this request."""
    port = open_port(attach(instrument), LineSettings(57600))
    address, number = int(request[1:3], 16), int(request[3:7], 16)
    return MecomLink(Transport(port, clock), address=address, first_token=number - 1)


@pytest.mark.parametrize("value", [1e39, float("inf"), float("nan"), 1 << 31])
def test_a_number_that_does_not_fit_is_one_clear_error_and_nothing_is_sent(
    attach: Attach, clock: VirtualClock, value: float
) -> None:
    """Cut to 32 bits a setting would be another one, and the caller would hear of it from the read-back at best."""
    far_end = Conversation([])
    mecom = link(attach, clock, far_end)
    settings = [mecom.write_int] + [mecom.write_float] * isinstance(value, float)
    for set_to in settings:
        with pytest.raises(ValueError, match=r"parameter 3003: .*expected a number that .* 32 bits"):
            set_to(3003, value)  # type: ignore[arg-type]
    far_end.assert_over()


def conversed(attach: Attach, clock: VirtualClock, request: bytes, replies: list[bytes], call: Call) -> object:
    """What a link makes of some replies to one request; an error's class if it raises one."""
    conversation = Conversation([(request, reply) for reply in replies])
    try:
        found = call(link(attach, clock, conversation, request))
    except (Corrupt, Refused, TimedOut) as error:
        found = type(error)
    conversation.assert_over()
    return found


@pytest.mark.parametrize(("request_", "reply", "call", "result"), CAPTURED)
def test_link_holds_the_captured_conversation(
    attach: Attach, clock: VirtualClock, request_: bytes, reply: bytes, call: Call, result: object
) -> None:
    assert conversed(attach, clock, request_ + b"\r", [reply + b"\r"], call) == result


TARGET, SET_TARGET = CAPTURED[5][0] + b"\r", CAPTURED[5][2]
OTHER = framed(b"!020000" + b"41CD2F28")
NEGATIVE = framed(b"#000000VS07DA01FFFFFFFF")


@pytest.mark.parametrize(
    ("request_", "replies", "call", "result"),
    [
        *[
            (ASK, [noise + RIGHT], TEMPERATURE, OBJECT_DEGC)  # what is not the answer is skipped
            for noise in (
                b"!0015AA8065-TEC SW G01     7199\r",  # an earlier command's reply
                b"!0215AB41CD2F28",  # beginning of a foreign frame, restarted by '!'
                b"!0015AB41CD2F28D5C3\r",  # wrong CRC
                b"!0015AB42CD2F28D5C2\r",  # a flipped digit
                b"!0015AEC21A\r",  # an ACK, of another command
                b"!0015ABC21A\r",  # an ACK of this very command, which is a question
                b"\xff\x00garbage\r\r\r",
                b"\r",
            )
        ],
        (ASK, [b"", b"", RIGHT], TEMPERATURE, OBJECT_DEGC),  # the same number again after silence
        (ASK, [b""] * 3, TEMPERATURE, TimedOut),
        (ASK, [b"!0015AB42CD2F28D5C2\r"] * 3, TEMPERATURE, Corrupt),
        (TARGET, [b"!0015B0C483\r"] * 3, SET_TARGET, TimedOut),  # acknowledgement of another set
        (framed(b"#010000?VR03E801"), [OTHER] * 3, TEMPERATURE, TimedOut),  # another device's
        (framed(b"#020000?VR03E801"), [OTHER], TEMPERATURE, OBJECT_DEGC),
        (ASK, [framed(b"!0015AB41CD2F28")], TEMPERATURE, OBJECT_DEGC),  # a broadcast is answered with 00,
        (ASK, [framed(b"!2A15AB41CD2F28")], TEMPERATURE, OBJECT_DEGC),  # or the device's own address
        (NEGATIVE, [b"!000000" + NEGATIVE[-5:]], lambda it: it.write_int(2010, -1), None),  # two's complement
    ],
)
def test_what_a_link_makes_of_its_replies(
    attach: Attach, clock: VirtualClock, request_: bytes, replies: list[bytes], call: Call, result: object
) -> None:
    assert conversed(attach, clock, request_, replies, call) == result
    assert clock.now_s() < 0.5


def test_link_counts_up_and_wraps(attach: Attach, clock: VirtualClock) -> None:
    seen: list[bytes] = []

    class Listener(MeerstetterTec):
        def receive(self, data: bytes, time_s: float) -> None:
            seen.append(data[3:7])
            super().receive(data, time_s)

    mecom = link(attach, clock, Listener(StillPlant()), b"#00FFFE")
    for _ in range(4):
        mecom.read_int(100)
    assert seen == [b"FFFE", b"FFFF", b"0000", b"0001"]
