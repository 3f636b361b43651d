"""Answers of an instrument: a reading (a value, its time, how far to believe it), who it is; and a row's columns."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from math import nan
from typing import Final

from rig.core.errors import Corrupt, Overrange, TimedOut

# columns by the names that files, the history and the page have for them; the unit is a name's ending
MEASURED: Final = ("temperature_degC", "resistance_ohm", "current_A", "meter_current_A")
ACTED: Final = (  # when it was read, when the command acted, and when the test current came on
    "resistance_time_s",
    "current_time_s",
    "meter_current_time_s",
)
WANTED: Final = ("setpoint_degC", "reference_degC", "target_ohm", "predicted_ohm")
BESIDE: Final = ("setpoint_degC", "target_ohm", "ambient_degC", "sink_degC", "input_2")  # of a record that is not ours
OF_A_RUN: Final = ("time_s", *MEASURED, *ACTED, *WANTED, "acts_after_s", "tick", "phase")
OF_A_RECORD: Final = ("time_s", *MEASURED, *ACTED, *BESIDE)
GUESSED: Final = ("time_s", *MEASURED, *BESIDE)  # of a record, where their names say it
KEPT: Final = (*MEASURED, *WANTED)  # in the history, beside time and words


class Quality(StrEnum):
    """How far to believe a reading. Overrange is an outcome of measuring, not an error."""

    OK = "ok"
    SETTLING = "settling"  # a true value, the first after a change of range or test current
    OVERRANGE = "overrange"  # beyond the instrument's range: the value is inf, the sign is known
    INVALID = "invalid"  # the instrument answered what cannot be: nan, a negative resistance
    STALE = "stale"  # older than it may be
    MISSING = "missing"  # no answer in time


@dataclass(frozen=True, slots=True)
class Reading:
    """A value in the unit of the method that returned it.

    time_s: when it was sampled, on the bench's clock, as well as the host can know. why: it is no number, if known.
    """

    value: float
    time_s: float
    quality: Quality = Quality.OK
    why: str = ""

    @property
    def is_number(self) -> bool:
        """Whether the value can be computed with."""
        return self.quality is Quality.OK or self.quality is Quality.SETTLING

    def number(self) -> float:
        """Return the value if it can be computed with. Raises Overrange; TimedOut if it is missing or stale;
        Corrupt."""
        if self.is_number:
            return self.value
        if self.quality is Quality.OVERRANGE:
            raise Overrange(f"beyond the instrument's range ({self.value:+g})")
        if self.quality in (Quality.MISSING, Quality.STALE):
            raise TimedOut(f"the reading is {self.quality}")
        raise Corrupt(f"{self.value!r} cannot be a reading")


def missing(time_s: float, why: str = "") -> Reading:
    """There was no answer."""
    return Reading(nan, time_s, Quality.MISSING, why)


@dataclass(frozen=True, slots=True)
class Identity:
    """Identity as the instrument reports it; empty if it reports none."""

    maker: str
    model: str
    serial_number: str
    firmware: str

    def __str__(self) -> str:
        return f"{self.maker} {self.model}, serial number {self.serial_number}, firmware {self.firmware}"

    @classmethod
    def of_idn(cls, answer: str) -> Identity:
        """Return the four fields of an answer to `*IDN?`."""
        return cls(*(part.strip() for part in (answer + ",,,").split(",")[:4]))
