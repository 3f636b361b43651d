"""A rig written apart from the program: what tests and benchmarks know to be true.

    C dT/dt = S I (T + 273.15) + R_e I^2 / 2 - G (T - T_s)              plate, Euler steps
    C_s dT_s/dt = -S I (T_s + 273.15) + R_e I^2 / 2 + G (T - T_s) - G_s (T_s - T_a)   heat sink
    w_j = min(max(w_j, low_j(T)), high_j(T))                            operators of the film, between two walls
    y = sum of w_j + D(T)

Nothing of `sim` or `compensator` is used. A plant stands behind the emulated instruments, or gives a record at once.
"""

from __future__ import annotations

import heapq
import math
import random
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

Array = np.ndarray
Effects = Mapping[str, Mapping[str, float]]
KELVIN, HOUR_S = 273.15, 3600.0
FAR = 1e6  # degC, beyond every film
NOISE_K, NOISE_DEC = 0.01, 0.002


@dataclass(frozen=True, eq=False)
class Film:
    """A film, whose output rises with temperature in the loop; in decades, or in the output's unit.

    low, high: walls of the operators at one temperature, shape (operators,), both rising with it, low <= high: tanh
    less and plus a radius make plays, steps make relays. wide: temperatures (degC) far beyond both ends of the loop.
    """

    low: Callable[[float], Array]
    high: Callable[[float], Array]
    weights: Array
    wide: Array
    background: Callable[[Array], Array] = np.zeros_like

    def saturated(self, hot: bool) -> Array:
        """Return the memory far beyond the hot or the cold end."""
        return self.low(FAR) if hot else self.high(-FAR)

    def follow(self, degC: Array, memory: Array) -> tuple[Array, Array]:
        """Return the output at each temperature, shape (rows,), and the last memory."""
        outputs = np.empty(degC.size)
        for row, v in enumerate(degC):
            memory = np.minimum(np.maximum(memory, self.low(v)), self.high(v))
            outputs[row] = self.weights @ memory
        return outputs + self.background(degC), memory

    def branch(self, degC: Array, heating: bool) -> Array:
        """Return the major branch at increasing temperatures."""
        way = 1 if heating else -1
        return self.follow(degC[::way], self.saturated(hot=not heating))[0][::way]

    def open_between(self, share: float) -> Array:
        """Return the two temperatures between which the loop is open by this share of its height or more."""
        gap = self.branch(self.wide, False) - self.branch(self.wide, True)
        height = self.weights @ (self.saturated(True) - self.saturated(False))
        return self.wide[gap > share * height][[0, -1]]


class MovingFilm:
    """A film with its memory, first cold: takes one temperature after the other."""

    def __init__(self, film: Film) -> None:
        self.film, self.memory = film, film.saturated(hot=False)

    def log_ohm(self, degC: float) -> float:
        """Return log10 of the resistance, the memory brought to this temperature."""
        self.memory = np.minimum(np.maximum(self.memory, self.film.low(degC)), self.film.high(degC))
        return -float(self.film.weights @ self.memory) - float(self.film.background(degC))  # type: ignore[arg-type]


def parameters_of_the_class(seed: int) -> tuple[float, float, float, Array, Array, float, float]:
    """Return (a, T_r, T_f, radii, weights, offset, slope of D) of `film_of_the_class`."""
    chance = random.Random(seed)
    a = chance.uniform(0.16, 0.24)
    middle, width = chance.uniform(56.0, 64.0), chance.uniform(3.0, 6.0)
    radii = np.linspace(0.0, 0.9, 12)
    weights = np.array([chance.uniform(0.3, 1.0) * math.exp(-2.0 * r) for r in radii])
    weights = weights / weights.sum() * chance.uniform(0.6, 0.8)
    offset, slope = chance.uniform(4.0, 4.5), chance.uniform(0.006, 0.012)
    return a, middle + 0.5 * width, middle - 0.5 * width, radii, weights, offset, slope


