"""What every driver of a temperature controller provides, whatever its protocol."""

from __future__ import annotations

from dataclasses import dataclass
from math import isnan, nan
from typing import ClassVar, Protocol

from rig.core.reading import Reading
from rig.drivers.identity import Identity
from rig.ports.open import LineSettings
from rig.ports.transport import Transport


@dataclass(frozen=True, slots=True)
class Status:
    """What a controller says about itself.

    code: its own number of the error, 0 where there is none. meaning: the error in words; remedy: what to do about it,
    and what clears it; both empty where there is none.
    """

    text: str
    is_error: bool
    output_is_on: bool
    code: int = 0
    meaning: str = ""
    remedy: str = ""


@dataclass(frozen=True, slots=True)
class OwnLimits:
    """What the instrument itself holds to, as it reads back now; nan where it has no such thing.

    dead_man_s: 0 where it is switched off. ramp_K_per_s: of its own regulation, 0 for as fast as it can.
    """

    current_A: float = nan
    low_degC: float = nan
    high_degC: float = nan
    dead_man_s: float = nan
    ramp_K_per_s: float = nan

    def faults(self, current_A: float, limits_degC: tuple[float, float], dead_man_s: float) -> list[str]:
        """What differs from what was configured, a line each; what it does not have is no fault."""
        pairs = (
            ("current limit", "A", self.current_A, current_A),
            ("lower temperature limit", "degC", self.low_degC, limits_degC[0]),
            ("upper temperature limit", "degC", self.high_degC, limits_degC[1]),
            ("dead man", "s", self.dead_man_s, dead_man_s),
        )
        return [
            f"{name}: reads back {now:g} {unit}, {wanted:g} {unit} is configured"
            for name, unit, now, wanted in pairs
            if not isnan(now) and abs(now - wanted) > 1e-3 * abs(wanted) + 0.05 * (unit == "degC")
        ]


class TemperatureController(Protocol):
    """Drives a Peltier element and reads its thermometer. Positive current heats, however it is wired.

    commands_current: whether it takes a current (otherwise setpoints only). has_dead_man: whether it
    turns its output off by itself when the host falls silent. has_ramp: whether its own regulation takes a rate.
    confirms_off_by: what a True of `off` rests on, in words. dead_man_s: what `configure` has set, 0 before that and
    where there is none.

    All methods but `off` raise
    `rig.core.errors.InstrumentError`; a value that may not be commanded is a ValueError, and nothing is sent.
    A driver of one's own may lack confirms_off_by, dead_man_s and clear_error.
    """

    LINE: ClassVar[LineSettings]
    commands_current: ClassVar[bool]
    has_dead_man: ClassVar[bool]
    has_ramp: ClassVar[bool]
    confirms_off_by: ClassVar[str]
    transport: Transport
    dead_man_s: float

    def identify(self) -> Identity:
        """Who it is; Refused where it is no instrument of this driver's family."""

    def configure(
        self, current_limit_A: float, temperature_limits_degC: tuple[float, float], dead_man_s: float
    ) -> None:
        """Output off, limits and dead man set and read back; Refused where the read-back differs."""

    def own_limits(self) -> OwnLimits:
        """Its own limits, dead man and ramp, as it reads them back now."""

    def set_ramp_K_per_s(self, ramp_K_per_s: float) -> None:
        """Rate of the instrument's own regulation, 0 for as fast as it can; Refused where it has none."""

    def arm_current(self) -> None:
        """Output on at 0 A, ready for `set_current_A`."""

    def set_current_A(self, current_A: float) -> None:
        """Current from now on, A; acknowledged when it returns."""

    def arm_setpoint(self) -> None:
        """Output on under the instrument's own regulation, held at the temperature of now."""

    def set_setpoint_degC(self, setpoint_degC: float) -> None:
        """Target of the instrument's own regulation, degC; acknowledged when it returns."""

    def read_temperature(self) -> Reading:
        """Thermometer, degC."""

    def read_current(self) -> Reading:
        """Current that flows, A."""

    def status(self) -> Status:
        """What it says about itself."""

    def clear_error(self) -> None:
        """Clear what it reports, limits and dead man as configured; Refused where the error stays or it cannot."""

    def off(self) -> bool:
        """Output off; True only if the instrument reads back that it is, and that no current flows where it can.

        First a plain "off", at once; then everything stronger that it knows. Over within `OFF_S` of
        `rig.drivers.confirmed`, or one time-out more, against a device that does not answer. Never raises.
        """

    def close(self) -> None:
        """Let go of the port; the output stays as it is. Never raises."""
