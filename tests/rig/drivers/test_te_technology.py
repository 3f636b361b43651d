"""The TE Technology driver: EEPROM, readings that have to agree, units, alarms, off; the manuals' worked bytes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

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
from tests.rig.drivers.far_ends import Conversation
from tests.rig.drivers.still_plant import StillPlant

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


def test_the_eeprom_is_spared(plant: StillPlant, attach: Attach, clock: VirtualClock) -> None:
    tec = TeTechnology(plant)
    controller = open_controller("te_technology", attach(tec), clock)
    controller.off()
    controller.configure(4.0, (10.0, 95.0), 0.0)
    controller.arm_setpoint()
    for step in range(50):
        controller.set_setpoint_degC(30.0 + 0.1 * step)
        controller.read_temperature()
    assert 0 < tec.eeprom_writes <= 3  # power off at first, said more than once, and what ends the writing


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
def test_a_wrong_one_is_outvoted(controller: TeTechnologyController, tec: TeTechnology, bad: int, place: int) -> None:
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


def test_a_device_that_needs_a_pause(plant: StillPlant, attach: Attach, clock: VirtualClock) -> None:
    controller = open_controller("te_technology", attach(TeTechnology(plant, deaf_s=0.05)), clock, gap_s=0.06)
    assert controller.read_temperature().value == 25.0
    assert controller.off()


# ---- frames ------------------------------------------------------------------------------------------


def summed(body: bytes, end: bytes = b"^") -> bytes:
    """A frame with its sum, for what no manual prints."""
    return b"*%b%02x%b" % (body, sum(body) & 0xFF, end)


READ, RIGHT, COULD_NOT_READ = b"*00010000000041\r", b"*000000fae7^", b"*XXXXXXXXc0^"
# TC-36-25 RS232 manual, Appendix C p. 42 to 50; the last as an independent client sends it. With the code and the value
# (None reads) by which a link asks.
PRINTED: list[tuple[bytes, bytes, tuple[bytes, int | None]]] = [
    (b"*0029000000004b\r", b"*0000000080^", (b"29", 0)),  # setpoint source is the computer
    (b"*001cffffff6aef\r", b"*ffffff6afb^", (b"1c", -150)),  # set -1.50
    (READ, RIGHT, (b"01", None)),  # input 1, 2.50
    (b"*00050000000045\r", b"*0000000989^", (b"05", None)),  # alarms: high and over-current
    (b"*002d0000000177\r", b"*0000000181^", (b"2d", 1)),  # power on
]
SET_48_20 = (b"*1c00645e\r", b"*0064ca^")  # TC-48-20 manual, Appendix B p. 48 to 54: set 10.0
OTHERS = [  # model, request, reply
    *[
        ("tc-36-25", request, reply)
        for request, reply in (
            (b"*0001c1\r", RIGHT),  # the short form
            (b"*00010000000041^", RIGHT),  # ends like a reply, as in the manual's alarm examples
            (b"*000100000000\x0041\r", COULD_NOT_READ),
            (b"*00010000000042\r", COULD_NOT_READ),
            (b"*0001000000041\r", COULD_NOT_READ),
            (b"*001CFFFFFF6A4F\r", COULD_NOT_READ),  # capitals
            (b"*00430000000047\r", b"*0000000181^"),  # the probe of an independent client
            (b"noise*00*00010000000041\r", RIGHT),
            (b"*01010000000042\r", b""),  # another address
            (b"00010000000041\r", b""),
            (b"\r\r", b""),
            (READ + b"*00060000000046\r", RIGHT),  # the second, before the reply to the first, is lost
        )
    ],
    *[
        ("tc-48-20", request, reply)
        for request, reply in (
            SET_48_20,
            (b"*0161\r", summed(b"0019")),
            (b"*0060\r", summed(b"258d")),
            (b"*5065\r", summed(b"00fa")),
            (b"*0162\r", b"*XXXX60^"),
        )
    ],
]


@pytest.mark.parametrize(("model", "request_", "reply"), [*[("tc-36-25", *one[:2]) for one in PRINTED], *OTHERS])
def test_emulator_gives_the_printed_reply(plant: StillPlant, model: str, request_: bytes, reply: bytes) -> None:
    plant.temperature_degC = 2.5
    tec = TeTechnology(plant, model=model)
    tec.alarms = 0b1001
    tec.receive(request_, 0.0)
    assert tec.transmit(0.09) == reply


def test_addresses(plant: StillPlant) -> None:
    plant.temperature_degC = 2.5
    tec = TeTechnology(plant, address=1)
    set_100 = (b"*011c000003e8b5\r", b"*000003e8c0^")
    for k, (request, reply) in enumerate(
        [(b"*01010000000042\r", RIGHT), (b"*0101c2\r", RIGHT), set_100, (READ, RIGHT)]
    ):
        tec.receive(request, float(k))
        assert tec.transmit(k + 0.09) == reply


@pytest.mark.parametrize("gap_s", [-0.01, 0.01])
def test_a_command_before_the_reply_is_lost(plant: StillPlant, gap_s: float) -> None:
    tec = TeTechnology(plant, deaf_s=0.02)
    tec.receive(READ, 0.0)
    sent_s = tec.next_transmit_s()
    assert sent_s == pytest.approx(16 / 960 + 0.005 + 12 / 960)
    tec.receive(READ, sent_s + 0.02 + gap_s)
    assert tec.transmit(1.0).count(b"^") == (1 if gap_s < 0.0 else 2)
    assert tec.lost_commands == (1 if gap_s < 0.0 else 0)


# ---- the driver's link ----------------------------------------------------------------------------

DIALECT = replace(TABLES["tc-36-25"], quiet=None)
FENCE = [(b"*0025000000084f\r", b"*0000000888^"), (b"*00250000000950\r", b"*0000000989^")]
ASK = (b"01", None)


def link(
    attach: Attach, clock: VirtualClock, transcript: list[tuple[bytes, bytes]] | Instrument, **options: Any
) -> tuple[TeLink, Any]:
    """A link whose next fence has the number 8, and what it is to hear."""
    far_end = Conversation(transcript) if isinstance(transcript, list) else transcript
    port = open_port(attach(far_end), LineSettings(9600))
    options = {"byte_s": 10 / 9600, "first_token": 7, **options}
    return TeLink(Transport(port, clock), options.pop("model", DIALECT), **options), far_end


@pytest.mark.parametrize(("request_", "reply", "asked"), PRINTED)
def test_link_holds_the_printed_conversation(
    attach: Attach, clock: VirtualClock, request_: bytes, reply: bytes, asked: tuple[bytes, int | None]
) -> None:
    te, conversation = link(attach, clock, [FENCE[0], (request_, reply), FENCE[1]])
    expected = int(reply[1:9], 16)
    assert te.sequence(asked) == [expected - (expected >> 31 << 32)]
    conversation.assert_over()


def test_link_of_the_other_model(attach: Attach, clock: VirtualClock) -> None:
    fence = (b"*0060\r", summed(b"258d"))
    te, conversation = link(
        attach, clock, [fence, SET_48_20, (b"*0161\r", summed(b"ffe7")), fence], model=TABLES["tc-48-20"]
    )
    assert te.sequence((b"1c", 100), ASK) == [100, -25]
    conversation.assert_over()


def test_a_number_that_does_not_fit_is_one_clear_error(attach: Attach, clock: VirtualClock) -> None:
    """Cut to 16 bits, a setpoint of 6553.6 degC is one of 0 degC."""
    te, conversation = link(attach, clock, [(b"*0060\r", summed(b"258d"))], model=TABLES["tc-48-20"])
    with pytest.raises(ValueError, match=r"code 1c: 65536: expected a number that .* 16 bits"):
        te.sequence((b"1c", 65536))
    conversation.assert_over()


REFUSED = (READ, COULD_NOT_READ)


@pytest.mark.parametrize(
    ("said", "expected"),
    [
        ([(READ, b"*000000fbe7^")], Corrupt),  # a flipped digit
        ([(READ, b"*00000fae7^")], Corrupt),  # a lost one
        ([(READ, b"*000000FAA7^")], Corrupt),  # capitals
        ([(READ, b"x" + RIGHT)], Corrupt),
        ([(READ, b"*0000000888^" + RIGHT), FENCE[1]], OutOfStep),  # the fence's reply once more: one too many
        ([(READ, RIGHT + RIGHT), FENCE[1]], OutOfStep),
        ([(READ, summed(b"000000c8")), (FENCE[1][0], RIGHT)], OutOfStep),  # a late reply
        ([(READ, RIGHT[:-1])], TimedOut),
        ([(READ, b"")], TimedOut),
        ([(READ, b"*XXXX60^")], Corrupt),
        ([REFUSED, REFUSED, (READ, RIGHT), FENCE[1]], None),  # what could not be read is sent again
        ([REFUSED, REFUSED, REFUSED], Corrupt),
    ],
)
def test_what_a_link_makes_of_its_replies(
    attach: Attach, clock: VirtualClock, said: list[tuple[bytes, bytes]], expected: type[Exception] | None
) -> None:
    te, conversation = link(attach, clock, [FENCE[0], *said])
    if expected is None:
        assert te.sequence(ASK) == [250]
    else:
        with pytest.raises(expected):
            te.sequence(ASK)
        assert te.in_doubt
    conversation.assert_over()


def test_a_wrong_acknowledgement_is_out_of_step(attach: Attach, clock: VirtualClock) -> None:
    te, conversation = link(attach, clock, [FENCE[0], (summed(b"001c000000fa", b"\r"), summed(b"000000c8"))])
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
        te.sequence(ASK)
    assert te.in_doubt