def film_of_the_class(seed: int) -> Film:
    """Return generalized plays beside a memoryless part, drawn at random; 1.5 to 2 decades."""
    a, rising, falling, radii, weights, offset, slope = parameters_of_the_class(seed)
    return Film(
        lambda v: math.tanh(a * (v - rising)) - radii,
        lambda v: math.tanh(a * (v - falling)) + radii,
        weights,
        np.linspace(0.0, 120.0, 2401),
        lambda v: slope * (v - 60.0) - offset,
    )


def film_outside_the_class(seed: int) -> Film:
    """Return relays whose thresholds scatter: a Preisach film, its density in two lobes that no play operator has."""
    chance = np.random.default_rng(seed)
    count = 3000
    lobe = chance.random(count) < chance.uniform(0.4, 0.7)
    centre = np.where(lobe, chance.uniform(56.0, 59.0), chance.uniform(61.0, 65.0))
    middle = centre + np.where(lobe, 2.5, 4.0) * chance.standard_normal(count)
    half = np.abs(np.where(lobe, 1.5, 3.0) + np.where(lobe, 0.8, 1.2) * chance.standard_normal(count))
    order = np.argsort(middle + half)
    up, down = (middle + half)[order], (middle - half)[order]
    weights = chance.uniform(0.5, 1.5, count)
    weights = weights / weights.sum() * chance.uniform(1.2, 1.6)
    offset, slope = chance.uniform(4.6, 5.1), chance.uniform(0.006, 0.012)
    wide = np.linspace(0.0, 120.0, 2401)
    return Film(
        lambda v: 1.0 * (up < v), lambda v: 1.0 * (down < v), weights, wide, lambda v: slope * (v - 60.0) - offset
    )


FILMS = {"class": film_of_the_class, "outside": film_outside_the_class}


@dataclass(frozen=True)
class Plate:
    """S (V/K), R_e (ohm), G (W/K), C (J/K), T_a (degC), slopes of S and R_e from 25 degC (1/K)."""

    seebeck: float = 0.05
    resistance: float = 2.0
    conductance: float = 0.5
    capacity: float = 30.0
    ambient_degC: float = 25.0
    seebeck_slope: float = 0.0
    resistance_slope: float = 0.0

    def pumped_W(self, degC: float, current_A: float) -> float:
        """Return the Peltier heat at a face of that temperature."""
        return self.seebeck * (1.0 + self.seebeck_slope * (degC - 25.0)) * current_A * (degC + KELVIN)

    def joule_W(self, degC: float, current_A: float) -> float:
        """Return what either face gets of the Joule heat, the plate at that temperature."""
        return 0.5 * self.resistance * (1.0 + self.resistance_slope * (degC - 25.0)) * current_A**2


