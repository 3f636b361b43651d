"""The emulated TEC controller: frames, parameters, output, protection, regulation, flash."""

from __future__ import annotations

import math
import struct
from binascii import crc_hqx

import pytest

from sim.instruments.meerstetter import MeerstetterTec
from tests.rig.drivers.still_plant import StillPlant


class Host:
    """Speaks to one emulator and keeps the time."""

    def __init__(self, tec: MeerstetterTec) -> None:
        self.tec = tec
        self.time_s = 0.0

    def say(self, payload: bytes, address: int = 0) -> bytes:
        """The reply's payload, `ACK`, or nothing."""
        body = b"#%02X1234%b" % (address, payload)
        crc = b"%04X" % crc_hqx(body, 0)
        self.tec.receive(body + crc + b"\r", self.time_s)
        self.wait(0.05)
        reply = self.tec.transmit(self.time_s)
        if not reply:
            return b""
        assert reply[:7] == b"!" + body[1:7]
        assert reply.endswith(b"\r")
        if len(reply) == 12:
            assert reply[7:11] == crc
            return b"ACK"
        assert b"%04X" % crc_hqx(reply[:-5], 0) == reply[-5:-1]
        return reply[7:-5]

    def wait(self, duration_s: float) -> None:
        self.time_s += duration_s
        self.tec._plant.advance_to(self.time_s)

    def get(self, number: int) -> float:
        return struct.unpack(">f", bytes.fromhex(self.say(b"?VR%04X01" % number).decode()))[0]

    def get_int(self, number: int) -> int:
        return struct.unpack(">i", bytes.fromhex(self.say(b"?VR%04X01" % number).decode()))[0]

    def set(self, number: int, value: float) -> bytes:
        return self.say(b"VS%04X01%b" % (number, struct.pack(">f", value).hex().upper().encode()))

    def set_int(self, number: int, value: int) -> bytes:
        return self.say(b"VS%04X01%b" % (number, struct.pack(">i", value).hex().upper().encode()))


@pytest.fixture
def tec(plant: StillPlant) -> MeerstetterTec:
    return MeerstetterTec(plant)


@pytest.fixture
def host(tec: MeerstetterTec) -> Host:
    return Host(tec)


@pytest.mark.parametrize(
    ("payload", "reply"),
    [
        (b"?XX", b"+01"),
        (b"CS00", b"+01"),
        (b"?VR03E8", b"+04"),
        (b"?VR03G801", b"+04"),
        (b"VS0BB801-0000001", b"+04"),
        (b"VS0BB80141AE00", b"+04"),
        (b"?VR04D201", b"+05"),
        (b"VS03E80141AE0000", b"+06"),
        (b"VS0BB8017FC00000", b"+07"),
        (b"VS0BB801447A0001", b"+07"),
        (b"VS07DA0100000004", b"+07"),
        (b"VS080C013D4CCCCD", b"+07"),  # watchdog 0.05 s
        (b"?VR03E802", b"+08"),
    ],
)
def test_refusals(host: Host, payload: bytes, reply: bytes) -> None:
    assert host.say(payload) == reply


def test_limits(host: Host) -> None:
    assert host.say(b"?VL0BB801") == b"00C3888000447A0000"


def test_addresses(host: Host, tec: MeerstetterTec) -> None:
    assert host.say(b"?VR006401", address=1) == b"00000443"
    assert host.say(b"?VR006401", address=0) == b"00000443"
    assert host.say(b"?VR006401", address=2) == b""
    assert host.say(b"VS0BB80141AE0000", address=255) == b""
    assert host.get(3000) == 21.75
    assert host.set_int(2051, 7) == b"ACK"
    assert host.say(b"?VR006401", address=1) == b""
    assert host.say(b"?VR006401", address=7) == b"00000443"


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


def test_identification_with_and_without_instance(host: Host) -> None:
    assert host.say(b"?IF") == host.say(b"?IF01") == b"8065-TEC SW G01     "


def test_a_frame_may_come_in_pieces_after_garbage(plant: StillPlant) -> None:
    tec = MeerstetterTec(plant, device_type=1089)
    for time_s, piece in (
        (0.0, b"noise#0015"),
        (0.1, b"#0015AB?VR00"),
        (0.2, b"64018000"),
        (0.3, b"\r#0015"),
    ):
        tec.receive(piece, time_s)
    assert tec.transmit(0.4) == b"!0015AB000004411DBD\r"
    assert tec.next_transmit_s() is None


def test_the_wire_takes_its_time(plant: StillPlant) -> None:
    tec = MeerstetterTec(plant, baudrate=57600, response_s=0.002)
    tec.receive(b"#0015AB?VR03E801C21A\r", 1.0)
    due_s = tec.next_transmit_s()
    assert due_s == pytest.approx(1.0 + 21 / 5760 + 0.002 + 20 / 5760)
    assert tec.transmit(due_s - 1e-6) == b""
    assert len(tec.transmit(due_s)) == 20
    assert tec.next_transmit_s() is None


