"""The TE Technology driver: EEPROM, readings that have to agree, units, alarms, off; the manuals' worked bytes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import pytest

from rig.core.clock import VirtualClock
from rig.core.errors import Corrupt, OutOfStep, Refused, TimedOut
from rig.drivers.registry import open_controller
from rig.drivers.te_technology import MODELS as TABLES
from rig.drivers.te_technology import TeLink, TeTechnologyController
from rig.ports.open import LineSettings, open_port
from rig.ports.transport import Transport
from sim.instruments.instrument import Instrument
from sim.instruments.te_technology import TeTechnology
from tests.rig.drivers.conversation import Conversation
from tests.rig.drivers.still_plant import StillPlant
from tests.rig.drivers.transcripts import TE_36_25, TE_48_20, TE_BAD_SUM

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


def say(tec: TeTechnology, code: bytes, value: int = 0, time_s: float = 0.0) -> int:
    body = b"00%b%08x" % (code, value & 0xFFFFFFFF)
    tec.receive(b"*%b%02x\r" % (body, sum(body) & 0xFF), time_s)
    reply = int(tec.transmit(time_s + 0.09)[1:9], 16)
    return reply - (reply >> 31 << 32)


def test_eeprom_is_written_while_it_may_be(plant: StillPlant) -> None:
    tec = TeTechnology(plant)
    say(tec, b"1c", 3000, 0.0)
    assert tec.eeprom_writes == 1
    say(tec, b"34", 0, 1.0)
    written = tec.eeprom_writes
    for index in range(5):
        say(tec, b"1c", 3000 + index, 2.0 + index)
    assert tec.eeprom_writes == written


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


# ---- frames ------------------------------------------------------------------------------------------


def summed(body: bytes, end: bytes) -> bytes:
    """A frame with its sum, for what no manual prints."""
    return b"*%b%02x%b" % (body, sum(body) & 0xFF, end)


TEMPERATURES_DEGC = {"read input 1, 2.50": 2.5, "read input 1, 10.00": 10.0}


def answer(tec: TeTechnology, request: bytes, time_s: float = 0.0) -> bytes:
    """What comes back within a second."""
    tec.receive(request, time_s)
    return tec.transmit(time_s + 0.09)


@pytest.mark.parametrize(("name", "request_", "reply"), TE_36_25, ids=[entry[0] for entry in TE_36_25])
def test_emulator_gives_the_printed_reply(plant: StillPlant, name: str, request_: bytes, reply: bytes) -> None:
    plant.temperature_degC = TEMPERATURES_DEGC.get(name, 25.0)
    tec = TeTechnology(plant)
    tec.alarms = 0b1001
    assert answer(tec, request_) == reply


def test_emulator_gives_the_printed_reply_of_the_other_model(plant: StillPlant) -> None:
    tec = TeTechnology(plant, model="tc-48-20")
    _, request, reply = TE_48_20[0]
    assert answer(tec, request) == reply
    assert tec.values["setpoint"] == 100


@pytest.mark.parametrize(
    ("request_", "reply"),
    [
        (b"*0001c1\r", b"*000000fae7^"),  # the short form
        (b"*00010000000041^", b"*000000fae7^"),  # ends like a reply, as in the manual's alarm examples
        (b"*000100000000\x0041\r", b"*XXXXXXXXc0^"),
        (b"*00010000000042\r", b"*XXXXXXXXc0^"),
        (b"*0001000000041\r", b"*XXXXXXXXc0^"),
        (b"*001CFFFFFF6A4F\r", b"*XXXXXXXXc0^"),  # capitals
        (b"*00430000000047\r", b"*0000000181^"),  # the probe of an independent client
        (b"noise*00*00010000000041\r", b"*000000fae7^"),
        (b"*01010000000042\r", b""),  # another address
        (b"00010000000041\r", b""),
        (b"\r\r", b""),
    ],
)
def test_emulator_on_other_requests(plant: StillPlant, request_: bytes, reply: bytes) -> None:
    plant.temperature_degC = 2.5
    assert answer(TeTechnology(plant), request_) == reply


@pytest.mark.parametrize(
    ("request_", "reply"),
    [
        (b"*0161\r", summed(b"0019", b"^")),
        (b"*0060\r", summed(b"258d", b"^")),
        (b"*5065\r", summed(b"00fa", b"^")),
        (b"*0162\r", b"*XXXX60^"),
    ],
)
def test_emulator_of_the_other_model_on_other_requests(plant: StillPlant, request_: bytes, reply: bytes) -> None:
    plant.temperature_degC = 2.5
    assert answer(TeTechnology(plant, model="tc-48-20"), request_) == reply


def test_addresses(plant: StillPlant) -> None:
    plant.temperature_degC = 2.5
    tec = TeTechnology(plant, address=1)
    assert answer(tec, b"*01010000000042\r") == b"*000000fae7^"
    assert answer(tec, b"*0101c2\r", 1.0) == b"*000000fae7^"
    assert answer(tec, b"*011c000003e8b5\r", 2.0) == b"*000003e8c0^"
    assert answer(tec, b"*00010000000041\r", 3.0) == b"*000000fae7^"


@pytest.mark.parametrize("gap_s", [-0.01, 0.01])
def test_a_command_before_the_reply_is_lost(plant: StillPlant, gap_s: float) -> None:
    tec = TeTechnology(plant, deaf_s=0.02)
    tec.receive(b"*00010000000041\r", 0.0)
    sent_s = tec.next_transmit_s()
    assert sent_s == pytest.approx(16 / 960 + 0.005 + 12 / 960)
    tec.receive(b"*00010000000041\r", sent_s + 0.02 + gap_s)
    assert tec.transmit(1.0).count(b"^") == (1 if gap_s < 0.0 else 2)
    assert tec.lost_commands == (1 if gap_s < 0.0 else 0)


def test_two_commands_in_one_go_are_one(plant: StillPlant) -> None:
    tec = TeTechnology(plant)
    tec.receive(b"*00010000000041\r*00060000000046\r", 0.0)
    assert tec.transmit(1.0).count(b"^") == 1


# ---- the driver's link ----------------------------------------------------------------------------

DIALECT = replace(TABLES["tc-36-25"], quiet=None)
FENCE = [(b"*0025000000084f\r", b"*0000000888^"), (b"*00250000000950\r", b"*0000000989^")]


def link(attach: Attach, clock: VirtualClock, transcript: list[tuple[bytes, bytes]]) -> tuple[TeLink, Conversation]:
    """A link whose next fence has the number 8, and what it is to hear."""
    conversation = Conversation(transcript)
    port = open_port(attach(conversation), LineSettings(9600))
    return TeLink(Transport(port, clock), DIALECT, byte_s=10 / 9600, first_token=7), conversation


@pytest.mark.parametrize(("name", "request_", "reply"), TE_36_25, ids=[entry[0] for entry in TE_36_25])
def test_link_holds_the_printed_conversation(
    attach: Attach, clock: VirtualClock, name: str, request_: bytes, reply: bytes
) -> None:
    te, conversation = link(attach, clock, [FENCE[0], (request_, reply), FENCE[1]])
    data = int(request_[5:13], 16)
    value = None if name.startswith(("read", "alarm")) else data - (data >> 31 << 32)
    expected = int(reply[1:9], 16)
    assert te.sequence((request_[3:5], value)) == [expected - (expected >> 31 << 32)]
    conversation.assert_over()


def test_link_of_the_other_model(attach: Attach, clock: VirtualClock) -> None:
    fence = (b"*0060\r", summed(b"258d", b"^"))
    conversation = Conversation([fence, TE_48_20[0][1:], (b"*0161\r", summed(b"ffe7", b"^")), fence])
    port = open_port(attach(conversation), LineSettings(115200))
    te = TeLink(Transport(port, clock), TABLES["tc-48-20"], byte_s=1e-4)
    assert te.sequence((b"1c", 100), (b"01", None)) == [100, -25]
    conversation.assert_over()


READ = b"*00010000000041\r"
RIGHT = b"*000000fae7^"


@pytest.mark.parametrize(
    ("reply", "error"),
    [
        (b"*000000fbe7^", Corrupt),  # a flipped digit
        (b"*00000fae7^", Corrupt),  # a lost one
        (b"*000000FAA7^", Corrupt),  # capitals
        (b"x" + RIGHT, Corrupt),
        (b"*0000000888^" + RIGHT, OutOfStep),  # the fence's reply once more: one too many
        (RIGHT + RIGHT, OutOfStep),
        (RIGHT[:-1], TimedOut),
        (b"", TimedOut),
        (TE_BAD_SUM["tc-48-20"], Corrupt),
    ],
)
def test_what_is_no_reply(attach: Attach, clock: VirtualClock, reply: bytes, error: type[Exception]) -> None:
    transcript = [FENCE[0], (READ, reply)] + ([FENCE[1]] if error is OutOfStep else [])
    te, conversation = link(attach, clock, transcript)
    with pytest.raises(error):
        te.sequence((b"01", None))
    assert te.in_doubt
    conversation.assert_over()


def test_a_late_reply_is_found_out_by_the_fence(attach: Attach, clock: VirtualClock) -> None:
    te, conversation = link(attach, clock, [FENCE[0], (READ, summed(b"000000c8", b"^")), (FENCE[1][0], RIGHT)])
    with pytest.raises(OutOfStep, match="out of step"):
        te.sequence((b"01", None))
    conversation.assert_over()


def test_a_request_that_could_not_be_read_is_sent_again(attach: Attach, clock: VirtualClock) -> None:
    refused = (READ, TE_BAD_SUM["tc-36-25"])
    te, conversation = link(attach, clock, [FENCE[0], refused, refused, (READ, RIGHT), FENCE[1]])
    assert te.sequence((b"01", None)) == [250]
    conversation.assert_over()
    te, conversation = link(attach, clock, [FENCE[0], refused, refused, refused])
    with pytest.raises(Corrupt, match="could not read"):
        te.sequence((b"01", None))
    conversation.assert_over()


def test_a_wrong_acknowledgement_is_out_of_step(attach: Attach, clock: VirtualClock) -> None:
    te, conversation = link(attach, clock, [FENCE[0], (summed(b"001c000000fa", b"\r"), summed(b"000000c8", b"^"))])
    with pytest.raises(OutOfStep, match="set to 250, and 200"):
        te.sequence((b"1c", 250))
    conversation.assert_over()


def test_after_doubt_the_line_has_to_be_silent(attach: Attach, clock: VirtualClock) -> None:
    late = (FENCE[1][0], RIGHT + FENCE[1][1])  # what was asked before, then what is asked now
    te, _ = link(attach, clock, [(FENCE[0][0], b""), late, (READ, RIGHT)])
    te.resynchronise()
    assert not te.in_doubt
    assert clock.now_s() > 2 * 0.3
    with pytest.raises(TimedOut):
        te.sequence((b"01", None))
    assert te.in_doubt


def test_requests_keep_their_distance(attach: Attach, clock: VirtualClock) -> None:
    seen: list[float] = []

    class Listener(TeTechnology):
        def receive(self, data: bytes, time_s: float) -> None:
            seen.append(time_s)
            super().receive(data, time_s)

    tec = Listener(StillPlant())
    port = open_port(attach(tec), LineSettings(9600))
    te = TeLink(Transport(port, clock), DIALECT, byte_s=10 / 9600, gap_s=0.03)
    te.sequence((b"01", None), (b"06", None))
    exchange_s = 28 / 960 + 0.005
    assert [later - earlier for earlier, later in pairwise(seen)] == pytest.approx([exchange_s + 0.03] * 3)


def test_babble_is_not_waited_for_for_ever(attach: Attach, clock: VirtualClock) -> None:
    class Babble(Conversation):
        def transmit(self, time_s: float) -> bytes:
            return b"x"

        def next_transmit_s(self) -> float | None:
            return None

    port = open_port(attach(Babble([])), LineSettings(9600))
    te = TeLink(Transport(port, clock), DIALECT, byte_s=10 / 9600)
    with pytest.raises(OutOfStep, match="silent"):
        te.resynchronise()
    assert clock.now_s() < 15.0