class Plant:
    """Plate, film and instruments, with effects by their names and parameters in the catalogue.

    It has the plant's side of `sim.instruments.instrument.Plant`, and keeps its course: times (s), temperatures of the
    plate (degC), log10 of the film's ohm. `polarity` and `fan` (share of the sink's loss) are for who breaks it.
    """

    def __init__(
        self,
        plate: Plate,
        film: Film,
        seed: int = 0,
        start_s: float = 0.0,
        effects: Effects | None = None,
        noise: float = 1.0,
        step_s: float = 0.02,
    ) -> None:
        self.plate, self.film = plate, MovingFilm(film)
        self.noise_K, self.noise_dec = noise * NOISE_K, noise * NOISE_DEC
        self.time_s = self._start_s = start_s
        self._step_s, self._chance = step_s, random.Random(seed)
        self.current_A = self.test_current_A = 0.0
        self.polarity = self.fan = 1.0
        self.degC = self.sink_degC = self.shown_degC = self.lagged_degC = plate.ambient_degC
        self.log_ohm = self._creeping = self._read = self.film.log_ohm(self.degC)
        self.course: list[tuple[float, float, float]] = []
        self._due: list[tuple[float, int, Callable[[float], None]]] = []
        self._count = 0
        self._commanded: deque[tuple[float, float]] = deque()
        self._effects = effects or {}
        of = self._of
        self.delay_s, self.deadband_A = of("actuator_delay", "delay_s"), of("actuator_deadband", "deadband_A")
        self.sink_ratio = of("heat_sink_warmup", "sink_capacity_ratio")
        self.sink_loss_W_per_K = of("heat_sink_warmup", "sink_conductance_ratio_per_s") * plate.capacity
        self.radiated_W_per_K4 = of("radiative_loss", "loss_per_K3_s") * plate.capacity
        self.room_K_per_s = of("ambient_drift", "drift_K_per_h") / HOUR_S
        self.sensor_lag_s, self.film_lag_s = of("sensor_lag", "tau_s"), of("film_lag", "tau_s")
        self.theta_K_per_W = of("self_heating", "theta_K_per_W")
        self.film_K_per_s = of("film_drift", "drift_K_per_h") / HOUR_S
        self.creep, self.creep_s = of("creep", "share"), of("creep", "tau_s")
        self.meter_lag_s = of("meter_lag", "tau_s")
        self.series_ohm, self.leakage_ohm = of("series_resistance", "series_ohm"), of("parallel_leakage", "leakage_ohm")

    def _of(self, effect: str, parameter: str) -> float:
        return self._effects.get(effect, {}).get(parameter, 0.0)

    def schedule(self, time_s: float, callback: Callable[[float], None]) -> None:
        self._count += 1
        heapq.heappush(self._due, (max(time_s, self.time_s), self._count, callback))

    def advance_to(self, time_s: float) -> None:
        while self._due and self._due[0][0] <= time_s:
            due_s, _, callback = heapq.heappop(self._due)
            self._run(due_s)
            callback(due_s)
        self._run(time_s)

    def set_current_A(self, current_A: float) -> None:
        current_A = current_A if abs(current_A) >= self.deadband_A else 0.0
        if self.delay_s:
            self._commanded.append((self.time_s + self.delay_s, current_A))
        else:
            self.current_A = current_A

    def set_test_current_A(self, current_A: float) -> None:
        self.test_current_A = current_A

    def sink_temperature_degC(self) -> float:
        return self.plate.ambient_degC  # there is no thermometer at a sink

    def read_temperature_degC(self) -> float:
        return self.shown_degC + self._chance.gauss(0.0, self.noise_K)

    def read_voltage_V(self) -> float:
        return 0.0

    def read_resistance_ohm(self, test_current_A: float) -> float:
        ohm = 10.0**self._read + self.series_ohm
        ohm = 1.0 / (1.0 / ohm + 1.0 / self.leakage_ohm) if self.leakage_ohm else ohm
        return float(ohm * 10.0 ** self._chance.gauss(0.0, self.noise_dec))

    def begin_step(self) -> None:
        """Do nothing: for plants that break."""

    def _run(self, until_s: float) -> None:
        while self.time_s < until_s - 1e-12:
            if self._commanded and self._commanded[0][0] <= self.time_s + 1e-12:
                self.current_A = self._commanded.popleft()[1]
            dt = min(self._step_s, until_s - self.time_s)
            if self._commanded:
                dt = min(dt, max(self._commanded[0][0] - self.time_s, 1e-9))
            self.begin_step()
            self._move_plate(dt)
            self.time_s += dt
            self._move_film(dt)
            self.course.append((self.time_s, self.degC, self.log_ohm))
        self.time_s = max(self.time_s, until_s)

    def _move_plate(self, dt: float) -> None:
        """Move plate, sink, thermometer and the lagged film by a step."""
        p, current = self.plate, self.polarity * self.current_A
        room = p.ambient_degC + self.room_K_per_s * (self.time_s - self._start_s)
        joule, sink = p.joule_W(self.degC, current), self.sink_degC if self.sink_ratio else room
        heat = p.pumped_W(self.degC, current) + joule - p.conductance * (self.degC - sink)
        if self.radiated_W_per_K4:
            heat -= self.radiated_W_per_K4 * ((self.degC + KELVIN) ** 4 - (room + KELVIN) ** 4)
        if self.sink_ratio:
            taken = -p.pumped_W(sink, current) + joule + p.conductance * (self.degC - sink)
            lost = self.fan * self.sink_loss_W_per_K * (sink - room)
            self.sink_degC += dt * (taken - lost) / (self.sink_ratio * p.capacity)
        if self.sensor_lag_s:
            self.shown_degC += dt * (self.degC - self.shown_degC) / self.sensor_lag_s
        if self.film_lag_s:
            self.lagged_degC += dt * (self.degC - self.lagged_degC) / self.film_lag_s
        self.degC += dt * heat / p.capacity
        self.shown_degC = self.shown_degC if self.sensor_lag_s else self.degC
        self.lagged_degC = self.lagged_degC if self.film_lag_s else self.degC

    def _move_film(self, dt: float) -> None:
        """Move the film, whose own resistance of the step before heats it, and what the ohmmeter has of it."""
        warmer = self.film_K_per_s * (self.time_s - self._start_s)
        warmer += self.theta_K_per_W * self.test_current_A**2 * 10.0**self.log_ohm
        at_once = self.film.log_ohm(self.lagged_degC + warmer)
        if self.creep:
            self._creeping += dt * (at_once - self._creeping) / self.creep_s
        self.log_ohm = (1.0 - self.creep) * at_once + self.creep * self._creeping
        self._read += (self.log_ohm - self._read) * (dt / self.meter_lag_s if self.meter_lag_s else 1.0)


