"""The TCLab's emulator and driver: words of its firmware, a heater's drive, fences, off; and the package `tclab`."""

from __future__ import annotations

import types
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from rig.core.clock import VirtualClock
from rig.core.errors import Corrupt, Disconnected, InstrumentError, OutOfStep, Refused
from rig.core.reading import Quality
from rig.drivers.controller import OFF_S, cools, drive_unit
from rig.drivers.registry import open_controller
from rig.drivers.tclab import TcLabController
from rig.ports import protocol_sim
from rig.ports.pseudo_terminal import PseudoTerminals
from sim.instruments.instrument import Instrument
from sim.instruments.tclab import DEGC_PER_STEP, TcLab
from tests.rig.drivers.conversation import scripted
from tests.rig.drivers.far_ends import Host
from tests.rig.drivers.still_plant import StillPlant

Attach = Callable[[Instrument], str]


@pytest.fixture
def board(plant: StillPlant) -> TcLab:
    return TcLab(plant)


@pytest.fixture
def host(board: TcLab) -> Host:
    return Host(board, b"\n")


# ---- emulator: what the firmware's source says ---------------------------------------------------


def test_words_of_the_firmware(host: Host, plant: StillPlant) -> None:
    plant.temperature_degC, plant.sink_degC = 25.0, 21.0
    dialogue = [
        ("VER", "TCLab Firmware 1.4.0 Arduino Uno"),
        ("T1", "24.77"),  # 232 steps of 0.3223 K from -50 degC
        ("t1", "24.77"),
        ("T2", "20.91"),
        ("Q1 50", "50.00"),
        ("R1", "50.00"),
        ("Q1 150", "100.00"),
        ("Q1 -3", "0.00"),
        ("Q1 nonsense", "0.00"),
        ("Q2 12.5", "12.50"),
        ("SCAN", "24.77\r\n20.91\r\n0.00\r\n12.50"),
        ("P1 300", "255.00"),
        ("P2 17.25", "17.25"),
        ("LED 40", "40.00"),
        ("", ""),
        ("X", "X"),
        ("R2", "0.00"),
        ("A", "Start"),
    ]
    for command, reply in dialogue:
        assert host.say(command) == reply, command


@pytest.mark.parametrize(("version", "stop", "drive"), [("1.4.3", "Stop", "50.00"), ("2.0.1", "Stop", "50.000")])
def test_later_firmware(plant: StillPlant, version: str, stop: str, drive: str) -> None:
    host = Host(TcLab(plant, version=version), b"\n")
    assert host.say("Q1 50") == drive
    assert host.say("X") == stop


@pytest.mark.parametrize("end", [b"\n", b"\r", b"\r\n"])
def test_ends_of_line(host: Host, end: bytes) -> None:
    assert host.say("R1", end=end) == "0.00"
    assert host.say("T1", end=end) == "24.77"


@pytest.mark.parametrize("command", ["X", "A", "Q3 5", "#0015AA?IF62AE", "*IDN?", "Q1B", "x" * 65])
def test_what_it_does_not_know_switches_the_heaters_off(host: Host, plant: StillPlant, command: str) -> None:
    host.say("Q1 80")
    host.say("Q2 80")
    assert plant.current_A == pytest.approx(0.8)
    host.say(command)
    assert (plant.current_A, host.say("R1"), host.say("R2")) == (0.0, "0.00", "0.00")


def test_drive_has_steps_of_the_pulse_width(host: Host, plant: StillPlant) -> None:
    host.say("Q1 50.3")
    assert plant.current_A == pytest.approx(100 / 200)  # 100.6 of 255 is truncated
    host.say("P1 100")
    assert plant.current_A == pytest.approx(100 / 200)  # a power limit counts from the next drive on
    host.say("Q1 50.3")
    assert plant.current_A == pytest.approx(50 / 200)


# ---- conversations ------------------------------------------------------------------------------

