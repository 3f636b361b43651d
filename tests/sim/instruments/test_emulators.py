"""What each emulator answers, as `dialogues.txt` has it from the manuals; what it refuses; and when it answers."""

from __future__ import annotations

import math
import re
import struct
from binascii import crc_hqx
from pathlib import Path
from typing import Any

import pytest

from rig.drivers.lakeshore import TOKENS
from sim.instruments.lakeshore import LakeShore
from sim.instruments.meerstetter import MeerstetterTec
from sim.instruments.multimeters import Keithley2000
from sim.instruments.srs_ldc500 import SrsLdc500
from tests.rig.drivers.still_plant import StillPlant
from tests.sim.instruments.hosts import Host, host_of


def read_dialogues() -> dict[str, list[str]]:
    """Return the lines of each, by its heading."""
    found: dict[str, list[str]] = {}
    for line in Path(__file__).with_name("dialogues.txt").read_text(encoding="utf-8").splitlines():
        if line.startswith("== "):
            lines = found[line[3:]] = []
        elif line and not line.startswith("# "):
            lines.append(line)
    return found


DIALOGUES = read_dialogues()


@pytest.mark.parametrize("heading", DIALOGUES)
def test_the_emulator_holds_its_dialogue(heading: str, plant: StillPlant) -> None:
    driver, *words = heading.partition(":")[0].split()
    options: dict[str, Any] = dict(word.split("=") for word in words)
    for name in options.keys() & {"update_s", "heating_sign"}:
        options[name] = float(options[name])
    host = host_of(driver, plant, **options)
    asks_for_errors = ""
    for line in DIALOGUES[heading]:
        if line.startswith("@ wait "):
            host.wait(float(line.removeprefix("@ wait ")))
        elif line.startswith("@ errors "):
            asks_for_errors = line.removeprefix("@ errors ")
        elif line.startswith("! "):  # refused; else a driver that asks for nonsense works on the simulated bench alone
            message, _, expected = (part.strip() for part in line.removeprefix("! ").partition("->"))
            assert host.say(message) == "", line
            assert re.sub(r"[\r\n]+", " | ", host.say(asks_for_errors)).startswith(expected), line
        elif line.startswith("@ "):
            name, sign, value = line.removeprefix("@ ").split()
            if sign == "=":
                setattr(plant, name, float(value))
            else:
                assert getattr(plant, name) == pytest.approx(
                    float(value), rel=0.03 if driver == "te_technology" else 1e-6
                ), line
        else:
            message, _, expected = (part.strip() for part in line.partition("->"))
            reply = re.sub(r"[\r\n]+", " | ", host.say(message))
            assert reply.startswith(expected[:-3]) if expected.endswith("...") else reply == expected, line


# ---- lines and their ends -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("driver", "message", "reply"),
    [
        ("keithley2000", "*OPC?", "1"),
        ("srs_ldc500", "TMOD?", "0"),
        ("tclab", "T1", "24.77"),
        ("lakeshore", "RANGE? 1", "0"),
    ],
)
@pytest.mark.parametrize("end", [b"\r", b"\n", b"\r\n"])
def test_each_end_of_a_line_ends_one(plant: StillPlant, driver: str, message: str, reply: str, end: bytes) -> None:
    host = host_of(driver, plant)
    assert [host.say(message, end=end) for _ in range(2)] == [reply, reply]
    assert host.say(message, end=b"") == ""  # nothing runs before it
    assert host.say("", end=end) == reply


@pytest.mark.parametrize(("number", "end"), [(0, ""), (1, "\r"), (2, "\n"), (3, "\r\n"), (4, "\n\r"), ("lf", "\n")])
def test_srs_answers_end_as_it_is_set(plant: StillPlant, number: object, end: str) -> None:
    tec = SrsLdc500(plant)
    tec.receive(f"TERM {number};TMOD?;TEON?\n".encode(), 0.0)
    assert tec.transmit(0.3).decode() == f"0{end}0{end}"