def test_a_request_takes_effect_when_it_has_arrived(plant: StillPlant) -> None:
    tec = MeerstetterTec(plant, baudrate=5760)
    plant.heating_K_per_A_s = 1.0
    plant.current_A = 1.0
    tec.receive(b"#0015AB?VR03E801C21A\r", 1.0)
    reply = tec.transmit(2.0)
    value = struct.unpack(">f", bytes.fromhex(reply[7:15].decode()))[0]
    assert value == pytest.approx(25.0 + 1.0 + 21 / 576, abs=1e-5)


def test_two_requests_at_once_are_answered_in_order(tec: MeerstetterTec) -> None:
    tec.receive(b"#0015AB?VR0064018000\r#0015AC?VR0066018125\r", 0.0)
    data = tec.transmit(1.0)
    assert data.count(b"\r") == 2
    assert data.startswith(b"!0015AB00000443")
    assert b"!0015AC00000070" in data


# ---- output ---------------------------------------------------------------------------------------


def test_live_current(host: Host, plant: StillPlant) -> None:
    assert host.get_int(104) == 1
    for number, value in ((2000, 1), (2010, 2)):
        host.set_int(number, value)
    host.set(50001, 1.5)
    assert plant.current_A == 0.0
    host.set_int(50000, 1)
    assert plant.current_A == 1.5
    assert host.get(1020) == 1.5
    assert host.get_int(104) == 2
    host.set(50001, -2.0)
    assert plant.current_A == -2.0
    host.set_int(50000, 0)
    assert plant.current_A == 0.0
    assert host.get_int(104) == 1


def test_static_current_and_limits(host: Host, plant: StillPlant) -> None:
    host.set_int(2000, 0)
    host.set(2020, 3.0)
    host.set_int(2010, 1)
    assert plant.current_A == 3.0
    host.set(2030, 2.5)
    assert plant.current_A == 2.5
    host.set(2020, -4.0)
    assert plant.current_A == -2.5
    host.set(2021, 3.0)  # 3 V at 2 ohm
    assert plant.current_A == -1.5
    assert host.get(1021) == -3.0
    assert host.set(2030, 4.5) == b"+07"


def test_hardware_pin(host: Host, tec: MeerstetterTec, plant: StillPlant) -> None:
    host.set_int(2000, 0)
    host.set(2020, 1.0)
    host.set_int(2010, 3)
    assert plant.current_A == 0.0
    tec.hardware_enable = True
    host.set(2020, 1.1)
    assert plant.current_A == pytest.approx(1.1)


def test_polarity_is_a_matter_of_wiring(plant: StillPlant) -> None:
    host = Host(MeerstetterTec(plant, heating_sign=-1))
    host.set_int(2000, 0)
    host.set(2020, 1.0)
    host.set_int(2010, 1)
    assert plant.current_A == -1.0


def start(host: Host, current_A: float = 1.0) -> None:
    host.set_int(2000, 1)
    host.set_int(2010, 2)
    host.set(50001, current_A)
    host.set_int(50000, 1)


def test_watchdog_turns_off_at_its_time_and_stays_off(host: Host, plant: StillPlant) -> None:
    start(host)
    host.set(2060, 2.0)
    fed_s = host.time_s - 0.05 + 28 / 5760
    for _ in range(5):
        host.wait(1.5)
        host.get(1000)
        fed_s = host.time_s - 0.05 + 21 / 5760
    assert plant.current_A == 1.0
    host.wait(5.0)
    assert plant.current_A == 0.0
    assert plant.currents[-1][0] == pytest.approx(fed_s + 2.0, abs=1e-6)
    assert host.get_int(2010) == 0
    assert host.get_int(104) == 1
    assert plant.current_A == 0.0


def test_watchdog_is_not_fed_by_others_or_by_garbage(host: Host, tec: MeerstetterTec, plant: StillPlant) -> None:
    start(host)
    host.set(2060, 1.0)
    for _ in range(30):
        tec.receive(b"#0015AB?VR03E801FFFF\r", host.time_s)
        host.say(b"?VR03E801", address=9)
    assert plant.current_A == 0.0


def test_watchdog_made_shorter_or_off(host: Host, plant: StillPlant) -> None:
    start(host)
    host.set(2060, 500.0)
    host.set(2060, 0.5)
    host.wait(1.0)
    assert plant.current_A == 0.0
    start(host)
    host.set(2060, 0.0)
    host.wait(1000.0)
    assert plant.current_A == 1.0


def test_watchdog_works_again_after_it_has_bitten(host: Host, plant: StillPlant) -> None:
    host.set(2060, 1.0)
    for _ in range(3):
        start(host)
        assert plant.current_A == 1.0
        host.wait(3.0)
        assert plant.current_A == 0.0


