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
from tests.rig.drivers.conversation import Conversation
from tests.rig.drivers.still_plant import StillPlant
from tests.rig.drivers.transcripts import MECOM, OBJECT_TEMPERATURE_DEGC

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


def test_configure_sets_limits_and_spares_the_flash(
    controller: MeerstetterController, tec: MeerstetterTec, clock: VirtualClock
) -> None:
    controller.configure(2.5, (10.0, 95.0), 3.0)
    values = tec._values
    assert (values[2030], values[4010], values[4011], values[2060], values[108]) == (2.5, 10.0, 95.0, 3.0, 1)
    controller.arm_current()
    for step in range(50):
        controller.set_current_A(0.01 * step)
        clock.sleep_until_s(clock.now_s() + 0.1)
    assert tec.flash_writes == 0


def test_limit_beyond_the_device_is_refused(controller: MeerstetterController) -> None:
    with pytest.raises(ValueError, match=r"current limit 5 A: this device takes at most 4 A"):
        controller.configure(5.0, (10.0, 95.0), 0.0)


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


def test_positive_heats_however_it_is_wired(attach: Attach, clock: VirtualClock, plant: StillPlant) -> None:
    tec = MeerstetterTec(plant, heating_sign=-1)
    tec._values[3034] = 0  # as the firmware knows
    controller = open_controller("meerstetter", attach(tec), clock)
    controller.configure(2.0, (10.0, 95.0), 0.0)
    controller.arm_current()
    controller.set_current_A(1.5)
    assert plant.current_A == 1.5
    assert controller.read_current().value == 1.5


def test_dead_man(armed: MeerstetterController, plant: StillPlant, clock: VirtualClock) -> None:
    armed.set_current_A(1.0)
    clock.sleep_until_s(clock.now_s() + 10.0)
    assert not armed.status().output_is_on
    assert plant.current_A == 0.0


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


def answer(tec: MeerstetterTec, request: bytes, time_s: float = 0.0) -> bytes:
    """What comes back within a second, without its CR."""
    tec.receive(request + b"\r", time_s)
    return tec.transmit(time_s + 0.05).removesuffix(b"\r")


@pytest.mark.parametrize(("request_", "reply"), [entry[1:] for entry in MECOM], ids=[entry[0] for entry in MECOM])
def test_emulator_gives_the_captured_reply(plant: StillPlant, request_: bytes, reply: bytes) -> None:
    plant.temperature_degC = OBJECT_TEMPERATURE_DEGC
    assert answer(MeerstetterTec(plant, device_type=1089, serial_number=112), request_) == reply


@pytest.mark.parametrize(
    ("frame", "crc"),
    [
        (b"!0115AC+05", b"7509"),
        (b"!000000+05", b"A7C4"),
        (b"#000000?VR006401", b"A912"),
        (b"#020003?VR03E801", b"AC05"),
    ],
)
def test_published_crc_vectors(frame: bytes, crc: bytes) -> None:
    assert b"%04X" % crc_hqx(frame, 0) == crc


def link(attach: Attach, clock: VirtualClock, instrument: Instrument, address: int, sequence: int) -> MecomLink:
    """A link whose next command has the number `sequence`."""
    port = open_port(attach(instrument), LineSettings(57600))
    return MecomLink(Transport(port, clock), address=address, first_token=sequence - 1)


ACTIONS: dict[str, Callable[[MecomLink], object]] = {
    "firmware": lambda mecom: mecom.query(b"?IF"),
    "firmware, address 1": lambda mecom: mecom.query(b"?IF"),
    "device type": lambda mecom: mecom.read_int(100),
    "serial number": lambda mecom: mecom.read_int(102),
    "object temperature": lambda mecom: mecom.read_float(1000),
    "target 21.75": lambda mecom: mecom.write_float(3000, 21.75),
    "output live": lambda mecom: mecom.write_int(2010, 2),
    "reset": lambda mecom: mecom.command(b"RS"),
    "target 20.0": lambda mecom: mecom.write_float(3000, 20.0),
}
RESULTS = {
    "firmware": b"8065-TEC SW G01     ",
    "firmware, address 1": b"8065-TEC SW G01     ",
    "device type": 1089,
    "serial number": 112,
    "object temperature": pytest.approx(OBJECT_TEMPERATURE_DEGC, abs=1e-6),
}


@pytest.mark.parametrize("name", ACTIONS)
def test_link_holds_the_captured_conversation(attach: Attach, clock: VirtualClock, name: str) -> None:
    request, reply = next(entry[1:] for entry in MECOM if entry[0] == name)
    conversation = Conversation([(request + b"\r", reply + b"\r")])
    mecom = link(attach, clock, conversation, int(request[1:3], 16), int(request[3:7], 16))
    assert ACTIONS[name](mecom) == RESULTS.get(name)
    conversation.assert_over()


def test_link_reports_the_captured_refusal(attach: Attach, clock: VirtualClock) -> None:
    conversation = Conversation([(b"#0015AC?VR04D2017BFE\r", b"!0015AC+0532DA\r")])
    with pytest.raises(Refused, match="parameter unknown") as refused:
        link(attach, clock, conversation, 0, 0x15AC).read_int(1234)
    assert refused.value.code == 5
    conversation.assert_over()


