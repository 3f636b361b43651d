"""A heater output, which cannot cool: what the drivers of such controllers have in common.

Where `TemperatureController` says current, a heater has its drive: the share of full power, 0 to 1, in the place of
amperes and under the same names (`limits.current_A = 1.0`, a record's `current_A`). It goes with a plate model of kind
"heater", whose rate of heating is per full drive, as in a record that was read with `current_A=duty@duty`.

A driver that is no heater says nothing of this: its unit is A, and it can cool.
"""

from __future__ import annotations

from math import isfinite, nan
from typing import ClassVar

from rig.core.errors import Refused
from rig.drivers.controller import OwnLimits
from rig.ports.transport import Transport

OF_FULL_DRIVE = "of full drive"


def drive_unit(controller: object) -> str:
    """The unit of what `set_current_A` takes: "A", or "of full drive" for a heater."""
    return str(getattr(controller, "drive_unit", "A"))


def cools(controller: object) -> bool:
    """Whether the controller takes a drive below 0."""
    return bool(getattr(controller, "cools", True))


class HeaterDrive:
    """What they share; a driver with a dead man, a ramp or limits of its own says so. NAME: for people."""

    NAME: str = "this heater"
    drive_unit: ClassVar[str] = OF_FULL_DRIVE
    cools: ClassVar[bool] = False
    commands_current: ClassVar[bool] = True
    has_dead_man: ClassVar[bool] = False
    has_ramp: ClassVar[bool] = False
    transport: Transport
    drive_limit: float = nan
    temperature_limits_degC: tuple[float, float] = (nan, nan)

    def own_limits(self) -> OwnLimits:
        """None that are known."""
        return OwnLimits()

    def set_ramp_K_per_s(self, ramp_K_per_s: float) -> None:
        """Refused."""
        raise Refused(None, f"{self.NAME} has no ramp of its own")

    def arm_setpoint(self) -> None:
        """Refused."""
        raise Refused(None, f"{self.NAME} has no regulation of its own; it takes a drive")

    def set_setpoint_degC(self, setpoint_degC: float) -> None:
        """Refused."""
        raise Refused(None, f"{self.NAME} has no regulation of its own; it takes a drive")

    def close(self) -> None:
        """Let go of the port; the output stays as it is."""
        self.transport.close()

    def _check_limits(self, drive_limit: float, limits_degC: tuple[float, float]) -> None:
        """ValueError where the configured limits are none for a heater."""
        low_degC, high_degC = limits_degC
        if not 0.0 < drive_limit <= 1.0:
            raise ValueError(
                f"current limit {drive_limit}: {self.NAME} takes a share of full drive; "
                "more than 0 and at most 1 is expected"
            )
        if not (isfinite(low_degC) and isfinite(high_degC) and low_degC < high_degC):
            raise ValueError(f"temperature limits {low_degC}, {high_degC} degC: two rising numbers are expected")

    def _check_drive(self, drive: float) -> None:
        """ValueError where a drive may not be commanded. Refused before there are limits."""
        if not isfinite(self.drive_limit):
            raise Refused(None, "limits are not configured yet")
        if drive < 0.0:
            raise ValueError(f"{drive} of full drive: {self.NAME} cannot cool; 0 to {self.drive_limit:g} is expected")
        if not drive <= self.drive_limit:
            raise ValueError(f"{drive} of full drive is outside the configured 0 to {self.drive_limit:g}")
