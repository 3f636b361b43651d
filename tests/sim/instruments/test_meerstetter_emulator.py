"""The emulated TEC controller, beyond its dialogues: frames, addresses, watchdog, error limits, regulation, flash."""

from __future__ import annotations

import math
import struct
from binascii import crc_hqx

import pytest

from sim.instruments.meerstetter import MeerstetterTec
from tests.rig.drivers.still_plant import StillPlant
from tests.sim.instruments.hosts import Host, host_of


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
def test_it_answers_its_own_address_and_that_of_everybody(
    plant: StillPlant, address: int, number: int, answers: bool
) -> None:
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
def test_error_limits_trip_and_latch_until_a_reset(
    host: Host, plant: StillPlant, temperature_degC: float, number: int
) -> None:
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
