"""The fixed-period loop: readings -> policy -> interlock -> controller -> one row a tick.

A tick triggers the meter and collects its reading, reads the temperature, asks the policy, and sends the command; the
row's time is that of the temperature's reading, a few milliseconds before its current acts. Ticks lie on a fixed grid
of the bench's clock; one that is missed is counted and not made up for.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from rig.bench import Bench
from rig.drivers.controller import TemperatureController
from rig.errors import Disconnected, InstrumentError, RigError
from rig.files.run_folder import RunFolder
from rig.interlock import Limits, Watch, check_current, check_readings, check_test_current
from rig.outcome import NotConfirmedOff
from rig.reading import Quality, Reading, missing
from rig.signals import SignalStop

COLUMNS = [
    "time_s",
    "temperature_degC",
    "resistance_ohm",
    "current_A",
    "meter_current_A",
    "resistance_time_s",
    "setpoint_degC",
    "reference_degC",
    "target_ohm",
    "predicted_ohm",
    "phase",
]
FLUSH_S = 1.0


@dataclass(frozen=True)
class Decision:
    """What a policy asks for: a current (A), or a setpoint (degC) for the controller's own PID; and what to record.

    setpoint_degC: the temperature that is wanted, or sent where use_setpoint. reference_degC: the course towards it
    that the plate can follow.

    done: the phase ends here. wait: nothing is sent, whatever is on stays on.
    """

    current_A: float = math.nan
    setpoint_degC: float = math.nan
    use_setpoint: bool = False
    reference_degC: float = math.nan
    target_ohm: float = math.nan
    predicted_ohm: float = math.nan
    done: bool = False
    wait: bool = False


class Policy(Protocol):
    """What decides. time_s runs from the start of its phase; output is -log10(R / 1 ohm), nan where unknown."""

    def decide(self, time_s: float, temperature_degC: float, output: float) -> Decision: ...


@dataclass
class Ticks:
    """How punctual the loop was: ticks done, ticks missed, largest lateness (s)."""

    done: int = 0
    missed: int = 0
    latest_s: float = 0.0


Progress = Callable[[str, float, float], None]  # phase, seconds done, seconds in all


class Loop:
    """One bench, one run folder, phase after phase."""

    def __init__(self, bench: Bench, limits: Limits, folder: RunFolder, progress: Progress | None = None) -> None:
        self.bench = bench
        self.limits = limits
        self.folder = folder
        self.ticks = Ticks()
        self._progress = progress
        self._start_s = bench.clock.now_s()
        self._watch = Watch(self._start_s, self._start_s)
        self._flushed_s = self._start_s
        self._mode = "off"

    def elapsed_s(self) -> float:
        """Time of the run, s."""
        return self.bench.clock.now_s() - self._start_s

    def phase(self, name: str, policy: Policy, duration_s: float, period_s: float) -> None:
        """Run a policy for a time, or until it says that it is done. Raises what ends an experiment."""
        clock = self.bench.clock
        begin = clock.now_s()
        self.folder.event(begin - self._start_s, "phase", name, duration_s=duration_s, period_s=period_s)
        count = max(1, math.ceil(duration_s / period_s - 1e-9))
        k = 0
        while k < count:
            due = begin + k * period_s
            clock.sleep_until_s(due)
            late = clock.now_s() - due
            self.ticks.latest_s = max(self.ticks.latest_s, late)
            if late > period_s:
                missed = int(late / period_s)
                self.ticks.missed += missed
                k += missed
                due = begin + k * period_s
            if self._tick(name, policy, due - begin):
                break
            if self._progress is not None and k % 16 == 0:
                self._progress(name, k * period_s, duration_s)
            k += 1
        clock.sleep_until_s(begin + min(k, count) * period_s)
        if self._progress is not None:
            self._progress(name, duration_s, duration_s)

    def _tick(self, name: str, policy: Policy, time_s: float) -> bool:
        resistance = self._read_resistance()
        temperature = self._read_temperature()
        now = self.bench.clock.now_s()
        self._watch = check_readings(self.limits, self._watch, now, temperature, resistance)
        known = temperature.is_number
        value = resistance.value if resistance is not None else math.nan
        good = resistance is not None and resistance.is_number and value > 0.0
        decision = policy.decide(
            time_s, temperature.value if known else math.nan, -math.log10(value) if good else math.nan
        )
        if not (decision.done or decision.wait):
            self._apply(decision, now)
        meter = self.bench.meter
        self.folder.row(
            (
                (temperature.time_s if known else now) - self._start_s,
                temperature.value if known else math.nan,
                value if good or (resistance is not None and resistance.quality is Quality.OVERRANGE) else math.nan,
                math.nan if self._mode == "setpoint" else decision.current_A if not decision.done else 0.0,
                meter.test_current_A if meter is not None else math.nan,
                resistance.time_s - self._start_s if good and resistance is not None else math.nan,
                decision.setpoint_degC,
                decision.reference_degC,
                decision.target_ohm,
                decision.predicted_ohm,
                name,
            )
        )
        self.ticks.done += 1
        if now - self._flushed_s >= FLUSH_S and not self.bench.virtual:
            self.folder.flush()
            self._flushed_s = now
        return decision.done

    def _apply(self, decision: Decision, now: float) -> None:
        controller = self.bench.controller
        if decision.use_setpoint:
            if self._mode != "setpoint":
                controller.arm_setpoint()
                self._mode = "setpoint"
            controller.set_setpoint_degC(decision.setpoint_degC)
            return
        check_current(self.limits, now, decision.current_A)
        if self._mode != "current":
            controller.arm_current()
            self._mode = "current"
        controller.set_current_A(decision.current_A)

    def _read_temperature(self) -> Reading:
        try:
            return self.bench.controller.read_temperature()
        except Disconnected:
            raise
        except InstrumentError as error:
            return self._no_reading("thermometer", error)

    def _read_resistance(self) -> Reading | None:
        meter = self.bench.meter
        if meter is None:
            return None
        try:
            meter.start_reading()
            reading = meter.finish_reading()
        except Disconnected:
            raise
        except InstrumentError as error:
            return self._no_reading("ohmmeter", error)
        check_test_current(self.limits, self.bench.clock.now_s(), meter.test_current_A)
        return reading

    def _no_reading(self, name: str, error: RigError) -> Reading:
        now = self.bench.clock.now_s()
        self.folder.event(now - self._start_s, "no_reading", f"{name}: {error}")
        return missing(now)


class OutputOff:
    """Context that ends with the controller's output off, whatever happens, and knows whether that is confirmed."""

    def __init__(self, controller: TemperatureController, signals: SignalStop) -> None:
        self._controller = controller
        self._signals = signals
        self.confirmed: bool | None = None

    def __enter__(self) -> OutputOff:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        self._signals.shield()
        self.confirmed = self._controller.off()
        if not self.confirmed:
            reason = f" (after: {error})" if error is not None else ""
            raise NotConfirmedOff(f"the controller did not confirm that its output is off{reason}") from error
        if error is None:
            self._signals.expose()
