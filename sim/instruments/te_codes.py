"""Command codes of the TE Technology controllers: what is read and written by which code, and in which fixed point.

Sources: TC-36-25 RS232 manual, Appendix C p. 42 to 50; TC-48-20 manual, Appendix B p. 48 to 54. Not verified: the code
that reads the TC-48-20's output enable back (here 64). Limits that the manuals leave open are wide; defaults are this
emulator's, not the factory's.
"""

from __future__ import annotations

from dataclasses import dataclass

from sim.instruments.te_frames import TC_36_25, TC_48_20, Framing

WIDE = 2**31 - 1  # the largest that eight hexadecimal digits hold, with a sign


@dataclass(frozen=True, slots=True)
class Setting:
    """A value by name: codes to write and read it (empty: none), its default and limits as they go over the wire."""

    name: str
    write: bytes
    read: bytes
    default: int
    minimum: int = -WIDE
    maximum: int = WIDE


@dataclass(frozen=True, slots=True)
class Model:
    """A controller: frames, fixed point of temperatures and gains, settings, codes that read what is measured."""

    framing: Framing
    baudrate: int
    per_degC: int
    per_gain: int
    settings: tuple[Setting, ...]
    measured: dict[bytes, str]


MODELS = {
    "tc-36-25": Model(
        TC_36_25,
        9600,
        100,
        100,
        (
            Setting("setpoint", b"1c", b"50", 2500),
            Setting("bandwidth", b"1d", b"51", 1000, 1),
            Setting("integral", b"1e", b"52", 100, 0),
            Setting("derivative", b"1f", b"53", 0, 0),
            Setting("alarm deadband", b"22", b"56", 100, 0),
            Setting("high alarm", b"23", b"57", 12500),
            Setting("low alarm", b"24", b"58", -2000),
            Setting("control deadband", b"25", b"59", 100, 0),
            Setting("offset 1", b"26", b"5a", 0),
            Setting("offset 2", b"27", b"5b", 0),
            Setting("alarm type", b"28", b"41", 0, 0, 3),
            Setting("setpoint source", b"29", b"42", 0, 0, 4),
            Setting("sensor type", b"2a", b"43", 1, 0, 5),
            Setting("control type", b"2b", b"44", 1, 0, 2),
            Setting("polarity", b"2c", b"45", 0, 0, 1),
            Setting("power on", b"2d", b"46", 0, 0, 1),
            Setting("shutdown if alarm", b"2e", b"47", 0, 0, 1),
            Setting("alarm latch", b"2f", b"48", 0, 0, 1),
            Setting("alarm sensor", b"31", b"4a", 0, 0, 1),
            Setting("units", b"32", b"4b", 1, 0, 1),
            Setting("reset latches", b"33", b"", 0, 0, 1),
            Setting("EEPROM", b"34", b"4c", 1, 0, 1),
            Setting("retries on", b"35", b"4d", 0, 0, 1),
            Setting("heat multiplier", b"0c", b"5c", 100, 0, 200),
            Setting("cool multiplier", b"0d", b"5d", 100, 0, 200),
            Setting("over-current count", b"0e", b"5e", 10, 0, 255),
            Setting("retries", b"0f", b"5f", 0, 0, 30000),
        ),
        {
            b"01": "input 1",
            b"06": "input 2",
            b"02": "power",
            b"04": "power",
            b"03": "effective setpoint",
            b"05": "alarms",
            b"07": "current count",
        },
    ),
    "tc-48-20": Model(
        TC_48_20,
        115200,
        10,
        100,
        (
            Setting("setpoint", b"1c", b"50", 250, -32768, 32767),
            Setting("bandwidth", b"1d", b"51", 100, 1, 32767),
            Setting("integral", b"1e", b"52", 100, 0, 32767),
            Setting("derivative", b"1f", b"53", 0, 0, 32767),
            Setting("power on", b"30", b"64", 0, 0, 1),
        ),
        {b"00": "model", b"01": "input 1", b"02": "power", b"03": "alarms", b"04": "input 2"},
    ),
}
