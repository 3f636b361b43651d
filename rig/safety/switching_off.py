"""Switch the output off, find out whether it is off, and check that against the temperature.

1. off: the driver's commands, each stronger than the one before; done within 0.7 s.
2. silence: if "off" is not confirmed and the controller has a dead man, nothing is sent for a little longer than the
   dead man's time, because every frame that the controller understands feeds it.
3. look: status and current are read, once; nothing is commanded any more.

An output that is not confirmed off then is reported as such, and never as confirmed later: it has to be switched off by
hand. Time is the bench's clock, which the controller's transport uses.

A controller may report "off, 0 A" while a current still flows. After it has confirmed its "off", the thermometer is
therefore read for some seconds and compared with two expected curves that begin where plate and thermometer were: one
for the output off, one for the last current (or setpoint) still on. Once the two have parted, a reading decides between
them. Only the change since the output went off counts. A thermometer that has itself tripped the run
(`UNTRUSTED_THERMOMETER`) is not asked.

The working process, the daemon and the guard use the same check. The guard loads neither numpy nor a plate model: it
gets the curves as numbers while the run goes on. The curves come from one of two sources:

- `curves_of_plate`: a known plate and the current that was on. The curve for "off" lets the current end as late as a
  driver's delay and the uncertainty of the thermometer's lag allow.
- `HeldSetpoint`: a controller that regulates by itself and reports no current. Its setpoint, once the plate is held
  there, is compared with the slowest way in which any plate leaves it. The rest before the output was armed gives that:
  at T the plate leaves by (T - T_rest) loss - drift, whatever the room's temperature is.
"""

from __future__ import annotations

import contextlib
import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final

from rig.core.clock import Clock
from rig.core.errors import Disconnected, InstrumentError
from rig.core.outcome import Stopped
from rig.drivers.controller import TemperatureController

if TYPE_CHECKING:
    from rig.safety.plate_watch import PlateWatch

MARGIN_S: Final = 0.3  # added to the dead man's time: its clock differs, and it acts at its next control step
STEP_S: Final = 0.5  # of the silence, between two signs of life
NO_OUTPUT_A: Final = 0.1  # an offset of the current measurement is below this
NOT_CONFIRMED: Final = "the controller did not confirm that its output is off"
BY_ITS_DEAD_MAN: Final = "it did not obey the command, and its own dead man switched the output off"


@dataclass(frozen=True)
class Verdict:
    """Result of switching off.

    confirmed: True if the controller confirmed it; text: why it did not, or how it came about; said_s: when the last
    command was sent, on the controller's clock.
    """

    confirmed: bool
    text: str = ""
    said_s: float = 0.0


def _nothing() -> None:
    """Default sign of life: none."""


def confirmed_by(controller: Any) -> str:
    """Return the evidence on which the confirmation of a controller, or a driver class, rests, in words."""
    return str(getattr(controller, "confirms_off_by", "what its driver reads back"))


def off_confirmed(controller: Any, when: str = "") -> str:
    """Return the sentence for a confirmed "off" of a controller or driver class. when: after how long, in words."""
    return f"output off, confirmed by the controller{when} ({confirmed_by(controller)})"


def command_off(controller: TemperatureController) -> tuple[bool, str]:
    """Command off; return (True if that is confirmed, why not). Raises nothing but the exception of a signal: a
    user-defined driver may do anything."""
    try:
        return (True, "") if controller.off() else (False, NOT_CONFIRMED)
    except Stopped:  # a signal: the end of the run switches off again
        raise
    except Exception as error:
        return False, f"{NOT_CONFIRMED} ({_of(controller, error)})"


def switch_off(
    controller: TemperatureController, dead_man_s: float | None = None, alive: Callable[[], None] = _nothing
) -> Verdict:
    """Command off; if that is not confirmed, be silent and look. Raises nothing but the exception of a signal.

    dead_man_s: of the controller; by default the configured one. alive: called twice a second during the silence.
    """
    confirmed, why = command_off(controller)
    said_s = controller.transport.clock.now_s()
    if confirmed:
        return Verdict(True, "", said_s)
    if dead_man_s is None:
        dead_man_s = float(getattr(controller, "dead_man_s", 0.0))
    if not (controller.has_dead_man and dead_man_s > 0.0):
        return Verdict(False, why, said_s)
    return look_after_silence(controller, dead_man_s, said_s, alive)


