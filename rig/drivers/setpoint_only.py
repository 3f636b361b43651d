"""A controller that regulates by itself and cannot be told a current: what such drivers have in common."""

from __future__ import annotations

from math import nan
from typing import ClassVar

from rig.core.errors import Refused
from rig.core.reading import Quality, Reading
from rig.drivers.controller import OwnLimits
from rig.ports.transport import Transport


class SetpointOnly:
    """No current, no dead man, no ramp; a driver with more than that says so. NAME: for people."""

    NAME: str = "this controller"
    commands_current: ClassVar[bool] = False
    has_dead_man: ClassVar[bool] = False
    has_ramp: ClassVar[bool] = False
    confirms_off_by: ClassVar[str] = "what its driver reads back; it shows no current"
    dead_man_s: float = 0.0
    transport: Transport

    def own_limits(self) -> OwnLimits:
        """None that are known."""
        return OwnLimits()

    def set_ramp_K_per_s(self, ramp_K_per_s: float) -> None:
        """Refused."""
        raise Refused(None, f"{self.NAME} has no ramp of its own")

    def arm_current(self) -> None:
        """Refused."""
        raise Refused(None, f"{self.NAME} takes no current; use setpoints")

    def set_current_A(self, current_A: float) -> None:
        """Refused."""
        raise Refused(None, f"{self.NAME} takes no current; use setpoints")

    def clear_error(self) -> None:
        """Refused."""
        raise Refused(None, f"{self.NAME} cannot clear an error from here; clear it at the instrument")

    def read_current(self) -> Reading:
        """Not known; nothing is asked."""
        return Reading(nan, self.transport.clock.now_s(), Quality.INVALID)

    def close(self) -> None:
        """Let go of the port; the output stays as it is."""
        self.transport.close()
