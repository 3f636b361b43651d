"""A plate, its thermometer and its film, written apart from `sim`, with faults that begin in the middle of a run.

    C dT/dt = S I T + R_e I^2 / 2 - G (T - T_s)
    C_s dT_s/dt = -S I T_s + R_e I^2 / 2 + G (T - T_s) - G_s (T_s - T_a)

integrated by Euler steps of `STEP_S`. The film is a sum of two shifted tanh branches with a simple first-order memory:
enough for an experiment to run. It implements the plant's side of `sim.instruments.instrument.Plant`.
"""

from __future__ import annotations

import math
import random
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from benchmarks._own_plant import KELVIN, STEP_S, OwnPlant

NOISE_K, STUCK_NOISE_K, NOISE_DEC = 0.01, 0.005, 0.002
STEP_K, FAST_DRIFT_K_PER_S, SLOW_DRIFT_K_PER_S = 10.0, -1.5, -0.5
IN_AIR_S, FALLS_WITHIN_S, LEFT_CONTACT = 5.0, 20.0, 0.3
DEAD_FAN = 0.1  # of the sink's conductance

FAULTS = (
    "falls at once",
    "falls within 20 s",
    "30 % contact",
    "sticks exactly",
    "sticks with noise",
    "steps up by 10 K",
    "steps down by 10 K",
    "drifts by -1.5 K/s",
    "drifts by -0.5 K/s",
    "polarity turns",
    "fan dies",
)


@dataclass(frozen=True)
class Rig:
    """Watt, kelvin, ampere, second: S (V/K), R_e (ohm), G, G_s (W/K), C, C_s (J/K), T_a (degC), the current limit."""

    seebeck: float
    resistance: float
    conductance: float
    capacity: float
    sink_capacity: float
    sink_conductance: float
    ambient_degC: float
    limit_A: float


def drawn(seed: int, capacity: float, limit_A: float) -> Rig:
    """A rig of usual size: physics' ranges, a fan that keeps the sink within some 10 K."""
    chance = random.Random(seed)
    return Rig(
        seebeck=chance.uniform(0.03, 0.06),
        resistance=chance.uniform(1.0, 3.0),
        conductance=chance.uniform(0.3, 0.8),
        capacity=capacity,
        sink_capacity=chance.uniform(150.0, 600.0),
        sink_conductance=chance.uniform(4.0, 12.0),
        ambient_degC=chance.uniform(18.0, 28.0),
        limit_A=limit_A,
    )


class WatchedPlant(OwnPlant):
    """The rig's state. fault: one of FAULTS, from `breaks_at` (called with the plant) on."""

    def __init__(
        self, rig: Rig, seed: int, start_s: float, fault: str | None, breaks: Callable[[WatchedPlant], bool]
    ) -> None:
        self.rig, self.fault, self._breaks = rig, fault, breaks
        super().__init__(start_s)
        self.plate_degC = self.sink_degC = rig.ambient_degC
        self.broken_s: float | None = None
        self.broken_degC = math.nan
        self.hottest_degC = -math.inf  # since it broke
        self.departed_K = 0.0  # largest distance of the plate from what is shown, since it broke
        self.history: deque[tuple[float, float]] = deque()
        self._chance = random.Random(seed + 1)
        self._stuck_degC = math.nan
        self._memory = -1.0

    def set_current_A(self, current_A: float) -> None:
        self.current_A = min(max(current_A, -self.rig.limit_A), self.rig.limit_A)

    def sink_temperature_degC(self) -> float:
        return self.sink_degC

    def read_temperature_degC(self) -> float:
        shown, noise = self.plate_degC, NOISE_K
        since_s = self.time_s - self.broken_s if self.broken_s is not None else -1.0
        if since_s >= 0.0 and self.fault is not None:
            if math.isnan(self._stuck_degC):
                self._stuck_degC = shown + self._chance.gauss(0.0, noise)
            shown, noise = self._broken(shown, since_s, noise)
            self.departed_K = max(self.departed_K, abs(shown - self.plate_degC))
        self.history.append((self.time_s, self.plate_degC))
        return shown + (self._chance.gauss(0.0, noise) if noise else 0.0)

    def read_resistance_ohm(self, test_current_A: float) -> float:
        rising = math.tanh(0.2 * self.plate_degC - 12.6)
        falling = math.tanh(0.2 * self.plate_degC - 11.8)
        self._memory = min(max(self._memory, rising - 0.1), falling + 0.1)
        y = -4.0 + 0.7 * self._memory + 0.3 * math.tanh(0.03 * self.plate_degC - 1.6)
        return 10.0 ** (-y + self._chance.gauss(0.0, NOISE_DEC))

    def _broken(self, shown: float, since_s: float, noise: float) -> tuple[float, float]:
        ambient = self.rig.ambient_degC
        contact = {
            "falls within 20 s": max(1.0 - since_s / FALLS_WITHIN_S, 0.0),
            "30 % contact": LEFT_CONTACT,
        }
        moved = {
            "steps up by 10 K": STEP_K,
            "steps down by 10 K": -STEP_K,
            "drifts by -1.5 K/s": FAST_DRIFT_K_PER_S * since_s,
            "drifts by -0.5 K/s": SLOW_DRIFT_K_PER_S * since_s,
        }
        if self.fault in contact:
            return ambient + contact[self.fault] * (shown - ambient), noise
        if self.fault in moved:
            return shown + moved[self.fault], noise
        if self.fault == "falls at once":
            return ambient + (self._stuck_degC - ambient) * math.exp(-since_s / IN_AIR_S), noise
        if self.fault == "sticks exactly":
            return self._stuck_degC, 0.0
        if self.fault == "sticks with noise":
            return self._stuck_degC, STUCK_NOISE_K
        return shown, noise

    def _run(self, until_s: float) -> None:
        r = self.rig
        while self.time_s < until_s - 1e-9:
            dt = min(STEP_S, until_s - self.time_s)
            if self.broken_s is None and self.fault is not None and self._breaks(self):
                self.broken_s, self.broken_degC = self.time_s, self.plate_degC
            current = self.current_A
            outlet = r.sink_conductance
            if self.broken_s is not None:
                current = -current if self.fault == "polarity turns" else current
                outlet *= DEAD_FAN if self.fault == "fan dies" else 1.0
            joule = 0.5 * r.resistance * current * current
            through = r.conductance * (self.plate_degC - self.sink_degC)
            plate = r.seebeck * current * (self.plate_degC + KELVIN) + joule - through
            sink = -r.seebeck * current * (self.sink_degC + KELVIN) + joule + through
            sink -= outlet * (self.sink_degC - r.ambient_degC)
            self.plate_degC += dt * plate / r.capacity
            self.sink_degC += dt * sink / r.sink_capacity
            self.time_s += dt
            if self.broken_s is not None:
                self.hottest_degC = max(self.hottest_degC, self.plate_degC)
        self.time_s = max(self.time_s, until_s)