IN_STEP = (b"\nP2 0.08\n", b"0.08\r\n")
IDENTIFY = [IN_STEP, (b"VER\nP2 0.09\n", b"TCLab Firmware 1.4.0 Arduino Uno\r\n0.09\r\n")]
CONFIGURE = [
    (b"Q1 0.00\nR1\nP2 0.10\n", b"0.00\r\n0.00\r\n0.10\r\n"),
    (b"Q2 0.00\nR2\nP2 0.11\n", b"0.00\r\n0.00\r\n0.11\r\n"),
    (b"P1 200.00\nP2 0.12\n", b"200.00\r\n0.12\r\n"),
]
DRIVE = [
    (b"Q1 0.00\nR1\nP2 0.13\n", b"0.00\r\n0.00\r\n0.13\r\n"),
    (b"Q1 37.50\nR1\nP2 0.14\n", b"37.50\r\n37.50\r\n0.14\r\n"),
    (b"T1\nT1\nT1\nP2 0.15\n", b"24.77\r\n24.77\r\n24.77\r\n0.15\r\n"),
    (b"Q1 0\nQ2 0\nR1\nR2\nR1\nR2\nP2 0.16\n", b"0.00\r\n" * 6 + b"0.16\r\n"),
]


def test_conversation_of_a_run(attach: Attach, clock: VirtualClock) -> None:
    controller, conversation = scripted("tclab", attach, clock, [*IDENTIFY, *CONFIGURE, *DRIVE])
    assert str(controller.identify()) == "TCLab Arduino Uno, serial number , firmware 1.4.0"
    assert clock.now_s() > 2.0  # not before the board has started
    controller.configure(1.0, (10.0, 90.0), 5.0)
    controller.arm_current()
    controller.set_current_A(0.375)
    assert controller.read_temperature().value == 24.77
    assert controller.off() is True
    conversation.assert_over()


def test_the_emulator_holds_the_same_conversation(board: TcLab) -> None:
    for index, (request, reply) in enumerate([*IDENTIFY, *CONFIGURE, *DRIVE]):
        board.receive(request, float(index))
        assert board.transmit(index + 0.9) == reply


@pytest.mark.parametrize(
    ("reply", "error"),
    [
        (b"24.77\r\n24.77\r\n24.77\r\n0.08\r\n", OutOfStep),  # the fence of before
        (b"24.77\r\n24.77\r\n24.77\r\n24.77\r\n0.09\r\n", OutOfStep),
        (b"24.77\r\n24.77\r\n24.77\r\n0.09\r\n24.77\r\n", OutOfStep),
        (b"24.77\r\n2477\r\n24.77\r\n0.09\r\n", Corrupt),
        (b"24.77\r\nSTOP\r\n24.77\r\n0.09\r\n", Corrupt),
        (b"24.77\r\nnan\r\n24.77\r\n0.09\r\n", Corrupt),
    ],
)
def test_what_is_no_reading(attach: Attach, clock: VirtualClock, reply: bytes, error: type[InstrumentError]) -> None:
    controller, conversation = scripted(
        "tclab", attach, clock, [IN_STEP, (b"T1\nT1\nT1\nP2 0.09\n", reply)], first_token=7
    )
    with pytest.raises(error):
        controller.read_temperature()
    conversation.assert_over()
    assert controller.link.in_doubt


@pytest.mark.parametrize("one", [b"94.77", b"4.77", b"26.09"])
def test_one_wrong_reading_of_three_is_never_it(attach: Attach, clock: VirtualClock, one: bytes) -> None:
    for replies in ((one, b"24.77", b"24.45"), (b"24.45", one, b"24.77"), (b"24.77", b"24.45", one)):
        hurt = (b"T1\nT1\nT1\nP2 0.09\n", b"\r\n".join((*replies, b"0.09\r\n")))
        good = (b"T1\nT1\nT1\nP2 0.10\n", b"24.77\r\n24.45\r\n24.77\r\n0.10\r\n")
        controller, conversation = scripted("tclab", attach, clock, [IN_STEP, hurt, good])
        assert controller.read_temperature().value == 24.77
        conversation.assert_over()


