"""A plate and a film written apart from `sim` and `compensator`, to say how well a law tracks: the film's own course.

    C dT/dt = S I (T + 273.15) + R_e I^2 / 2 - G (T - T_a)              Euler steps of `STEP_S`
    S, R_e: at 25 degC, times 1 + slope (T - 25)
    log10 R of the class:  offset - sum of w_j p_j - D(T)
                           p_j = max(tanh(a (T - T_r)) - r_j, min(tanh(a (T - T_f)) + r_j, p_j))
    outside:               relays on the plane of (upper, lower) thresholds, each with a weight of its own

It implements the plant's side of `sim.instruments.instrument.Plant`, and keeps what was true at every step.
"""

from __future__ import annotations

import math
import random
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from benchmarks._own_plant import KELVIN, STEP_S, OwnPlant

Array = np.ndarray

NOISE_K, NOISE_DEC = 0.01, 0.002


@dataclass(frozen=True)
class Plate:
    """Watt, kelvin, ampere: S (V/K), R_e (ohm), G (W/K), C (J/K), T_a (degC), slopes of S and R_e (1/K)."""

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


class TrueFilm(Protocol):
    """Takes one temperature after the other."""

    def log_ohm(self, degC: float) -> float:
        """log10 of the resistance, the memory brought to this temperature."""


class FilmOfTheClass:
    """Sum of generalized play operators beside a memoryless part, drawn at random; 1.5 to 2 decades."""

    def __init__(self, seed: int) -> None:
        chance = random.Random(seed)
        self._a = chance.uniform(0.16, 0.24)
        middle, width = chance.uniform(56.0, 64.0), chance.uniform(3.0, 6.0)
        self._rising, self._falling = middle + 0.5 * width, middle - 0.5 * width
        count = 12
        self._radii = np.linspace(0.0, 0.9, count)
        weights = np.array([chance.uniform(0.3, 1.0) * math.exp(-2.0 * r) for r in self._radii])
        self._weights = weights / weights.sum() * chance.uniform(0.6, 0.8)
        self._offset, self._slope = chance.uniform(4.0, 4.5), chance.uniform(0.006, 0.012)
        self._plays = np.full(count, -1.0) + self._radii

    def parameters(self) -> tuple[float, float, float, Array, Array, float, float]:
        """(a, T_r, T_f, radii, weights, offset, slope of D), for a model with which nothing is wrong."""
        return self._a, self._rising, self._falling, self._radii, self._weights, self._offset, self._slope

    def log_ohm(self, degC: float) -> float:
        low = math.tanh(self._a * (degC - self._rising)) - self._radii
        high = math.tanh(self._a * (degC - self._falling)) + self._radii
        self._plays = np.maximum(low, np.minimum(high, self._plays))
        return self._offset - float(self._weights @ self._plays) - self._slope * (degC - 60.0)


class FilmOutsideTheClass:
    """Relays whose thresholds scatter: a Preisach film, its density in two lobes that no play operator has."""

    def __init__(self, seed: int) -> None:
        chance = np.random.default_rng(seed)
        count = 3000
        lobe = chance.random(count) < chance.uniform(0.4, 0.7)
        centre = np.where(lobe, chance.uniform(56.0, 59.0), chance.uniform(61.0, 65.0))
        middle = centre + np.where(lobe, 2.5, 4.0) * chance.standard_normal(count)
        half = np.abs(np.where(lobe, 1.5, 3.0) + np.where(lobe, 0.8, 1.2) * chance.standard_normal(count))
        order = np.argsort(middle + half)
        self._up, self._down = (middle + half)[order], (middle - half)[order]
        weights = chance.uniform(0.5, 1.5, count)
        self._weights = weights / weights.sum() * chance.uniform(1.2, 1.6)
        self._offset, self._slope = chance.uniform(4.6, 5.1), chance.uniform(0.006, 0.012)
        self._on = np.zeros(count, dtype=bool)

    def log_ohm(self, degC: float) -> float:
        self._on = (self._on | (self._up < degC)) & (self._down < degC)
        return self._offset - float(self._weights @ self._on) - self._slope * (degC - 60.0)


class TrackedPlant(OwnPlant):
    """The rig's state, and its course: times (s, the clock's), temperatures (degC), log10 of ohm."""

    def __init__(self, plate: Plate, film: TrueFilm, seed: int, start_s: float, noise: float = 1.0) -> None:
        self.plate, self.film = plate, film
        super().__init__(start_s)
        self.degC = plate.ambient_degC
        self.log_ohm = film.log_ohm(self.degC)
        self.course: list[tuple[float, float, float]] = []
        self._chance, self._noise = random.Random(seed), noise

    def set_current_A(self, current_A: float) -> None:
        self.current_A = current_A

    def sink_temperature_degC(self) -> float:
        return self.plate.ambient_degC

    def read_temperature_degC(self) -> float:
        return self.degC + self._noise * self._chance.gauss(0.0, NOISE_K)

    def read_resistance_ohm(self, test_current_A: float) -> float:
        return float(10.0 ** (self.log_ohm + self._noise * self._chance.gauss(0.0, NOISE_DEC)))

    def _run(self, until_s: float) -> None:
        p = self.plate
        while self.time_s < until_s - 1e-12:
            dt = min(STEP_S, until_s - self.time_s)
            heat = p.pumped_W(self.degC, self.current_A) + p.joule_W(self.degC, self.current_A)
            self.degC += dt * (heat - p.conductance * (self.degC - p.ambient_degC)) / p.capacity
            self.time_s += dt
            self.log_ohm = self.film.log_ohm(self.degC)
            self.course.append((self.time_s, self.degC, self.log_ohm))
        self.time_s = max(self.time_s, until_s)