def test_link_sends_the_same_number_again_after_silence(attach: Attach, clock: VirtualClock) -> None:
    request = b"#0015AB?VR03E801C21A\r"
    conversation = Conversation([(request, b""), (request, b""), (request, b"!0015AB41CD2F28D5C2\r")])
    mecom = link(attach, clock, conversation, 0, 0x15AB)
    assert mecom.read_float(1000) == pytest.approx(25.648026, abs=1e-6)
    conversation.assert_over()


def test_link_gives_up_after_three_trials(attach: Attach, clock: VirtualClock) -> None:
    request = b"#0015AB?VR03E801C21A\r"
    conversation = Conversation([(request, b"")] * 3)
    with pytest.raises(TimedOut):
        link(attach, clock, conversation, 0, 0x15AB).read_float(1000)
    conversation.assert_over()
    assert clock.now_s() < 0.5


def test_link_counts_up_and_wraps(attach: Attach, clock: VirtualClock) -> None:
    seen: list[bytes] = []

    class Listener(MeerstetterTec):
        def receive(self, data: bytes, time_s: float) -> None:
            seen.append(data[3:7])
            super().receive(data, time_s)

    mecom = link(attach, clock, Listener(StillPlant()), 0, 0xFFFE)
    for _ in range(4):
        mecom.read_int(100)
    assert seen == [b"FFFE", b"FFFF", b"0000", b"0001"]


RIGHT = b"!0015AB41CD2F28D5C2\r"


@pytest.mark.parametrize(
    "noise",
    [
        b"!0015AA8065-TEC SW G01     7199\r",  # an earlier command's reply
        b"!0215AB41CD2F28",  # beginning of a foreign frame, restarted by '!'
        b"!0015AB41CD2F28D5C3\r",  # wrong CRC
        b"!0015AB42CD2F28D5C2\r",  # a flipped digit
        b"!0015AEC21A\r",  # an ACK, of another command
        b"!0015ABC21A\r",  # an ACK of this very command, which is a question
        b"\xff\x00garbage\r\r\r",
        b"\r",
    ],
)
def test_link_skips_what_is_not_the_answer(attach: Attach, clock: VirtualClock, noise: bytes) -> None:
    conversation = Conversation([(b"#0015AB?VR03E801C21A\r", noise + RIGHT)])
    value = link(attach, clock, conversation, 0, 0x15AB).read_float(1000)
    assert value == pytest.approx(25.648026, abs=1e-6)
    conversation.assert_over()


@pytest.mark.parametrize("address", [1, 2])
def test_link_takes_no_other_device_for_its_own(attach: Attach, clock: VirtualClock, address: int) -> None:
    body = b"#%02X0000?VR03E801" % address
    request = body + b"%04X\r" % crc_hqx(body, 0)
    other = b"!%02X000041CD2F28" % (3 - address)
    conversation = Conversation([(request, other + b"%04X\r" % crc_hqx(other, 0))] * 3)
    with pytest.raises(TimedOut):
        link(attach, clock, conversation, address, 0).read_float(1000)


@pytest.mark.parametrize("reply_address", [b"00", b"2A"])
def test_broadcast_accepts_echo_and_own_address(attach: Attach, clock: VirtualClock, reply_address: bytes) -> None:
    reply = b"!" + reply_address + b"15AB41CD2F28"
    conversation = Conversation([(b"#0015AB?VR03E801C21A\r", reply + b"%04X\r" % crc_hqx(reply, 0))])
    assert link(attach, clock, conversation, 0, 0x15AB).read_float(1000) == pytest.approx(25.648026, abs=1e-6)


def test_acknowledgement_of_another_set_does_not_count(attach: Attach, clock: VirtualClock) -> None:
    request = b"#0015B0VS0BB80141AE0000C482\r"
    conversation = Conversation([(request, b"!0015B0C483\r")] * 3)
    with pytest.raises(TimedOut):
        link(attach, clock, conversation, 0, 0x15B0).write_float(3000, 21.75)


def test_garbled_three_times_is_corrupt(attach: Attach, clock: VirtualClock) -> None:
    conversation = Conversation([(b"#0015AB?VR03E801C21A\r", b"!0015AB42CD2F28D5C2\r")] * 3)
    with pytest.raises(Corrupt):
        link(attach, clock, conversation, 0, 0x15AB).read_float(1000)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 1e39])
def test_link_refuses_what_is_no_float32(attach: Attach, clock: VirtualClock, value: float) -> None:
    conversation = Conversation([])
    with pytest.raises(ValueError, match="parameter 3000"):
        link(attach, clock, conversation, 0, 0).write_float(3000, value)
    conversation.assert_over()


def test_negative_integers_are_twos_complement(attach: Attach, clock: VirtualClock) -> None:
    body = b"#000000VS07DA01FFFFFFFF"
    crc = b"%04X\r" % crc_hqx(body, 0)
    conversation = Conversation([(body + crc, b"!000000" + crc)])
    link(attach, clock, conversation, 0, 0).write_int(2010, -1)
    conversation.assert_over()