@pytest.mark.parametrize("text", [b"TCLab Firmware Version 1.1.0", b"TClab Firmware 0.03", b"Stop", b"24.77"])
def test_who_is_no_board_of_ours(attach: Attach, clock: VirtualClock, text: bytes) -> None:
    controller, _ = scripted(
        "tclab", attach, clock, [IN_STEP, (b"VER\nP2 0.09\n", text + b"\r\n0.09\r\n")], first_token=7
    )
    with pytest.raises(Refused, match=r"too old|is no TCLab"):
        controller.identify()


# ---- driver against the emulator -----------------------------------------------------------------


@pytest.fixture
def controller(attach: Attach, clock: VirtualClock, board: TcLab) -> TcLabController:
    driver = open_controller("tclab", attach(board), clock)
    assert isinstance(driver, TcLabController)
    driver.configure(0.8, (10.0, 90.0), 5.0)
    return driver


def test_a_heater_takes_a_drive(controller: TcLabController, plant: StillPlant) -> None:
    assert (drive_unit(controller), cools(controller)) == ("of full drive", False)
    assert (drive_unit(object()), cools(object())) == ("A", True)
    with pytest.raises(Refused, match="not armed"):
        controller.set_current_A(0.5)
    controller.arm_current()
    assert plant.current_A == 0.0
    controller.set_current_A(0.5)
    assert plant.current_A == pytest.approx(0.5)
    assert controller.read_current().value == pytest.approx(0.5)
    assert controller.status().text == "heater 1 at 50 %, heater 2 at 0 %"
    assert controller.status().output_is_on


@pytest.mark.parametrize(("drive", "why"), [(-0.1, "cannot cool"), (0.9, "outside"), (float("nan"), "outside")])
def test_a_drive_that_it_does_not_take(controller: TcLabController, plant: StillPlant, drive: float, why: str) -> None:
    controller.arm_current()
    with pytest.raises(ValueError, match=why):
        controller.set_current_A(drive)
    assert plant.current_A == 0.0


def test_what_it_has_not(controller: TcLabController) -> None:
    for act in (controller.arm_setpoint, lambda: controller.set_setpoint_degC(30.0)):
        with pytest.raises(Refused, match="no regulation"):
            act()
    with pytest.raises(Refused, match="no ramp"):
        controller.set_ramp_K_per_s(1.0)
    assert not controller.has_dead_man
    assert controller.own_limits().faults(0.8, (10.0, 90.0), 5.0) == []
    for limit in (0.0, 1.5, 4.0):
        with pytest.raises(ValueError, match="share of full drive"):
            controller.configure(limit, (10.0, 90.0), 5.0)


@pytest.mark.parametrize("options", [{"heater": 3}, {"full_pwm": 0}, {"full_pwm": 256}])
def test_options_that_it_does_not_take(attach: Attach, clock: VirtualClock, board: TcLab, options: Any) -> None:
    with pytest.raises(ValueError, match="is expected"):
        open_controller("tclab", attach(board), clock, **options)


def test_the_second_heater(attach: Attach, clock: VirtualClock, plant: StillPlant) -> None:
    board = TcLab(plant, heater=2)
    driver = open_controller("tclab", attach(board), clock, heater=2, full_pwm=255)
    driver.configure(1.0, (10.0, 90.0), 5.0)
    driver.arm_current()
    driver.set_current_A(1.0)
    assert board.heaters == {1: 0.0, 2: 100.0}
    assert plant.current_A == pytest.approx(255 / 200)
    assert board.power_limits[1] <= 100.0  # the fence never raises a limit above the firmware's own
    assert driver.off()
    assert plant.current_A == 0.0


@pytest.mark.parametrize("version", ["1.4.0", "2.0.1"])
def test_temperature(attach: Attach, clock: VirtualClock, plant: StillPlant, version: str) -> None:
    driver = open_controller("tclab", attach(TcLab(plant, version=version)), clock)
    plant.temperature_degC = 61.7
    reading = driver.read_temperature()
    assert (reading.quality, reading.value) == (Quality.OK, pytest.approx(61.7, abs=DEGC_PER_STEP))
    plant.temperature_degC = float("nan")  # an open input
    assert driver.read_temperature().quality is Quality.INVALID