def test_the_error_queue_holds_ten(plant: StillPlant) -> None:
    host = host_of("keithley2000", plant)
    for _ in range(13):
        host.say(":BOGUS")
    errors = [host.say(":SYST:ERR?") for _ in range(11)]
    assert errors == ['-113,"Undefined header"'] * 9 + ['350,"Queue Overflow"', '0,"No error"']


def test_srs_takes_a_moment_to_log_an_error(plant: StillPlant) -> None:
    host = Host(SrsLdc500(plant, error_s=0.2), b"\n", 0.1)
    assert host.say("XYZW;LCME?") == "0"
    host.wait(0.2)
    assert host.say("LCME?") == "2"


def test_lakeshore_keeps_every_token_of_the_driver(plant: StillPlant) -> None:
    host = host_of("lakeshore", plant)
    for token in TOKENS:
        host.say(f"*ESE {token}")
        assert host.say("*ESE?") == f"{token:03d}"
    assert len(TOKENS) == 31


@pytest.mark.parametrize("command", ["X", "A", "Q3 5", "#0015AA?IF62AE", "*IDN?", "Q1B", "x" * 65])
def test_what_a_tclab_does_not_know_switches_its_heaters_off(plant: StillPlant, command: str) -> None:
    host = host_of("tclab", plant)
    host.say("Q1 80")
    host.say("Q2 80")
    assert plant.current_A == pytest.approx(0.8)
    host.say(command)
    assert (plant.current_A, host.say("R1"), host.say("R2")) == (0.0, "0.00", "0.00")


@pytest.mark.parametrize(("gain", "sign"), [(-1.0, 1), (-1.0, -1), (1.0, 1)])
def test_srs_regulates_with_a_negative_gain_alone(plant: StillPlant, gain: float, sign: int) -> None:
    host_of("srs_ldc500", plant, heating_sign=sign).say(f"TMOD CT;TEMP 30;TPGN {gain};TEON 1")
    assert (plant.current_A > 0.0) is (gain < 0.0)


# ---- time -----------------------------------------------------------------------------------------


def test_a_meter_samples_the_middle_of_its_aperture(plant: StillPlant) -> None:
    meter = Keithley2000(plant, baudrate=9600, command_s=0.002, overhead_s=0.004)
    host = Host(meter)
    host.say(":CONF:FRES;:SENS:FRES:NPLC 5;:SENS:FRES:RANG 10000")
    meter.receive(b":READ?\r", host.time_s)
    arrived_s = host.time_s + 7 / 960 + 0.002
    due_s = host.time_s
    while not (data := meter.transmit(due_s)):
        following = meter.next_transmit_s()
        assert following is not None
        assert following > due_s
        due_s = following
    assert plant.sampled_s == pytest.approx(arrived_s + 0.05)
    assert due_s == pytest.approx(arrived_s + 0.1 + 0.004 + len(data) / 960)


def test_commands_and_a_fetch_wait_for_a_reading(plant: StillPlant) -> None:
    host = host_of("keithley2000", plant)
    host.say(":CONF:FRES;:SENS:FRES:NPLC 10;:SENS:FRES:RANG 10000")
    host.instrument.receive(b":INIT;:FETC?\r:SENS:FRES:RANG 100000\r*OPC?\r", host.time_s)
    assert host.instrument.transmit(host.time_s + 0.15) == b""
    assert plant.test_current_A == 1e-4
    assert host.say("") == "+1.00000000E+04\n1"
    assert plant.test_current_A == 1e-5


@pytest.mark.parametrize(
    ("driver", "character"), [("keithley2000", b"\x18"), ("keithley2000", b"\x03"), ("hp34401a", b"\x03")]
)
def test_an_abort_discards_everything(plant: StillPlant, driver: str, character: bytes) -> None:
    host = host_of(driver, plant)
    host.say("SYST:REM")
    host.say(":CONF:RES;:RES:NPLC 10")
    host.instrument.receive(b":READ?\r*ID", host.time_s)
    host.instrument.transmit(host.time_s + 0.02)
    host.instrument.receive(character + b"*OPC?\r", host.time_s + 0.05)
    assert [host.say(""), host.say("")] == ["1", ""]
    assert host.say("READ?") == "+1.00000000E+04"