def look_after_silence(
    controller: TemperatureController, dead_man_s: float, said_s: float, alive: Callable[[], None] = _nothing
) -> Verdict:
    """Send nothing until the dead man's time has passed since `said_s`, then look once. Never raises an Exception."""
    clock = controller.transport.clock
    until_s = said_s + dead_man_s + MARGIN_S
    while clock.now_s() < until_s:
        clock.sleep_until_s(min(until_s, clock.now_s() + STEP_S))
        with contextlib.suppress(Exception):  # a guard that has gone changes nothing here
            alive()
    is_off, what = looks_off(controller)
    if is_off:
        return Verdict(True, BY_ITS_DEAD_MAN, said_s)
    return Verdict(
        False, f"{NOT_CONFIRMED}, not even after {dead_man_s:g} s of silence for its dead man ({what})", said_s
    )


def looks_off(controller: TemperatureController) -> tuple[bool, str]:
    """Return (True if status and, if it reports one, current say "off"; the report). Reads once and commands nothing.

    Never raises an Exception.
    """
    try:
        try:
            return _look(controller)
        except Disconnected:  # the port may be back
            controller.transport.reopen()
            return _look(controller)
    except Exception as error:
        return False, _of(controller, error)


def _of(controller: TemperatureController, error: Exception) -> str:
    """Return an error's text without the controller's name, which stands in front of the whole message."""
    return str(error).removeprefix(f"{getattr(controller.transport, 'who', '')}: ")


def _look(controller: TemperatureController) -> tuple[bool, str]:
    status = controller.status()
    if status.output_is_on:
        return False, f"its status is {status.text!r}"
    current = controller.read_current()
    if current.is_number:
        return abs(current.value) <= NO_OUTPUT_A, f"{current.value:.3g} A flow"
    return not controller.commands_current, "it does not report its current"


READ_EVERY_S = 0.25  # a plate moves by less than its noise in between
SILENT_SHARE = 0.75  # of the check's duration may be silence for the controller's dead man
UNTRUSTED_THERMOMETER = (
    "unseen_heat",
    "disturbed",
    "hidden_heat",
    "thermometer_stale",
    "runaway",
    "no_response",
    "other_plate",
)
# Share of the way from the "off" curve to the "on" curve: below the first the reading confirms, within the second it
# contradicts, and so many readings in sequence have to contradict.
OFF_SHARE, ON_SHARE, CONTRADICTIONS = 0.4, (0.7, 1.6), 3
DIGITS = 3  # mK, in the curves that the guard gets

CURVE_STEP_S: Final = 0.25  # within that any plate's curve is straight
# 1 A moves a plate of 30 J/K by 3 K in 8 s; LATEST_S is added where a current may end late
DURATION_S, LATEST_S = 12.0, 8.0
GAP_K, STEPS = 2.5, 3.0  # least distance of the curves at which a reading decides; plus so many thermometer steps
LOSSES_PER_S: Final = (0.003, 0.08)  # 60 J/K with 0.2 W/K, to 10 J/K with 0.8 W/K
SLOW_S = 10.0  # a thermometer's lag; a slower one shows less than this predicts, and does not count as held
HELD_DURATION_S, HELD_S, HELD_K, HELD_GAP_K = 20.0, 5.0, 1.0, 0.5  # the same for a setpoint; held so long, so closely
REST_S, FEWEST = 1.5, 5  # shortest rest before the output is armed, and its fewest readings
COARSE_K = 0.1  # assumed step of a thermometer that was never seen to change


@dataclass(frozen=True)
class ExpectedCurves:
    """Expected thermometer readings (degC), one every `every_s` from the moment at which the output goes off.

    off: with the output off; on: with the last current or setpoint still on; gap_K: distance of the two beyond which a
    reading decides; last: what was on, in words.
    """

    every_s: float
    off: tuple[float, ...]
    on: tuple[float, ...]
    gap_K: float
    last: str

    @property
    def lasts_s(self) -> float:
        """Return the duration of the curves, s."""
        return self.every_s * (len(self.off) - 1)

    @property
    def decides(self) -> bool:
        """True if a reading can still decide between the two curves before they end."""
        return abs(self.on[-1] - self.off[-1]) > self.gap_K

    def at(self, seconds: float) -> tuple[float, float]:
        """Return (off, on) at a time after the output went off."""
        place = min(max(seconds / self.every_s, 0.0), len(self.off) - 1.0)
        k = min(int(place), len(self.off) - 2)
        share = place - k
        off, on = (curve[k] + share * (curve[k + 1] - curve[k]) for curve in (self.off, self.on))
        return off, on

    def table(self) -> dict[str, Any]:
        """Return the curves as JSON takes them, rounded to mK."""
        return {**asdict(self), **{name: [round(v, DIGITS) for v in getattr(self, name)] for name in ("off", "on")}}