def test_a_board_that_restarted_is_not_armed_any_more(
    controller: TcLabController, board: TcLab, plant: StillPlant
) -> None:
    controller.arm_current()
    controller.set_current_A(0.5)
    board.heaters = {1: 0.0, 2: 0.0}  # as after a restart, or a command that was garbled on its way
    controller.link.doubt()
    with pytest.raises(Refused, match="not armed"):
        controller.set_current_A(0.6)
    assert board.heaters[1] == 0.0


def test_off_is_not_confirmed_by_a_heater_that_reads_on(controller: TcLabController, board: TcLab) -> None:
    controller.arm_current()
    controller.set_current_A(0.5)
    board._heat = lambda number, percent: None  # type: ignore[method-assign]
    assert controller.off() is False


def test_a_stop_does_not_wait_for_a_start(attach: Attach, clock: VirtualClock, board: TcLab, plant: StillPlant) -> None:
    """A board that listens at once (a Leonardo, or one whose port was opened long ago) is off at once."""
    driver = open_controller("tclab", attach(board), clock, boot_s=9.0)
    assert driver.off() is True
    assert clock.now_s() < OFF_S
    driver.configure(1.0, (10.0, 90.0), 5.0)
    driver.arm_current()
    driver.set_current_A(0.5)
    protocol_sim.unregister("test-0")
    with pytest.raises(Disconnected):
        driver.read_temperature()
    protocol_sim.register("test-0", board, clock)
    driver.link.doubt()
    begin_s = clock.now_s()
    driver.read_temperature()  # a STOP may be behind this exchange, which opens the port anew
    assert driver.off() is True
    assert clock.now_s() - begin_s < OFF_S
    assert plant.current_A == 0.0


def test_a_board_that_was_opened_just_now_is_asked_once_more(attach: Attach, clock: VirtualClock, board: TcLab) -> None:
    """An Uno, which the opening has restarted, listens two seconds later; without that no start would come about."""
    heard = board.receive
    board.receive = lambda data, time_s: heard(data, time_s) if time_s > 2.0 else None  # type: ignore[method-assign]
    driver = open_controller("tclab", attach(board), clock)
    assert driver.off() is True
    assert 2.0 < clock.now_s() < 2.0 + OFF_S


# ---- the package `tclab`, which others use ---------------------------------------------------------


@pytest.fixture
def others_client(plant: StillPlant, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    package = pytest.importorskip("tclab", reason="tclab is not installed")
    module = package.tclab
    with PseudoTerminals({"board": TcLab(plant)}) as terminals:
        path = terminals.paths["board"]
        ports = types.SimpleNamespace(comports=lambda: [(path, "a board", "USB VID:PID=16D0:0613")])
        monkeypatch.setattr(module, "list_ports", ports)
        monkeypatch.setattr(module, "time", types.SimpleNamespace(sleep=lambda seconds: None))  # no board starts here
        lab = module.TCLab()
        yield lab
        lab.close()


def test_others_client(others_client: Any, plant: StillPlant) -> None:
    lab = others_client
    assert lab.version == "TCLab Firmware 1.4.0 Arduino Uno"
    plant.temperature_degC, plant.sink_degC = 61.7, 20.0
    assert (lab.T1, lab.T2) == (61.52, 19.94)
    assert lab.Q1(37.5) == 37.5
    assert plant.current_A == pytest.approx(75 / 200)
    assert lab.Q1() == 37.5
    lab.P1 = 255
    assert lab.P1 == 255.0
    assert lab.Q2(120) == 100.0
    assert lab.scan() == (61.52, 19.94, 37.5, 100.0)
    assert lab.LED(50) == 50.0
    assert lab.Q1(0) == 0.0
    assert plant.current_A == 0.0