@pytest.mark.parametrize(("temperature_degC", "number"), [(96.0, 138), (9.0, 137), (math.nan, 134), (math.inf, 138)])
def test_error_limits_trip_and_latch(host: Host, plant: StillPlant, temperature_degC: float, number: int) -> None:
    host.set(4010, 10.0)
    host.set(4011, 95.0)
    start(host)
    plant.temperature_degC = temperature_degC
    host.wait(0.5)
    assert plant.current_A == 0.0
    assert host.get_int(104) == 3
    assert host.get_int(105) in {number, 134}
    plant.temperature_degC = 25.0
    host.wait(1.0)
    start(host)
    assert plant.current_A == 0.0
    assert host.say(b"RS") == b"ACK"
    assert host.get_int(104) == 5
    host.wait(0.2)
    assert host.say(b"?IF") == b""  # it restarts
    host.wait(1.0)
    assert host.get_int(104) == 1
    assert host.get_int(105) == 0


def test_one_outlier_does_not_trip(host: Host, plant: StillPlant) -> None:
    start(host)
    host.wait(0.06)
    plant.temperature_degC = 500.0
    host.wait(0.1)
    plant.temperature_degC = 25.0
    host.wait(1.0)
    assert plant.current_A == 1.0


def test_change_rate(host: Host, plant: StillPlant) -> None:
    plant.heating_K_per_A_s = 3.0
    host.set(4012, 2.0)
    start(host, 1.0)
    host.wait(1.0)
    assert host.get_int(105) == 139
    assert plant.current_A == 0.0


def test_emergency_stop(host: Host, plant: StillPlant) -> None:
    start(host)
    assert host.say(b"ES") == b"ACK"
    assert plant.current_A == 0.0
    assert host.get_int(105) == 11


# ---- regulation -----------------------------------------------------------------------------------


def regulate(host: Host, target_degC: float) -> None:
    host.set_int(2000, 2)
    host.set(3000, target_degC)
    host.set_int(2010, 1)


@pytest.mark.parametrize("target_degC", [60.0, -15.0])
def test_own_regulation_reaches_its_target_both_ways(host: Host, plant: StillPlant, target_degC: float) -> None:
    plant.heating_K_per_A_s = 0.5
    for number, value in ((3010, 10.0), (3011, 60.0), (2030, 3.0)):
        host.set(number, value)
    regulate(host, target_degC)
    host.wait(5.0)
    assert abs(plant.current_A) == 3.0
    assert host.get_int(1200) == 1
    host.wait(300.0)
    assert plant.temperature_degC == pytest.approx(target_degC, abs=0.05)
    assert host.get_int(1200) == 2
    assert abs(host.get(1032)) < 5.0


def test_integrator_does_not_wind_up(host: Host, plant: StillPlant) -> None:
    plant.heating_K_per_A_s = 0.0  # stuck: the error stays
    host.set(3011, 1.0)
    regulate(host, 60.0)
    host.wait(100.0)
    plant.temperature_degC = 66.0
    host.wait(1.5)
    assert plant.current_A < 0.0


def test_ramp(host: Host, plant: StillPlant) -> None:
    host.set(3003, 0.5)
    regulate(host, 35.0)
    host.wait(10.0)
    assert host.get(1010) == 35.0
    assert host.get(1011) == pytest.approx(25.0 + 0.5 * 10.0, abs=0.2)
    host.wait(30.0)
    assert host.get(1011) == 35.0


def test_wrong_polarity_parameter_runs_away(host: Host, plant: StillPlant) -> None:
    plant.heating_K_per_A_s = 0.5
    host.set_int(3034, 0)
    regulate(host, 26.0)
    host.wait(30.0)
    assert plant.temperature_degC < 20.0


# ---- flash ----------------------------------------------------------------------------------------


def test_automatic_saving_wears_flash_unless_switched_off(host: Host, tec: MeerstetterTec) -> None:
    for _ in range(10):
        host.set(3000, 30.0)
        assert host.get_int(109) == 1
        host.wait(1.0)
    assert host.get_int(109) == 0
    assert tec.flash_writes == 10
    host.set_int(108, 1)
    assert host.get_int(109) == 2
    host.set(3000, 40.0)
    host.wait(1.0)
    assert tec.flash_writes == 10


def test_reset_forgets_what_was_not_saved(host: Host, plant: StillPlant) -> None:
    host.set(3000, 30.0)
    host.wait(1.0)
    host.set_int(108, 1)
    host.set(3000, 40.0)
    start(host)
    host.say(b"RS")
    assert plant.current_A == 0.0
    host.wait(1.0)
    assert host.get(3000) == 30.0
    assert host.get_int(50000) == 0
    assert plant.current_A == 0.0