def curves_from_table(table: dict[str, Any]) -> ExpectedCurves:
    """Return the curves that `ExpectedCurves.table` wrote."""
    return ExpectedCurves(**{**table, "off": tuple(table["off"]), "on": tuple(table["on"])})


class OffCheck:
    """Compares readings with the curves since the output went off, at `off_s`.

    agrees: None until a reading has decided; text: why the reading contradicts "off".
    """

    def __init__(self, curves: ExpectedCurves, off_s: float) -> None:
        self.agrees: bool | None = None
        self.text = ""
        self._curves, self._off_s = curves, off_s
        self._contradictions, self._offset_K = 0, math.nan

    @property
    def decided(self) -> bool:
        """True once the readings have decided."""
        return self.agrees is not None

    @property
    def ends_s(self) -> float:
        """Time after which no reading can decide any more."""
        return self._off_s + self._curves.lasts_s

    def add(self, now_s: float, temperature_degC: float) -> None:
        """Add a reading (degC); nan means that there was none."""
        if self.decided or math.isnan(temperature_degC) or now_s > self.ends_s:
            return
        after_s = now_s - self._off_s
        off_degC, on_degC = self._curves.at(after_s)
        if math.isnan(self._offset_K):
            self._offset_K = temperature_degC - off_degC
        gap_K, least_K = on_degC - off_degC, self._curves.gap_K
        moved_K = math.copysign(1.0, gap_K) * (on_degC + self._offset_K - temperature_degC)  # away from the "on" curve
        if moved_K > (1.0 - OFF_SHARE) * max(abs(gap_K), least_K):
            self.agrees = True
        if abs(gap_K) < least_K or self.agrees:
            return
        share = 1.0 - moved_K / abs(gap_K)
        self._contradictions = self._contradictions + 1 if ON_SHARE[0] < share < ON_SHARE[1] else 0
        if self._contradictions >= CONTRADICTIONS:
            self.agrees = False
            self.text = (
                f"the controller confirmed that its output is off, but {after_s:.1f} s later the thermometer shows "
                f"{temperature_degC:.2f} degC; expected {off_degC + self._offset_K:.2f} degC without a current, "
                f"{on_degC + self._offset_K:.2f} degC with {self._curves.last}"
            )


def check_temperature(
    curves: ExpectedCurves, controller: TemperatureController, clock: Clock, off_s: float, dead_man_s: float = 0.0
) -> OffCheck:
    """Read the temperature until a reading has decided, or until the curves end.

    dead_man_s: the controller's (s), 0 for none. After the first reading nothing is sent for that time: if the
    controller did not obey, its dead man can act then.
    """
    check = OffCheck(curves, off_s)
    silent_s = dead_man_s + MARGIN_S if 0.0 < dead_man_s < SILENT_SHARE * curves.lasts_s else 0.0
    wait_s = 0.0
    while not check.decided and clock.now_s() < check.ends_s:
        clock.sleep_until_s(clock.now_s() + wait_s)
        wait_s, silent_s = max(silent_s, READ_EVERY_S), 0.0
        try:
            reading = controller.read_temperature()
        except InstrumentError:
            continue
        check.add(clock.now_s(), reading.value if reading.is_number else math.nan)
    return check