def test_hp34401a_holds_off_while_an_answer_is_due(plant: StillPlant) -> None:
    host = host_of("hp34401a", plant)
    host.say("SYST:REM")
    host.say("CONF:RES 10000")
    dmm = host.instrument
    dmm.receive(b"READ?\n", host.time_s)
    dmm.transmit(host.time_s + 0.02)
    dmm.receive(b"FUNC?\n", host.time_s + 0.02)  # fits into the ten characters
    dmm.receive(b"FUNC?\n", host.time_s + 0.03)  # does not
    assert host.say("") == '+1.00000000E+04\r\n"RES"'
    assert host.say("") == ""  # ends what has arrived of the second
    assert host.say("SYST:ERR?") == '512,"RS-232 overrun error"'
    assert host.say("FUNC?") == '"RES"'
    host.say("*CLS;" * 20 + "FUNC?")
    assert host.say("SYST:ERR?") == '+0,"No error"'
    assert host.say("*CLS;" * 21 + "FUNC?") != '"RES"'


def test_lakeshore_makes_ten_readings_a_second(plant: StillPlant) -> None:
    host = Host(LakeShore(plant), b"\n", 0.02)
    assert host.say("CRDG? A") == "+025.000"
    plant.temperature_degC = 26.0
    assert host.say("CRDG? A") == "+025.000"
    host.wait(0.1)
    assert host.say("CRDG? A") == "+026.000"


# ---- Meerstetter: frames, addresses, watchdog, error limits, regulation, flash ----------------------


@pytest.fixture
def host(plant: StillPlant) -> Host:
    return host_of("meerstetter", plant)


@pytest.fixture
def tec(plant: StillPlant) -> MeerstetterTec:
    return MeerstetterTec(plant, device_type=1089)


def say(host: Host, *messages: str) -> None:
    for message in messages:
        assert host.say(message) == ""


def asked(address: int) -> bytes:
    """A device's type is asked for."""
    body = b"#%02X1234?VR006401" % address
    return body + b"%04X\r" % crc_hqx(body, 0)


def start(host: Host) -> None:
    """The live current, 1 A."""
    say(host, "2000=1", "2010=2", "50001=1.0", "50000=1")


# ---- frames ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("address", "number", "answers"), [(0, 3, True), (3, 3, True), (2, 3, False), (255, 3, False), (1, 1, True)]
)
def test_it_answers_its_own_address_and_0(plant: StillPlant, address: int, number: int, answers: bool) -> None:
    host = host_of("meerstetter", plant, address=number)
    host.instrument.receive(asked(address), 0.0)
    assert bool(host.instrument.transmit(1.0)) is answers


@pytest.mark.parametrize(
    "data",
    [
        b"#0015AB?VR03E801C21B\r",
        b"#0015AB?VR03E801C21\r",
        b"!0015AB?VR03E801C21A\r",
        b"\r\r\rhello\r",
        b"#00\r",
        b"#ZZ15AB?VR03E8010000\r",
    ],
)
def test_silence_on_what_is_no_request(tec: MeerstetterTec, data: bytes) -> None:
    tec.receive(data, 0.0)
    assert tec.next_transmit_s() is None
    assert tec.transmit(1.0) == b""


def test_a_frame_may_come_in_pieces_after_garbage(tec: MeerstetterTec) -> None:
    for time_s, piece in ((0.0, b"noise#0015"), (0.1, b"#0015AB?VR00"), (0.2, b"64018000"), (0.3, b"\r#0015")):
        tec.receive(piece, time_s)
    assert tec.transmit(0.4) == b"!0015AB000004411DBD\r"
    assert tec.next_transmit_s() is None


