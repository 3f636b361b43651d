"""The LDC501's emulator and driver: lines of 64 bytes, words and numbers, errors, limits, an output known to be off."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

from rig.core.clock import VirtualClock
from rig.core.errors import Corrupt, InstrumentError, OutOfStep, Refused, TimedOut
from rig.core.reading import Quality
from rig.drivers.registry import open_controller
from rig.drivers.srs_ldc500 import SrsLdc500Controller
from rig.ports import protocol_sim
from sim.instruments.instrument import Instrument
from sim.instruments.srs_ldc500 import SrsLdc500
from tests.rig.drivers.conversation import Conversation, scripted
from tests.rig.drivers.still_plant import StillPlant

Attach = Callable[[Instrument], str]


class Host:
    """Speaks to one emulator and keeps the time."""

    def __init__(self, tec: SrsLdc500) -> None:
        self.tec = tec
        self.time_s = 0.0

    def say(self, message: str, end: bytes = b"\n") -> str:
        self.tec.receive(message.encode() + end, self.time_s)
        self.time_s += 0.3
        return self.tec.transmit(self.time_s).decode()


@pytest.fixture
def tec(plant: StillPlant) -> SrsLdc500:
    return SrsLdc500(plant)


@pytest.fixture
def host(tec: SrsLdc500) -> Host:
    return Host(tec)


# ---- emulator -------------------------------------------------------------------------------------


def test_observed_exchange(host: Host) -> None:
    """Observed between an independent client and a stand-in for the controller."""
    assert host.say("TEMP 22.5") == ""
    assert host.say("LEXE?") == "0\r\n"
    assert host.say("LCME?") == "0\r\n"
    assert host.say("TEMP?") == "22.5\r\n"
    assert host.say("*IDN?") == "Stanford Research Systems,LDC501,s/n098023,ver2.00\r\n"


@pytest.mark.parametrize(
    ("number", "end"), [(0, ""), (1, "\r"), (2, "\n"), (3, "\r\n"), (4, "\n\r"), ("lf", "\n"), ("NONE", "")]
)
def test_terminators(host: Host, number: object, end: str) -> None:
    host.say(f"TERM {number}")
    assert host.say("TMOD?;TEON?") == f"0{end}0{end}"


@pytest.mark.parametrize("end", [b"\r", b"\n", b"\r\n"])
def test_lines(host: Host, end: bytes) -> None:
    assert host.say(" temp 31.5 ;; ; TEMP? ;TMOD?", end=end) == "31.5\r\n0\r\n"


def test_nothing_runs_before_the_end_of_the_line(host: Host) -> None:
    assert host.say("TEMP 31.5;TEMP?", end=b"") == ""
    assert host.tec.values["TEMP"] == 25.0
    assert host.say("") == "31.5\r\n"


def test_words_and_numbers(host: Host) -> None:
    host.say("TOKN ON;TMOD CT;TEON 1")
    assert host.say("TOKN?;TMOD?;TEON?;TSNR?") == "ON\r\nCT\r\nON\r\nNTCAUTO\r\n"
    host.say("TOKN 0")
    assert host.say("TMOD?;TEON?") == "1\r\n1\r\n"


@pytest.mark.parametrize(
    ("line", "code"),
    [
        ("12345", 1),
        ("XYZW 1", 2),
        ("XYZW?", 2),
        ("*CLS?", 3),
        ("TTRD 5", 4),
        ("TEMP", 5),
        ("TEMP 1,2", 6),
        ("TEMP? 1", 6),
        ("TEMP 1.2.3", 9),
        ("TEMP nan", 9),
        ("*ESE x", 10),
        ("TMOD 7", 12),
        ("TMOD CQ", 14),
    ],
)
def test_command_errors(host: Host, line: str, code: int) -> None:
    assert host.say(line) == ""
    assert host.say("LCME?;LCME?;LEXE?") == f"{code}\r\n0\r\n0\r\n"


@pytest.mark.parametrize("line", ["TEMP 200", "TEMP -60", "TCUR 3.1", "TILM 4.6", "TVLM -9", "*ESE 256"])
def test_execution_errors(host: Host, line: str) -> None:
    host.say("TILM 3")
    assert host.say(line) == ""
    assert host.say("LEXE?;LEXE?;LCME?") == "1\r\n0\r\n0\r\n"


def test_errors_take_a_moment_to_be_logged(plant: StillPlant) -> None:
    tec = SrsLdc500(plant, error_s=0.2)
    tec.receive(b"XYZW;LCME?\n", 0.0)
    assert tec.transmit(0.1) == b"0\r\n"
    tec.receive(b"LCME?\n", 0.3)
    assert tec.transmit(0.5) == b"2\r\n"


def test_input_buffer_has_64_bytes(host: Host) -> None:
    line = "TEMP 31;" * 7
    assert host.say(line + "TEMP?" + " " * 2) == "31\r\n"
    assert host.say(line + "TEMP?" + " " * 3) == ""
    assert host.say("*ESR?;LCME?") == "2\r\n8\r\n"
    assert host.say("TMOD?;" * 11, end=b"") == ""
    assert host.say("TMOD?") == "0\r\n"


def test_lowering_the_limit_drags_the_current_along(host: Host, plant: StillPlant) -> None:
    host.say("TCUR -2;TEON 1")
    assert plant.current_A == -2.0
    host.say("TILM 1.5")
    assert (host.say("TCUR?"), plant.current_A) == ("-1.5\r\n", -1.5)
    host.say("TVLM 2")
    assert (host.say("TIRD?;TVRD?"), plant.current_A) == ("-1\r\n-2\r\n", -1.0)


def test_regulation_needs_a_negative_gain(plant: StillPlant) -> None:
    for gain, sign in ((-1.0, 1), (-1.0, -1), (1.0, 1)):
        tec = SrsLdc500(plant, heating_sign=sign, start_s=plant.time_s)
        host = Host(tec)
        host.time_s = plant.time_s
        host.say(f"TMOD CT;TEMP 30;TPGN {gain};TEON 1")
        assert (plant.current_A > 0.0) is (gain < 0.0)


def test_an_open_sensor_turns_off(host: Host, plant: StillPlant) -> None:
    host.say("TMOD CT;TEMP 30;TEON 1")
    plant.temperature_degC = math.nan
    assert host.say("TTRD?") == "nan\r\n"
    assert host.say("TEON?") == "0\r\n"
    assert plant.current_A == 0.0


# ---- conversations --------------------------------------------------------------------------------

IN_STEP = [
    (b"\n*ESE 8;*ESE?\n", b"8\r\n"),
    (b"LEXE?;LCME?;*ESE?;*ESE 9\n", b"0\r\n0\r\n8\r\n"),
]
READING = (b"TTRD?;*ESE?;TTRD?;*ESE?;*ESE 10\n", b"25.648\r\n9\r\n25.648\r\n9\r\n")
Scripted = tuple[SrsLdc500Controller, Conversation]


@pytest.mark.parametrize(
    "reply",
    [
        b"25.648\r\n9\r\n25.648\r\n9\r\n",
        b"25.648\n9\n25.648\n9\n",
        b"25.648\n\r9\n\r25.648\n\r9\n\r",
        b"25.648;9;25.648;9\r\n",
        b"\r\n25.648\r\n9\r\n25.648\r\n9\r\n",
    ],
)
def test_conversation_of_a_reading(attach: Attach, clock: VirtualClock, reply: bytes) -> None:
    again = (READING[0].replace(b"10", b"11"), reply.replace(b"9", b"10"))
    controller, conversation = scripted(
        "srs_ldc500", attach, clock, [*IN_STEP, (READING[0], reply), again], first_token=7
    )
    assert controller.read_temperature().value == 25.648
    assert controller.read_temperature().value == 25.648
    conversation.assert_over()


def test_the_emulator_holds_the_same_conversation(plant: StillPlant) -> None:
    plant.temperature_degC = 25.648
    tec = SrsLdc500(plant)
    for index, (request, reply) in enumerate([*IN_STEP, READING]):
        tec.receive(request, float(index))
        assert tec.transmit(index + 0.9) == reply


@pytest.mark.parametrize(
    ("reply", "error"),
    [
        (b"25.648\r\n8\r\n25.648\r\n8\r\n", OutOfStep),  # the answer before, once more
        (b"25.648\r\n0\r\n25.648\r\n0\r\n", OutOfStep),  # restarted in between
        (b"25.648\r\n9\r\n25.648\r\nx\r\n", Corrupt),
        (b"25.648\r\n25.648\r\n9\r\n", TimedOut),  # a line is missing
        (b"25.648\r\n9\r\n25.648\r\n9", TimedOut),
        (b"", TimedOut),
        (b"25.6\r\n25.648\r\n9\r\n25.648\r\n9\r\n", InstrumentError),
    ],
)
def test_what_is_no_answer(attach: Attach, clock: VirtualClock, reply: bytes, error: type[InstrumentError]) -> None:
    silence: list[tuple[bytes, bytes]] = []
    if error is TimedOut:  # the error queue is asked why
        silence = [(b"\n*ESE 11;*ESE?\n", b"11\r\n"), (b"LEXE?;LCME?;*ESE?;*ESE 12\n", b"0\r\n0\r\n11\r\n")]
    controller, conversation = scripted(
        "srs_ldc500", attach, clock, [*IN_STEP, (READING[0], reply), *silence], first_token=7
    )
    with pytest.raises(error):
        controller.read_temperature()
    conversation.assert_over()
    assert controller.link.in_doubt is not bool(silence)


def test_two_readings_that_differ_are_asked_for_again(attach: Attach, clock: VirtualClock) -> None:
    line = b"TTRD?;*ESE?;TTRD?;*ESE?;*ESE %d\n"
    differ = [(line % (10 + index), b"25.648\r\n%d\r\n25.649\r\n%d\r\n" % (9 + index, 9 + index)) for index in range(3)]
    controller, conversation = scripted(
        "srs_ldc500",
        attach,
        clock,
        [*IN_STEP, *differ[:2], (line % 12, b"25.65\r\n11\r\n25.65\r\n11\r\n")],
        first_token=7,
    )
    assert controller.read_temperature().value == 25.65
    conversation.assert_over()
    controller, conversation = scripted("srs_ldc500", attach, clock, [*IN_STEP, *differ])
    with pytest.raises(Corrupt, match="not twice"):
        controller.read_temperature()
    conversation.assert_over()


def test_a_stale_pair_before_a_lone_token_is_no_reading(attach: Attach, clock: VirtualClock) -> None:
    """The question arrived hurt, so that only its token came, and an old answer without its own before it."""
    line = b"TTRD?;*ESE?;TTRD?;*ESE?;*ESE %d\n"
    stale = [(line % (10 + k), b"18.9256\r\n18.9256\r\n%d\r\n%d\r\n" % (9 + k, 9 + k)) for k in range(3)]
    controller, conversation = scripted("srs_ldc500", attach, clock, [*IN_STEP, *stale])
    with pytest.raises(Corrupt, match="about a token"):
        controller.read_temperature()
    conversation.assert_over()


def test_an_instrument_without_line_ends_is_told_to_use_them(
    plant: StillPlant, attach: Attach, clock: VirtualClock
) -> None:
    for term in (0, 1):
        tec = SrsLdc500(plant, start_s=clock.now_s())
        tec.values["TERM"] = term
        assert open_controller("srs_ldc500", attach(tec), clock).read_temperature().value == 25.0
        assert tec.values["TERM"] == 3


def test_messages_fit_into_the_buffer(attach: Attach, clock: VirtualClock, plant: StillPlant) -> None:
    longest = 0

    class Listener(SrsLdc500):
        def receive(self, data: bytes, time_s: float) -> None:
            nonlocal longest
            longest = max(longest, *(len(line) + 1 for line in data.split(b"\n")))
            super().receive(data, time_s)

    controller = open_controller("srs_ldc500", attach(Listener(plant)), clock, first_token=200)
    controller.identify()
    controller.configure(4.321, (-100.125, 149.125), 0.0)
    controller.arm_current()
    controller.set_current_A(-4.321)
    controller.arm_setpoint()
    controller.set_setpoint_degC(149.123)
    controller.status()
    assert controller.off()
    assert 30 < longest <= 64
    with pytest.raises(ValueError, match="64"):
        controller.link.ask("TTRD?;" * 10)  # type: ignore[attr-defined]


# ---- driver against the emulator ------------------------------------------------------------------


@pytest.fixture(params=[{}, {"joined": True}, {"heating_sign": -1}], ids=str)
def wiring(request: pytest.FixtureRequest) -> dict[str, Any]:
    return dict(request.param)


@pytest.fixture
def controller(attach: Attach, clock: VirtualClock, plant: StillPlant, wiring: dict[str, Any]) -> SrsLdc500Controller:
    options = {"heating_sign": wiring["heating_sign"]} if "heating_sign" in wiring else {}
    driver = open_controller("srs_ldc500", attach(SrsLdc500(plant, **wiring)), clock, **options)
    assert isinstance(driver, SrsLdc500Controller)
    return driver


@pytest.fixture
def armed(controller: SrsLdc500Controller) -> SrsLdc500Controller:
    controller.configure(2.0, (10.0, 95.0), 5.0)
    controller.arm_current()
    return controller


def emulator() -> SrsLdc500:
    line = protocol_sim.look_up("test-0")
    assert line is not None
    assert isinstance(line.instrument, SrsLdc500)
    return line.instrument


def test_identity(controller: SrsLdc500Controller) -> None:
    assert str(controller.identify()) == "SRS LDC501, serial number 098023, firmware 2.00"
    emulator().identity = "KEITHLEY INSTRUMENTS INC.,MODEL 2510,1,2"
    with pytest.raises(Refused, match="2510"):
        controller.identify()


def test_configuration(controller: SrsLdc500Controller, plant: StillPlant) -> None:
    values = emulator().values
    values |= {"TEON": 1, "TMOD": 1}
    controller.configure(2.5, (10.0, 95.0), 5.0)
    assert [values[name] for name in ("TEON", "TMOD", "TCUR", "TILM", "TMIN", "TMAX")] == [0, 0, 0, 2.5, 10, 95]
    assert (controller.commands_current, controller.has_dead_man) == (True, False)


def test_a_setting_that_is_refused(controller: SrsLdc500Controller) -> None:
    with pytest.raises(Refused, match="execution error: TMAX") as refused:
        controller.configure(2.0, (10.0, 1000.0), 0.0)
    assert refused.value.code == 1


def test_a_setting_that_is_not_kept(controller: SrsLdc500Controller, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(SrsLdc500, "change_current_limit", lambda *_: None)
    with pytest.raises(Refused, match=r"TILM was set to 2\.0000 and reads 4\.5"):
        controller.configure(2.0, (10.0, 95.0), 0.0)


def test_current_arrives_and_is_read(armed: SrsLdc500Controller, plant: StillPlant) -> None:
    assert plant.current_A == 0.0
    for current_A in (2.0, -2.0, 0.25, 0.0):
        armed.set_current_A(current_A)
        assert plant.current_A == current_A
        assert armed.read_current().value == current_A
    assert armed.status().text == "on, current"
    for current_A in (2.01, -2.01, math.nan):
        with pytest.raises(ValueError, match="outside"):
            armed.set_current_A(current_A)
    with pytest.raises(Refused, match="armed"):
        armed.set_setpoint_degC(30.0)


def test_own_regulation(armed: SrsLdc500Controller, plant: StillPlant, clock: VirtualClock) -> None:
    plant.heating_K_per_A_s = 0.5
    armed.arm_setpoint()
    clock.sleep_until_s(clock.now_s() + 5.0)
    assert armed.read_temperature().value == pytest.approx(25.0, abs=0.01)
    armed.set_setpoint_degC(40.0)
    clock.sleep_until_s(clock.now_s() + 300.0)
    assert armed.read_temperature().value == pytest.approx(40.0, abs=0.1)
    for setpoint_degC in (9.9, 95.1, math.nan):
        with pytest.raises(ValueError, match="outside"):
            armed.set_setpoint_degC(setpoint_degC)
    with pytest.raises(Refused, match="armed"):
        armed.set_current_A(0.1)
    plant.temperature_degC = 9.0
    with pytest.raises(Refused, match="within"):
        armed.arm_setpoint()


def test_temperature_reading(controller: SrsLdc500Controller, plant: StillPlant, clock: VirtualClock) -> None:
    plant.temperature_degC = -3.25
    clock.sleep_until_s(5.0)
    controller.read_temperature()
    begin_s = clock.now_s()
    reading = controller.read_temperature()
    assert (reading.value, reading.quality) == (-3.25, Quality.OK)
    assert begin_s < reading.time_s < clock.now_s()
    assert clock.now_s() - begin_s < 0.07
    plant.temperature_degC = math.nan
    assert controller.read_temperature().quality is Quality.INVALID


def test_words_are_understood(armed: SrsLdc500Controller) -> None:
    emulator().values["TOKN"] = 1
    assert armed.status().output_is_on
    armed.arm_setpoint()
    assert armed.off()
    assert not armed.status().output_is_on


def test_off_is_confirmed(armed: SrsLdc500Controller, plant: StillPlant) -> None:
    armed.set_current_A(1.0)
    assert armed.off() is True
    assert plant.current_A == 0.0
    with pytest.raises(Refused, match="armed"):
        armed.set_current_A(1.0)


def test_off_is_not_confirmed_by_a_device_that_still_drives(armed: SrsLdc500Controller) -> None:
    emulator().drive = lambda: None  # type: ignore[method-assign]
    emulator().output_A = 1.0
    assert armed.off() is False


def test_off_is_not_confirmed_by_an_enable_that_reads_on(armed: SrsLdc500Controller) -> None:
    emulator().switch = lambda on: None  # type: ignore[method-assign]
    assert armed.off() is False


def test_a_device_that_restarted_is_no_longer_armed(armed: SrsLdc500Controller, clock: VirtualClock) -> None:
    tec = emulator()
    tec.switch(0.0)
    tec.values["*ESE"] = 0
    with pytest.raises(OutOfStep):
        armed.set_current_A(1.0)
    with pytest.raises(Refused, match="armed"):
        armed.set_current_A(1.0)
