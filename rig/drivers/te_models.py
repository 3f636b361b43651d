"""What TE Technology's models differ in (codes, units, frames), and their alarms in words.

Sources: as in `rig.drivers.te_technology`.
"""

from __future__ import annotations

from dataclasses import dataclass

from rig.drivers.controller import Status
from rig.drivers.te_link import Dialect
from rig.ports.open import LineSettings

MODEL_CODE = 9613  # what a TC-48-20 answers to code 00
ALARMS = ("high", "low", "computer", "over-current", "input 1 open", "input 2 open", "driver supply low")
REMEDIES = {
    "high": "wait until the plate is below the high alarm",
    "low": "wait until the plate is above the low alarm",
    "over-current": "check the element and its cables for a short",
    "input 1 open": "check the thermometer and its cable",
    "driver supply low": "check the supply's voltage",
}
MAKES_TROUBLE = 0b1011111  # an open second input does not


@dataclass(frozen=True, slots=True)
class Model:
    """A controller: its name, line, frames, units of a degree, codes (empty: not known)."""

    name: str
    line: LineSettings
    dialect: Dialect
    per_degC: int
    power_write: bytes
    power_read: bytes
    alarms: bytes
    units: bytes = b""
    settings: tuple[tuple[bytes, bytes, int], ...] = ()  # write, read, value, at configuration
    limits: tuple[tuple[bytes, bytes], ...] = ()  # write and read of low and high alarm
    alarm_type: tuple[bytes, bytes] = (b"", b"")
    reset_latches: bytes = b""
    drain_s: float = 0.3


MODELS = {
    "tc-36-25": Model(
        "TC-36-25 RS232",
        LineSettings(baudrate=9600),
        Dialect(8, True, fence_write=b"25", quiet=(b"34", 0)),
        100,
        b"2d",
        b"46",
        b"05",
        units=b"4b",
        settings=((b"34", b"4c", 0), (b"29", b"42", 0), (b"2b", b"44", 1), (b"2e", b"47", 1)),
        limits=((b"24", b"58"), (b"23", b"57")),
        alarm_type=(b"28", b"41"),
        reset_latches=b"33",
    ),
    "tc-48-20": Model(
        "TC-48-20",
        LineSettings(baudrate=115200),
        Dialect(4, False, fence_read=b"00", fence_value=MODEL_CODE),
        10,
        b"30",
        b"64",
        b"03",
        drain_s=2.5,
    ),
}


def model_of(name: object) -> Model:
    """The model of a name. Raises ValueError where there is none."""
    if not isinstance(name, str) or name not in MODELS:
        raise ValueError(f"model {name!r}: one of {', '.join(sorted(MODELS))} is expected")
    return MODELS[name]


def status_of(model: Model, alarms: int, on: bool) -> Status:
    """A status in words, from the bits of the alarms and from whether power is on."""
    names = [name for bit, name in enumerate(ALARMS) if alarms >> bit & 1]
    text = ("on" if on else "off") + "".join(f", alarm: {name}" for name in names)
    code = alarms & MAKES_TROUBLE
    if not code:
        return Status(text, False, on)
    troubles = [name for name in names if code & 1 << ALARMS.index(name)]
    what_to_do = [REMEDIES[name] for name in troubles if name in REMEDIES]
    clears = "`peltier check CONFIG --clear` resets what latched"
    if not model.reset_latches:
        clears = "what latched is cleared by switching its supply off and on"
    meaning = f"alarm: {', '.join(troubles)}"
    return Status(text, True, on, code, meaning, "; ".join([*what_to_do, clears]))