def curves_of_plate(watch: PlateWatch, current_A: float, within_s: float | None = None) -> ExpectedCurves | None:
    """Return the curves of a known plate; None if the plate is unknown or no reading could decide in time.

    current_A: on since the watch's last reading. within_s: duration; by default `DURATION_S`, and more where a current
    may end late.
    """
    begin_s, late_s = watch.looked_s, watch.late_s
    if math.isnan(begin_s) or not math.isfinite(current_A) or not current_A:
        return None
    seconds = DURATION_S + min(late_s, LATEST_S) if within_s is None else within_s
    without, still_on = watch.copy(), watch.copy()
    times = [CURVE_STEP_S * k for k in range(math.ceil(seconds / CURVE_STEP_S) + 1)]
    off = tuple(without.run_on(begin_s + t, current_A if t <= late_s else 0.0) for t in times)
    on = tuple(still_on.run_on(begin_s + t, current_A) for t in times)
    gap_K = GAP_K + STEPS * watch.step_K + watch.late_K + watch.off_K
    curves = ExpectedCurves(CURVE_STEP_S, off, on, gap_K, f"the last current ({current_A:+.3g} A) still on")
    return curves if curves.decides else None


class HeldSetpoint:
    """Collects the readings at rest before the output is first armed, and the last `HELD_S` under regulation."""

    def __init__(self) -> None:
        self._rest: list[tuple[float, float]] = []
        self._was_on = False
        self._held: deque[tuple[float, float]] = deque()
        self._setpoint_degC = math.nan

    def add(self, now_s: float, temperature_degC: float, setpoint_degC: float, armed: bool) -> None:
        """Add a reading (nan: none) and the setpoint sent since the one before (nan: none)."""
        self._was_on = self._was_on or armed
        if not armed or math.isnan(setpoint_degC) or setpoint_degC != self._setpoint_degC:
            self._held.clear()
        self._setpoint_degC = setpoint_degC
        if math.isnan(temperature_degC):
            return
        if not self._was_on:
            self._rest.append((now_s, temperature_degC))
        elif armed:
            self._held.append((now_s, temperature_degC))
            while now_s - self._held[0][0] > HELD_S + 1.0:
                self._held.popleft()

    def curves(self, within_s: float | None = None) -> ExpectedCurves | None:
        """Return the curves; None unless the plate is held at its setpoint and would surely leave it in time."""
        values = [degC for _, degC in self._held]
        if not values or self._held[-1][0] - self._held[0][0] < HELD_S:
            return None
        if max(abs(degC - self._setpoint_degC) for degC in values) > HELD_K:
            return None
        held_degC = sum(values) / len(values)
        rate = self._least_rate_K_per_s(held_degC)
        if rate == 0.0:
            return None
        seconds = HELD_DURATION_S if within_s is None else within_s
        times = [CURVE_STEP_S * k for k in range(math.ceil(seconds / CURVE_STEP_S) + 1)]
        off = tuple(held_degC + rate * (t + SLOW_S * math.expm1(-t / SLOW_S)) for t in times)
        gap_K = HELD_GAP_K + max(values) - min(values)
        last = f"its setpoint of {self._setpoint_degC:g} degC still held"
        curves = ExpectedCurves(CURVE_STEP_S, off, (held_degC,) * len(times), gap_K, last)
        return curves if curves.decides else None

    def _least_rate_K_per_s(self, degC: float) -> float:
        """Return the slowest rate at which any plate leaves a temperature; 0 if it may stay."""
        if len(self._rest) < FEWEST or self._rest[-1][0] - self._rest[0][0] < REST_S:
            return 0.0
        times, values = zip(*self._rest, strict=True)
        time_s, value_degC = sum(times) / len(times), sum(values) / len(values)
        weights = [t - time_s for t in times]
        drift = sum(w * v for w, v in zip(weights, values, strict=True)) / sum(w * w for w in weights)
        scatter_K = max(abs(v - value_degC - drift * w) for w, v in zip(weights, values, strict=True))
        step_K = _step_K(values, [degC for _, degC in self._held])
        uncertainty = 2.0 * max(scatter_K, step_K) / (times[-1] - times[0])
        rates = [drift - loss * (degC - value_degC) for loss in LOSSES_PER_S]
        if rates[0] * rates[1] <= 0.0:
            return 0.0
        least = min(rates, key=abs)
        return math.copysign(max(abs(least) - uncertainty, 0.0), least)


def _step_K(*runs: Sequence[float]) -> float:
    """Return the smallest step between two readings in sequence."""
    steps = [abs(b - a) for values in runs for a, b in pairwise(values) if a != b]
    return min(steps, default=COARSE_K)
