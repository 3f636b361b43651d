"""The fixed-period loop: readings -> policy -> interlock -> controller -> one row a tick.

A tick triggers the meter and collects its reading, reads the temperature, asks the policy, and sends the command; the
row's time is that of the temperature's reading, a few milliseconds before its current acts. Ticks lie on a fixed grid
of the bench's clock; one that is missed is counted and not made up for.

A reading that is frozen, jumps or is missing is none (`rig.safety.credible`): the policy is given nan, and goes on
without it until the interlock finds that too long. A trip latches: a loop that has tripped runs no further phase.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from compensator.functions import KELVIN
from compensator.plate import PlateModel
from rig.bench import Bench
from rig.drivers.meter import LOG_RESISTANCE, film_output
from rig.errors import Disconnected, InstrumentError, RigError
from rig.files.run_folder import RunFolder
from rig.outcome import Tripped
from rig.reading import Quality, Reading, missing
from rig.safety.credible import OhmmeterTrust, ThermometerTrust
from rig.safety.interlock import Limits, Watch, check_current, check_readings, check_test_current
from rig.safety.runaway import RunawayWatch

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


def columns_of(bench: Bench) -> list[str]:
    """A row's columns: those of every run, and the quantity that the meter's voltage stands for, where it does."""
    output = bench.meter.output if bench.meter is not None else LOG_RESISTANCE
    return COLUMNS if output == LOG_RESISTANCE else [*COLUMNS, output]


ANY_PLATE_K_PER_S = 1.5  # at the current limit, as long as no model is known: a plate may be ten times slower


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


@dataclass(frozen=True)
class Tick:
    """One tick as it was: time of the run (s), readings with their quality, and what was sent (nan: nothing of it)."""

    time_s: float
    phase: str
    temperature: Reading
    resistance: Reading | None
    current_A: float
    decision: Decision


class Loop:
    """One bench, one run folder, phase after phase.

    on_tick: called with every tick when its row is written. tripped: what this loop has tripped on, and why it runs no
    further phase. rejected: readings of each instrument that were none.
    """

    def __init__(
        self,
        bench: Bench,
        limits: Limits,
        folder: RunFolder,
        progress: Progress | None = None,
        on_tick: Callable[[Tick], None] | None = None,
    ) -> None:
        self.bench = bench
        self.limits = limits
        self.folder = folder
        self.ticks = Ticks()
        self.tripped: Tripped | None = None
        self.rejected = {"thermometer": 0, "ohmmeter": 0}
        self._progress = progress
        self._on_tick = on_tick
        self._start_s = bench.clock.now_s()
        self._watch = Watch(self._start_s, self._start_s)
        self._runaway = RunawayWatch(limits.current_A, limits.runaway_s)
        self._thermometer = ThermometerTrust(limits.rate_K_per_s, ANY_PLATE_K_PER_S / limits.current_A)
        self._output = bench.meter.output if bench.meter is not None else LOG_RESISTANCE
        self._ohmmeter = OhmmeterTrust(self._output == LOG_RESISTANCE)
        self._mode = "off"
        self._sent_A = 0.0
        self._setpoint_degC = math.nan

    def elapsed_s(self) -> float:
        """Time of the run, s."""
        return self.bench.clock.now_s() - self._start_s

    def know_plate(self, plate: PlateModel) -> None:
        """From now on readings are judged by what this plate can do."""
        limits = self.limits
        self._runaway.plate = plate
        ends = (limits.low_degC, limits.high_degC)
        rates = [rate for t in ends for rate in plate.rate_range_K_per_s(t, limits.current_A)]
        self._thermometer.rate_K_per_s = min(limits.rate_K_per_s, 1.0 + 2.0 * max(abs(rate) for rate in rates))
        self._thermometer.gain_K_per_A_s = (
            plate.seebeck_over_capacity_per_A_s * (limits.low_degC + KELVIN) + plate.drive_over_capacity_K_per_s
        )

    def phase(self, name: str, policy: Policy, duration_s: float, period_s: float) -> None:
        """Run a policy for a time, or until it says that it is done. Raises what ends an experiment."""
        if self.tripped is not None:
            raise self.tripped
        try:
            self._phase(name, policy, duration_s, period_s)
        except Tripped as trip:
            self.tripped = trip
            raise

    def _phase(self, name: str, policy: Policy, duration_s: float, period_s: float) -> None:
        clock = self.bench.clock
        begin = clock.now_s()
        self._begin_anew(begin)
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
            if self._tick(name, policy, k * period_s):
                break
            if self._progress is not None and k % 16 == 0:
                self._progress(name, k * period_s, duration_s)
            k += 1
        clock.sleep_until_s(begin + min(k, count) * period_s)
        if self._progress is not None:
            self._progress(name, duration_s, duration_s)

    def _begin_anew(self, now: float) -> None:
        """Between two phases something may have been computed for a while. Where no current flows this does no harm.

        The output is armed again then, because the controller's own dead man may have switched it off.
        """
        idle = self._mode == "off" or (self._mode == "current" and self._sent_A == 0.0)
        if idle and now - self._watch.temperature_s > 0.5 * self.limits.stale_s:
            self._watch = Watch(now, now)
            self._runaway.forget()
            self._mode = "off"

    def _tick(self, name: str, policy: Policy, time_s: float) -> bool:
        resistance = self._read_resistance()
        temperature = self._read_temperature()
        now = self.bench.clock.now_s()
        temperature, resistance = self._judge(now, temperature, resistance)
        known = temperature.is_number
        degC = temperature.value if known else math.nan
        self._runaway.look(now, degC, self._sent_A, self._setpoint_degC)
        output = film_output(self._output, resistance)
        good = resistance is not None and not math.isnan(output)
        value = resistance.value if resistance is not None else math.nan
        if not (good or (resistance is not None and resistance.quality is Quality.OVERRANGE)):
            value = math.nan
        decision = policy.decide(time_s, degC, output)
        if not (decision.done or decision.wait):
            self._apply(decision, now, degC)
        meter = self.bench.meter
        self.folder.row(
            (
                (temperature.time_s if known else now) - self._start_s,
                degC,
                value if self._output == LOG_RESISTANCE else math.nan,
                self._sent_A,
                meter.test_current_A if meter is not None else math.nan,
                resistance.time_s - self._start_s if good and resistance is not None else math.nan,
                decision.setpoint_degC,
                decision.reference_degC,
                decision.target_ohm,
                decision.predicted_ohm if self._output == LOG_RESISTANCE else math.nan,
                name,
                *([] if self._output == LOG_RESISTANCE else [value]),
            )
        )
        if not self.bench.virtual:
            self.folder.flush()
        self.ticks.done += 1
        self.bench.guard.alive()
        if self._on_tick is not None:
            self._on_tick(Tick(now - self._start_s, name, temperature, resistance, self._sent_A, decision))
        return decision.done

    def _judge(self, now: float, temperature: Reading, resistance: Reading | None) -> tuple[Reading, Reading | None]:
        """The readings with the quality that they deserve. Raises Tripped."""
        degC = temperature.value if temperature.is_number else math.nan
        log_ohm = film_output(self._output, resistance) if self._output == LOG_RESISTANCE else math.nan
        temperature, why = self._thermometer.judge(temperature, self._sent_A, log_ohm)
        why_not = ""
        if resistance is not None:
            resistance, why_not = self._ohmmeter.judge(resistance, degC)
        for name, reason, reading in (("thermometer", why, temperature), ("ohmmeter", why_not, resistance)):
            if reason and reading is not None and reading.quality is not Quality.OVERRANGE:
                self.rejected[name] += 1
                if reading.quality is not Quality.MISSING:  # that was told when it was asked for
                    self.folder.event(now - self._start_s, "no_reading", f"{name}: {reason}")
        self._watch = check_readings(self.limits, self._watch, now, temperature, resistance, (why, why_not))
        return temperature, resistance

    def _apply(self, decision: Decision, now: float, degC: float) -> None:
        controller = self.bench.controller
        if decision.use_setpoint:
            if self._mode != "setpoint":
                self.bench.guard.busy()
                controller.arm_setpoint()
                self._mode, self._sent_A = "setpoint", math.nan
            self._setpoint_degC = decision.setpoint_degC
            controller.set_setpoint_degC(decision.setpoint_degC)
            return
        check_current(self.limits, now, decision.current_A)
        self._runaway.check_cooling(now, degC, decision.current_A)
        if self._mode != "current":
            self.bench.guard.busy()
            controller.arm_current()
            self._mode, self._setpoint_degC = "current", math.nan
            self._runaway.forget()
        controller.set_current_A(decision.current_A)
        self._sent_A = decision.current_A

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