def drawn_plate(seed: int) -> Plate:
    """Return a plate of usual size."""
    chance = random.Random(seed)
    seebeck, resistance, conductance = chance.uniform(0.04, 0.06), chance.uniform(1.5, 2.5), chance.uniform(0.3, 0.6)
    return Plate(seebeck, resistance, conductance, 30.0, chance.uniform(20.0, 27.0))


def wanted_currents(plate: Plate, rows: int, period_s: float, seed: int, ends_degC: tuple[float, float]) -> Array:
    """Return currents that take such a plate, without effects, from the room along ramps of 0.15 to 0.6 K/s between
    random turns within both ends."""
    chance, (low, high) = random.Random(seed), ends_degC
    times, turns, middle = [0.0], [plate.ambient_degC], 0.5 * (low + high)
    while times[-1] < rows * period_s:
        turn = chance.uniform(middle, high) if len(turns) % 2 else chance.uniform(low, middle)
        turn = high if len(turns) == 1 else turn
        times.append(times[-1] + abs(turn - turns[-1]) / chance.uniform(0.15, 0.6) + chance.choice((0.0, 10.0)))
        turns.append(turn)
    time = period_s * np.arange(rows + 1)
    degC = np.interp(time, times, turns)
    s = plate.seebeck * (degC[:-1] + KELVIN)
    need = plate.capacity * np.diff(degC) / period_s + plate.conductance * (degC[:-1] - plate.ambient_degC)
    return np.clip((np.sqrt(np.maximum(s**2 + 2.0 * plate.resistance * need, 0.0)) - s) / plate.resistance, -4.0, 4.0)


def record(
    seed: int,
    effects: Effects | None = None,
    film: str = "class",
    rows: int = 3000,
    period_s: float = 0.5,
    profile: int | None = None,
    current: Array | None = None,
    capacity_J_per_K: float = 30.0,
    test_current_A: float = 1e-4,
) -> dict[str, Array]:
    """Return the columns of a record of the rig of a seed; profile: another seed for what is done with it. A smaller
    plate tells its room in the first half minute."""
    plate, truth = replace(drawn_plate(seed), capacity=capacity_J_per_K), FILMS[film](seed)
    profile = seed if profile is None else profile
    if current is None:
        low, high = truth.open_between(0.03)
        current = wanted_currents(plate, rows, period_s, profile, (low - 3.0, high + 3.0))
    plant = Plant(plate, truth, profile, 0.0, effects, step_s=0.05)
    plant.set_test_current_A(test_current_A)
    shown = np.empty((rows, 2))
    for k in range(rows):
        plant.advance_to(k * period_s)
        shown[k] = plant.read_temperature_degC(), plant.read_resistance_ohm(test_current_A)
        plant.set_current_A(float(current[k]))
    columns = {"time_s": period_s * np.arange(rows), "temperature_degC": shown[:, 0], "resistance_ohm": shown[:, 1]}
    return {**columns, "current_A": current, "meter_current_A": np.full(rows, test_current_A)}
