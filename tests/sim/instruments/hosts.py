"""Hosts that speak to an emulator in the words of dialogues.txt, each in its protocol's frames."""

from __future__ import annotations

import re
import struct
from binascii import crc_hqx
from typing import Any

from sim.instruments.instrument import emulated
from tests.rig.drivers.far_ends import Host
from tests.rig.drivers.still_plant import StillPlant


class MecomHost(Host):
    """Speaks of parameters by their number; see dialogues.txt."""

    def say(self, message: str, patience_s: float | None = None, end: bytes | None = None) -> str:
        asked, (number, equals, value) = re.fullmatch(r"(\d+)\?", message), message.partition("=")
        if asked:
            payload = f"?VR{int(asked[1]):04X}01"
        elif equals:
            data = struct.pack(">f", float(value)) if "." in value else struct.pack(">i", int(value))
            payload = f"VS{int(number):04X}01{data.hex().upper()}"
        else:
            payload = message
        body = f"#001234{payload}".encode()
        crc = f"{crc_hqx(body, 0):04X}"
        reply = super().say(body.decode() + crc)
        if reply == f"!001234{crc}":
            return "" if equals else "ACK"
        text = reply[7:-4]
        if not asked or len(text) != 8:
            return text.strip()
        (whole,), (real,) = struct.unpack(">i", bytes.fromhex(text)), struct.unpack(">f", bytes.fromhex(text))
        return str(whole) if abs(whole) < 2**20 else f"{real:g}"  # no FLOAT32 of a reading is that small


class TeHost(Host):
    """Speaks of codes; see dialogues.txt."""

    def say(self, message: str, patience_s: float | None = None, end: bytes | None = None) -> str:
        code, value = re.fullmatch(r"(..)[?=](.*)", message).groups()  # type: ignore[union-attr]
        body = f"00{code}{int(value or 0) & 0xFFFFFFFF:08x}"
        data = int(super().say(f"*{body}{sum(body.encode()) & 0xFF:02x}")[1:9], 16)
        return str(data - (data >> 31 << 32))


ENDS = {"hp34401a": b"\n", "keithley2450": b"\n", "lakeshore": b"\n", "srs_ldc500": b"\n", "tclab": b"\n"}
PATIENCE_S = {"srs_ldc500": 0.3, "meerstetter": 0.05, "te_technology": 0.1}


def host_of(driver: str, plant: StillPlant, **options: Any) -> Host:
    kind = {"meerstetter": MecomHost, "te_technology": TeHost}.get(driver, Host)
    return kind(emulated(driver, plant, **options), ENDS.get(driver, b"\r"), PATIENCE_S.get(driver, 5.0))
