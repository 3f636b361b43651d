"""A temperature controller: what the rig asks of every driver, what drivers share, and an "off" that is confirmed.

A Peltier controller takes a current, A; positive heats, however the element is wired. A heater cannot cool: it takes a
drive, the share of full power from 0 to 1, in the place of amperes and under the same names (`limits.current_A = 1.0`,
a record's `current_A`). A heater goes with a plate model of kind "heater", whose rate of heating is per full drive.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import isfinite, isnan, nan
from struct import Struct
from struct import error as StructError
from typing import Any, ClassVar

from rig.core.clock import Clock
from rig.core.errors import Disconnected, InstrumentError, Refused
from rig.core.reading import Identity, Quality, Reading
from rig.ports.open import LineSettings
from rig.ports.transport import Transport

OFF_S = 0.7  # for all of a controller's ways to switch off: a later command would only feed its dead man
STATUS_S = 0.3  # a status that changes one control step (0.1 to 0.3 s) after the command is waited for
STARTED_S = 0.5  # the same when the output is switched on: until a status says "running"
LOOK_S = 0.02  # between two looks at a status
OF_FULL_DRIVE = "of full drive"
LARGEST = 1e6  # A and degC that may be a limit, as in a configuration: every instrument's numbers hold more
COLDEST_DEGC = -273.15
CURRENTS, SETPOINTS = "currents", "setpoints"  # for which an output can be armed


@dataclass(frozen=True, slots=True)
class Status:
    """Status that a controller reports.

    code: its own number of the error, 0 for none. meaning: the error in words; remedy: what to do about it, and what
    clears it; both empty for none.
    """

    text: str
    is_error: bool
    output_is_on: bool
    code: int = 0
    meaning: str = ""
    remedy: str = ""


@dataclass(frozen=True, slots=True)
class OwnLimits:
    """Limits that the instrument itself keeps, as it reads them back now; nan for a limit that it does not have.

    dead_man_s: 0 if it is switched off. ramp_K_per_s: of its own regulation, 0 for as fast as it can.
    """

    current_A: float = nan
    low_degC: float = nan
    high_degC: float = nan
    dead_man_s: float = nan
    ramp_K_per_s: float = nan

    def faults(self, current_A: float, limits_degC: tuple[float, float], dead_man_s: float) -> list[str]:
        """Return a line for each limit that differs from what is configured; a missing limit is no fault."""
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


@dataclass(frozen=True)
class OwnField:
    """A gain of a controller's own PID: the driver's option, its value rounded as the instrument keeps it, the command
    that sets it, its unit."""

    option: str
    value: float
    command: str
    unit: str


class TemperatureController:
    """A driver of a Peltier element or a heater and its thermometer; a driver overrides what its instrument can do.

    commands_current: whether it takes a current (otherwise setpoints only). has_dead_man: whether it turns its output
    off by itself when the host falls silent. has_ramp: whether its own regulation takes a rate. confirms_off_by: the
    evidence behind a True of `off`, in words. dead_man_s: as set by `configure`, 0 before that and if it has none.
    NAME: for people. LARGEST_CURRENT: that may be configured as the limit, A or share of full drive.

    All methods but `off` raise `rig.core.errors.InstrumentError`; a value that may not be commanded is a ValueError,
    and nothing is sent. A user-defined driver need not inherit from this class.
    """

    NAME: str = "this controller"
    LINE: ClassVar[LineSettings]
    LARGEST_CURRENT: ClassVar[float] = LARGEST
    drive_unit: ClassVar[str] = "A"
    cools: ClassVar[bool] = True
    commands_current: ClassVar[bool] = False
    has_dead_man: ClassVar[bool] = False
    has_ramp: ClassVar[bool] = False
    confirms_off_by: ClassVar[str] = "what its driver reads back; it shows no current"
    transport: Transport
    dead_man_s: float = 0.0
    current_limit_A: float = nan
    temperature_limits_degC: tuple[float, float] = (nan, nan)
    _armed: str | None = None
    _regulates: ClassVar[bool] = False  # whether it takes setpoints, by the hooks below
    link: Any  # to the instrument, brought in step by `be_in_step`

    def identify(self) -> Identity:
        """Return the identity; Refused if it is no instrument of this driver's family."""
        raise NotImplementedError

    def configure(
        self, current_limit_A: float, temperature_limits_degC: tuple[float, float], dead_man_s: float
    ) -> None:
        """Switch the output off, set limits and dead man and read them back; Refused if the read-back differs."""
        self._check_limits(current_limit_A, temperature_limits_degC)
        self._armed = None
        self._configure(current_limit_A, temperature_limits_degC, dead_man_s)
        self.current_limit_A, self.temperature_limits_degC = current_limit_A, temperature_limits_degC

    def own_limits(self) -> OwnLimits:
        """Read back the instrument's own limits, dead man and ramp."""
        return OwnLimits()

    def set_ramp_K_per_s(self, ramp_K_per_s: float) -> None:
        """Set the rate of the instrument's own regulation, 0 for as fast as it can; Refused if it has none."""
        raise Refused(None, f"{self.NAME} has no ramp of its own")

    def arm_current(self) -> None:
        """Switch the output on at 0 A, ready for `set_current_A`."""
        self._arm(CURRENTS)

    def set_current_A(self, current_A: float) -> None:
        """Set the current from now on, A; return when it is acknowledged."""
        self._require_taken(CURRENTS)
        self._check_current(current_A)
        self._send_when_armed(CURRENTS, current_A)

    def arm_setpoint(self) -> None:
        """Switch the output on under the instrument's own regulation, held at the temperature of now."""
        self._arm(SETPOINTS)

    def set_setpoint_degC(self, setpoint_degC: float) -> None:
        """Set the target of the instrument's own regulation, degC; return when it is acknowledged."""
        self._require_taken(SETPOINTS)
        self._check_setpoint(setpoint_degC)
        self._send_when_armed(SETPOINTS, setpoint_degC)

    def read_temperature(self) -> Reading:
        """Read the thermometer, degC."""
        raise NotImplementedError

    def read_current(self) -> Reading:
        """Read the current that flows, A; `INVALID`, and nothing is asked, if the instrument does not show it."""
        return Reading(nan, self.transport.clock.now_s(), Quality.INVALID)

    def status(self) -> Status:
        """Return the status that the instrument reports."""
        raise NotImplementedError

    def clear_error(self) -> None:
        """Clear the error that it reports, limits and dead man as configured; Refused if the error stays."""
        raise Refused(None, f"{self.NAME} cannot clear an error from here; clear it at the instrument")

    def off(self) -> bool:
        """Switch the output off; return True only if the instrument reads back off, and no current if it can.

        A plain "off" goes first, at once, then everything stronger. Ends within `OFF_S`, or one time-out more, against
        a device that does not answer. Never raises.
        """
        raise NotImplementedError

    def close(self) -> None:
        """Let go of the port; the output stays as it is. Never raises."""
        self.transport.close()

    # ---- configuring, arming and commanding: what a driver says how to do ---------------------------

    def _configure(self, current_limit_A: float, limits_degC: tuple[float, float], dead_man_s: float) -> None:
        """Switch the output off, set limits and dead man, read back each."""
        raise NotImplementedError

    def _make_ready(self) -> None:
        """Do what has to be done before the output is armed."""

    def _choose(self, commands: str) -> None:
        """Choose what the output shall obey; it is off."""

    def _send(self, commands: str, value: float, arming: bool) -> None:
        """Send a current, A or share of full drive, or a setpoint, degC. arming: before the output is on."""
        raise NotImplementedError

    def _switch_on(self, commands: str) -> None:
        """Switch the output on; Refused if it does not come on."""
        raise NotImplementedError

    def _arm(self, commands: str) -> None:
        self._require_taken(commands)
        self._require_configured()
        self._armed = None
        self._make_ready()
        begin = self._require_within(self.read_temperature()) if commands == SETPOINTS else 0.0
        self._choose(commands)
        self._send(commands, begin, True)
        self._switch_on(commands)
        self._armed = commands

    def _send_when_armed(self, commands: str, value: float) -> None:
        self.link.be_in_step()  # which disarms one that was switched off meanwhile
        if self._armed != commands:
            raise Refused(None, f"the output is not armed for {commands}")
        self._send(commands, value, False)

    def _require_taken(self, commands: str) -> None:
        if commands == CURRENTS and not self.commands_current:
            raise Refused(None, f"{self.NAME} takes no current; use setpoints")
        if commands == SETPOINTS and not self._regulates:
            raise Refused(None, f"{self.NAME} has no regulation of its own; it takes a drive")

    # ---- checks ---------------------------------------------------------------------------------

    def _check_limits(self, current_limit_A: float, limits_degC: tuple[float, float]) -> None:
        """Raise ValueError for limits that cannot be configured."""
        low_degC, high_degC = limits_degC
        if not 0.0 < current_limit_A <= self.LARGEST_CURRENT:
            unit = "A" if self.drive_unit == "A" else "as a share of full drive"
            expected = f"expected more than 0 and at most {self.LARGEST_CURRENT:g} {unit} for {self.NAME}"
            raise ValueError(f"current limit {current_limit_A:g}: {expected}")
        if not COLDEST_DEGC <= low_degC < high_degC <= LARGEST:
            expected = f"two rising numbers are expected, {COLDEST_DEGC:g} to {LARGEST:g}"
            raise ValueError(f"temperature limits {low_degC:g}, {high_degC:g} degC: {expected}")

    def _check_current(self, current_A: float) -> None:
        """Raise ValueError for a current or drive outside the configured limit; Refused before there is one."""
        limit, unit = self.current_limit_A, self.drive_unit
        if abs(current_A) <= limit and (self.cools or current_A >= 0.0):  # never with a limit that is nan
            return
        self._require_configured()
        if current_A < 0.0 and not self.cools:
            raise ValueError(f"{current_A} {unit}: {self.NAME} cannot cool; 0 to {limit:g} is expected")
        raise ValueError(f"{current_A} {unit} is outside the configured {'+-' if self.cools else '0 to '}{limit:g}")

    def _check_setpoint(self, setpoint_degC: float) -> None:
        """Raise ValueError for a setpoint outside the configured limits."""
        low_degC, high_degC = self.temperature_limits_degC
        if not low_degC <= setpoint_degC <= high_degC:
            raise ValueError(f"{setpoint_degC} degC is outside the configured {low_degC} to {high_degC} degC")

    def _require_configured(self) -> None:
        if isnan(self.temperature_limits_degC[0]):
            raise Refused(None, "limits are not configured yet")

    def _is_on(self, commands: str) -> bool:
        """Return True if the output is on for what it was armed for."""
        raise NotImplementedError

    def _check_after_doubt(self) -> None:
        """Disarm if the output is not on any more, after the line was in doubt: the instrument may have restarted.

        An error leaves the line in doubt, so that it is asked again before the next command. Meanwhile it counts as
        not armed: a line that has to be brought in step for this very question asks once.
        """
        commands, self._armed = self._armed, None
        if commands is not None:
            try:
                still_on = self._is_on(commands)
            except InstrumentError:
                self._armed = commands
                raise
            self._armed = commands if still_on else None

    def _require_within(self, now: Reading) -> float:
        """Return the temperature, degC, that own regulation begins with; Refused outside the configured limits."""
        low_degC, high_degC = self.temperature_limits_degC
        if not (now.is_number and low_degC <= now.value <= high_degC):
            raise Refused(None, f"object temperature {now.value} degC is not within {low_degC} to {high_degC} degC")
        return now.value