def test_the_wire_takes_its_time_and_a_request_acts_when_it_has_arrived(plant: StillPlant) -> None:
    tec = MeerstetterTec(plant, baudrate=57600, response_s=0.002)
    plant.heating_K_per_A_s = plant.current_A = 1.0
    tec.receive(b"#0015AB?VR03E801C21A\r", 1.0)
    due_s = tec.next_transmit_s()
    assert due_s == pytest.approx(1.0 + 21 / 5760 + 0.002 + 20 / 5760)
    assert tec.transmit(due_s - 1e-6) == b""
    value = struct.unpack(">f", bytes.fromhex(tec.transmit(due_s)[7:15].decode()))[0]
    assert value == pytest.approx(25.0 + 1.0 + 21 / 5760, abs=1e-5)
    assert tec.next_transmit_s() is None


def test_two_requests_at_once_are_answered_in_order(tec: MeerstetterTec) -> None:
    tec.receive(b"#0015AB?VR0064018000\r#0015AC?VR0066018125\r", 0.0)
    first, second, rest = tec.transmit(1.0).split(b"\r")
    assert (first[:15], second[:15], rest) == (b"!0015AB00000441", b"!0015AC00000070", b"")


# ---- protection -----------------------------------------------------------------------------------


def test_the_watchdog_turns_off_at_its_time(host: Host, plant: StillPlant) -> None:
    start(host)
    say(host, "2060=2.0")
    for _ in range(5):
        host.wait(1.5)
        host.say("1000?")
    fed_s = host.time_s - 0.05 + 21 / 5760
    assert plant.current_A == 1.0
    host.wait(5.0)
    assert plant.currents[-1] == (pytest.approx(fed_s + 2.0, abs=1e-6), 0.0)


def test_the_watchdog_is_not_fed_by_garbage_or_by_what_is_said_to_others(host: Host, plant: StillPlant) -> None:
    start(host)
    say(host, "2060=1.0")
    for _ in range(30):
        host.instrument.receive(b"#0015AB?VR03E801FFFF\r" + asked(9), host.time_s)
        host.wait(0.05)
    assert plant.current_A == 0.0


@pytest.mark.parametrize(("temperature_degC", "number"), [(96.0, 138), (9.0, 137), (math.nan, 134), (math.inf, 134)])
def test_error_limits_latch_until_a_reset(host: Host, plant: StillPlant, temperature_degC: float, number: int) -> None:
    say(host, "4010=10.0", "4011=95.0")
    start(host)
    plant.temperature_degC = temperature_degC
    host.wait(0.5)
    assert (plant.current_A, host.say("104?"), host.say("105?")) == (0.0, "3", str(number))
    plant.temperature_degC = 25.0
    host.wait(1.0)
    start(host)
    assert plant.current_A == 0.0
    assert host.say("RS") == "ACK"
    host.wait(1.0)
    assert (host.say("104?"), host.say("105?")) == ("1", "0")


# ---- regulation and flash -------------------------------------------------------------------------


@pytest.mark.parametrize("target_degC", [60.0, -15.0])
def test_own_regulation_reaches_its_target_both_ways(host: Host, plant: StillPlant, target_degC: float) -> None:
    plant.heating_K_per_A_s = 0.5
    say(host, "3010=10.0", "3011=60.0", "2030=3.0", "2000=2", f"3000={target_degC}", "2010=1")
    host.wait(5.0)
    assert (abs(plant.current_A), host.say("1200?")) == (3.0, "1")
    host.wait(300.0)
    assert plant.temperature_degC == pytest.approx(target_degC, abs=0.05)
    assert host.say("1200?") == "2"
    assert abs(float(host.say("1032?"))) < 5.0


def test_wrong_polarity_parameter_runs_away(host: Host, plant: StillPlant) -> None:
    plant.heating_K_per_A_s = 0.5
    say(host, "3034=0", "2000=2", "3000=26.0", "2010=1")
    host.wait(30.0)
    assert plant.temperature_degC < 20.0


def test_automatic_saving_wears_the_flash_unless_it_is_switched_off(host: Host) -> None:
    for off, written in (("0", 10), ("1", 10)):
        say(host, f"108={off}")
        for _ in range(10):
            say(host, "3000=30.0")
            host.wait(1.0)
        assert host.instrument.flash_writes == written
