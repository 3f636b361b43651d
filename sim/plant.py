"""The simulated world that two instruments share: current -> plate -> thermometer and film -> ohmmeter.

Time is a parameter: `advance_to` runs the physics to a moment, and whatever was scheduled on the way. With the
current held the plate's temperature is monotone between two events, and the film does not depend on the rate, so
that bringing the film up to date at every event is exact.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from compensator.plate import PlateModel
from sim.effects.effect import Switched
from sim.plate_balance import heat_flows, run


class Film(Protocol):
    """A film as the world needs it: memory in, memory out."""

    def simulate(self, inputs_degC: Any, memory: Any) -> tuple[Any, Any]: ...

    def step(self, input_degC: float, memory: Any) -> tuple[float, Any]: ...

    def initial_memory(self, input_degC: float, initial: Any = ...) -> Any: ...


@dataclass(frozen=True)
class World:
    """What is true of the simulated rig.

    effects: what is switched on. current_limit_A: of the driver.
    thermometer_noise_K, ohmmeter_noise_dec: standard deviation of a reading.
    """

    plate: PlateModel
    film: Film
    first_degC: float = 25.0
    film_initial: str = "cooled"
    thermometer_noise_K: float = 0.005
    ohmmeter_noise_dec: float = 0.001
    current_limit_A: float = 16.0
    seed: int = 0
    effects: tuple[Switched, ...] = ()


@dataclass
class _Noise:
    """Standard normal numbers, drawn in blocks."""

    random: np.random.Generator
    block: list[float] = field(default_factory=list)

    def draw(self) -> float:
        if not self.block:
            self.block = self.random.standard_normal(4096).tolist()
        return self.block.pop()


class SimulatedPlant:
    """The state of the simulated rig: plate temperature, film memory, current, and what is due."""

    def __init__(self, world: World, start_s: float = 0.0) -> None:
        self.world = world
        self.time_s = start_s
        self.temperature_degC = world.first_degC
        self._heat = heat_flows(world.effects)
        self._own_degC = np.full(self._heat.count, world.plate.ambient_degC)
        self._plate_array = world.plate.array()
        self._start_s = start_s
        self.current_A = 0.0
        self.test_current_A = 0.0
        self._film_memory = world.film.initial_memory(world.first_degC, world.film_initial)
        self._film_output = math.nan
        self._film_time_s = -math.inf
        thermometer, ohmmeter = np.random.default_rng(world.seed).spawn(2)
        self._thermometer_noise, self._ohmmeter_noise = _Noise(thermometer), _Noise(ohmmeter)
        self._due: list[tuple[float, int, Callable[[float], None]]] = []
        self._scheduled = 0

    def schedule(self, time_s: float, callback: Callable[[float], None]) -> None:
        """Call `callback(time_s)` when the plant has reached that time (at once, if it has)."""
        self._scheduled += 1
        heapq.heappush(self._due, (max(time_s, self.time_s), self._scheduled, callback))

    def advance_to(self, time_s: float) -> None:
        """Run the physics, and what is due, to a moment; a moment in the past changes nothing."""
        while self._due and self._due[0][0] <= time_s:
            due_s, _, callback = heapq.heappop(self._due)
            self._integrate(due_s)
            callback(due_s)
        self._integrate(time_s)

    def set_current_A(self, current: float) -> None:
        """Current through the Peltier from now on; the driver holds it within its limit."""
        limit = self.world.current_limit_A
        self._film_now()  # the temperature may turn round here
        self.current_A = min(max(current, -limit), limit)

    def set_test_current_A(self, current: float) -> None:
        """The ohmmeter's test current from now on."""
        self.test_current_A = current

    def read_temperature_degC(self) -> float:
        """The thermometer's reading now."""
        return self.temperature_degC + self.world.thermometer_noise_K * self._thermometer_noise.draw()

    def sink_temperature_degC(self) -> float:
        """The far side's temperature: in the base model the ambient."""
        return float(self._own_degC[0]) if self._own_degC.size else self.world.plate.ambient_degC

    def read_resistance_ohm(self, test_current_A: float) -> float:
        """The ohmmeter's reading of the film now."""
        self.test_current_A = test_current_A
        noise = self.world.ohmmeter_noise_dec * self._ohmmeter_noise.draw()
        return float(10.0 ** (-self._film_now() + noise))

    def _film_now(self) -> float:
        if self._film_time_s != self.time_s:
            self._film_output, self._film_memory = self.world.film.step(self.temperature_degC, self._film_memory)
            self._film_time_s = self.time_s
        return self._film_output

    def _integrate(self, time_s: float) -> None:
        dt = time_s - self.time_s
        if dt <= 0.0:
            return
        if not self._heat.count:
            self.temperature_degC = self.world.plate.step(self.temperature_degC, self.current_A, dt)
        else:
            time = np.array([self.time_s, time_s]) - self._start_s
            plate, slopes = np.empty(2), np.empty((2, 2))
            current, reset = np.full(2, self.current_A), np.array([self.temperature_degC, math.nan])
            run(self._plate_array, self._heat.terms, self._heat.values, time, current, reset, self._own_degC, plate, slopes)
            self.temperature_degC = float(plate[1])
        self.time_s = time_s