def drive_unit(controller: object) -> str:
    """Return the unit of `set_current_A`: "A", or "of full drive" for a heater."""
    return str(getattr(controller, "drive_unit", "A"))


def cools(controller: object) -> bool:
    """Return True if the controller takes a drive below 0."""
    return bool(getattr(controller, "cools", True))


def packed(value: float, form: Struct, what: str) -> bytes:
    """Return a number as the bytes of a frame. ValueError for one that does not fit, nan and infinity among them."""
    try:
        if isfinite(value):
            return form.pack(value)
    except (StructError, OverflowError):
        pass
    raise ValueError(f"{what}: {value!r}: expected a number that the instrument's {8 * form.size} bits can hold")


def check_within(**options: tuple[float | None, float, float]) -> None:
    """Raise ValueError for an option outside its range. Of each: value (None: not given), the least, the largest."""
    for name, (value, low, high) in options.items():
        if value is not None and not low <= value <= high:
            raise ValueError(f"{name} {value!r}: {low:g} to {high:g} is expected")


# ---- a status that follows its command --------------------------------------------------------------


def _no_doubt() -> None:
    """Do nothing: every answer of the protocol proves what it belongs to."""


def confirmed_off(
    transport: Transport, ways: Sequence[tuple[Callable[[], bool], float]], doubt: Callable[[], None] = _no_doubt
) -> bool:
    """Switch off by several ways, each stronger than the one before; return True once one is confirmed. Never raises.

    ways: a function that commands off and returns whether it reads back off, and until when that is repeated (s from
    now; once at least). doubt: called after any error; a port whose device was gone is opened anew then.
    """
    clock = transport.clock
    begin_s = clock.now_s()
    for command_and_look, until_s in ways:
        while True:
            trial_s = clock.now_s()
            try:
                if command_and_look():
                    return True
            except Exception as error:  # whatever it was, the next attempt matters more
                with contextlib.suppress(Exception):  # a port that is gone stays gone: the next attempt finds out
                    doubt()
                    if isinstance(error, Disconnected):
                        transport.reopen()
            now_s = clock.now_s()
            if now_s + max(LOOK_S, 0.5 * (now_s - trial_s)) >= begin_s + until_s:  # no room for another like it
                break
            clock.sleep_until_s(clock.now_s() + LOOK_S)
    return False


def wait_until_on(clock: Clock, status: Callable[[], Status]) -> None:
    """Wait until a controller reports that its output is on; Refused if it does not, or is in error."""
    found = wait_for_status(clock, status, lambda now: now.is_error or now.output_is_on)
    if found.is_error or not found.output_is_on:
        remedy = f" ({found.remedy})" if found.remedy else ""
        raise Refused(found.code or None, f"the output does not come on: {found.text}{remedy}")


def wait_for_status(clock: Clock, status: Callable[[], Status], is_it: Callable[[Status], bool]) -> Status:
    """Return the first status that is the one awaited, or the last one that came within `STARTED_S`."""
    until_s = clock.now_s() + STARTED_S
    while not is_it(found := status()) and clock.now_s() < until_s:
        clock.sleep_until_s(clock.now_s() + LOOK_S)
    return found


def wait_until(clock: Clock, true: Callable[[], bool], longest_s: float) -> bool:
    """Return True if `true()` becomes True in time; it is asked at once, and every `LOOK_S`."""
    until_s = clock.now_s() + longest_s
    while not true():
        if clock.now_s() >= until_s:
            return False
        clock.sleep_until_s(clock.now_s() + LOOK_S)
    return True
