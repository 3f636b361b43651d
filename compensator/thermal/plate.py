"""The plate's heat balance and its inverse.

    peltier:  dT/dt = s I (T + 273.15) + 1/2 r I^2 - g (T - T_a)      I in A, > 0 heats
    heater:   dT/dt = q u - g (T - T_a)                               u: drive, power in units of full drive

    s = S/C  Seebeck coefficient over heat capacity, 1/(A s)        r = R_e/C  module resistance over it, K/(A^2 s)
    g = G/C  thermal conductance over it, 1/s                       q          heating rate per unit of drive, K/s
    T in degC                                                       T_a        ambient temperature, degC

With the current held the balance is linear in T, so that a step of any length has an exact solution. Cooling is
largest at I = -s (T + 273.15) / r: beyond it more current cools less, and it is never passed.
Source: H. J. Goldsmid, Introduction to Thermoelectricity (Springer 2010), ch. 1: Q = S T I -+ 1/2 R I^2 - K dT.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from compensator.compiled import njit
from compensator.hysteresis.functions import KELVIN, Array


@njit
def exact_step(temperature: float, forcing: float, decay: float, dt: float) -> float:
    """T after dt of dT/dt = forcing - decay T."""
    x = decay * dt
    if abs(x) < 1e-8:
        return temperature + (forcing - decay * temperature) * dt * (1.0 - 0.5 * x)
    return temperature * math.exp(-x) - forcing * math.expm1(-x) / decay


@njit
def run(par: Array, first_degC: float, times_s: Array, currents_A: Array, temperatures: Array) -> None:
    """Temperatures at the times, the current of each row held until the next; par = (s, r, g, q, T_a)."""
    s, r, g, q, ambient = par[0], par[1], par[2], par[3], par[4]
    temperature = first_degC
    for k in range(times_s.size):
        temperatures[k] = temperature
        if k + 1 < times_s.size:
            current = currents_A[k]
            forcing = s * KELVIN * current + 0.5 * r * current * current + q * current + g * ambient
            temperature = exact_step(temperature, forcing, g - s * current, times_s[k + 1] - times_s[k])


@njit
def rate(par: Array, temperature: float, current: float) -> float:
    """dT/dt (K/s) at a temperature (degC) and current (A); par as for `run`, and 1 for a heater, 0 for a Peltier."""
    s, r, g, q, ambient = par[0], par[1], par[2], par[3], par[4]
    joule = 0.5 * r * current * current + q * current
    return float(s * current * (temperature + KELVIN) + joule - g * (temperature - ambient))


@njit
def step(par: Array, temperature: float, current: float, dt: float) -> float:
    """Temperature (degC) after dt with the current held: exact."""
    s, r, g, q, ambient = par[0], par[1], par[2], par[3], par[4]
    joule = 0.5 * r * current * current + q * current
    return exact_step(temperature, s * KELVIN * current + joule + g * ambient, g - s * current, dt)


@njit
def drive_rate(par: Array, temperature: float, current: float) -> float:
    """What the drive alone gives of dT/dt (K/s): the Peltier heat, or a heater's power. Joule heat is not of it."""
    return float((par[0] * (temperature + KELVIN) + par[3]) * current)


@njit
def with_drive(par: Array, share: float) -> Array:
    """The same plate, its drive heating and cooling that share of what it does."""
    other = par.copy()
    other[0] *= share
    other[3] *= share
    return other


@njit
def current_range(par: Array, temperature: float, limit: float) -> tuple[float, float]:
    """Least and largest useful current (A): within the limit, and not beyond the largest cooling."""
    if par[5] > 0.0:
        return 0.0, limit
    if par[1] == 0.0:
        return -limit, limit
    return -min(limit, max(par[0] * (temperature + KELVIN) / par[1], 0.0)), limit


@njit
def current_for_rate(par: Array, temperature: float, wanted_rate: float, limit: float) -> float:
    """The plate's inverse: the current (A) that gives dT/dt, held within `current_range`."""
    low, high = current_range(par, temperature, limit)
    wanted = wanted_rate + par[2] * (temperature - par[4])
    b = par[0] * (temperature + KELVIN) + par[3]
    discriminant = b * b + 2.0 * par[1] * wanted
    if discriminant <= 0.0:
        return low
    root = b + math.sqrt(discriminant)
    if root <= 0.0:  # below absolute zero, where a model that is far off may put a plate
        return high if wanted > 0.0 else low
    return float(min(max(2.0 * wanted / root, low), high))


@dataclass(frozen=True)
class PlateModel:
    """The plate's parameters, each over the heat capacity: all that temperature and current alone determine."""

    seebeck_over_capacity_per_A_s: float
    resistance_over_capacity_K_per_A2_s: float
    conductance_over_capacity_per_s: float
    ambient_degC: float
    drive_over_capacity_K_per_s: float = 0.0
    kind: Literal["peltier", "heater"] = "peltier"
    error_K: float = 0.0  # by how much the model is off beyond an instrument's noise, as if in each reading by itself
    inputs: tuple[tuple[str, float], ...] = ()  # what else heats it in a record (`sim.model.inputs`): K/s per unit

    def __post_init__(self) -> None:
        for name in (
            "seebeck_over_capacity_per_A_s",
            "resistance_over_capacity_K_per_A2_s",
            "conductance_over_capacity_per_s",
            "drive_over_capacity_K_per_s",
            "error_K",
        ):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise ValueError(f"{name}: {value!r}: expected a finite number >= 0")
        for name, value in self.inputs:
            if not math.isfinite(value):
                raise ValueError(f"inputs.{name}: {value!r}: expected a finite number")
        if not math.isfinite(self.ambient_degC):
            raise ValueError(f"ambient_degC: {self.ambient_degC!r}: expected a finite number")
        if self.kind == "peltier" and self.seebeck_over_capacity_per_A_s == 0.0:
            raise ValueError("seebeck_over_capacity_per_A_s: 0: a Peltier plate needs a Seebeck term")
        if self.kind == "heater" and self.drive_over_capacity_K_per_s == 0.0:
            raise ValueError("drive_over_capacity_K_per_s: 0: a heater needs a heating rate")

    def array(self) -> Array:
        """(s, r, g, q, T_a) as the compiled loops take them."""
        return np.array(
            [
                self.seebeck_over_capacity_per_A_s,
                self.resistance_over_capacity_K_per_A2_s,
                self.conductance_over_capacity_per_s,
                self.drive_over_capacity_K_per_s,
                self.ambient_degC,
            ]
        )

    @cached_property
    def numbers(self) -> Array:
        """`array`, and 1 for a heater, 0 for a Peltier."""
        return np.append(self.array(), float(self.kind == "heater"))

    def rate_K_per_s(self, temperature_degC: float, current_A: float) -> float:
        """dT/dt at a temperature and current."""
        return float(rate(self.numbers, temperature_degC, current_A))

    def step(self, temperature_degC: float, current_A: float, dt_s: float) -> float:
        """Temperature (degC) after dt_s with the current held: exact."""
        return float(step(self.numbers, temperature_degC, current_A, dt_s))

    def simulate(self, first_degC: float, times_s: Array, currents_A: Array) -> Array:
        """Temperatures (degC) at the times, shape (samples,), the current of each row held until the next."""
        temperatures = np.empty(times_s.size)
        times, currents = np.asarray(times_s, np.float64), np.asarray(currents_A, np.float64)
        run(self.array(), first_degC, times, currents, temperatures)
        return temperatures

    def current_range_A(self, temperature_degC: float, limit_A: float) -> tuple[float, float]:
        """Least and largest useful current: within the limit, and not beyond the largest cooling."""
        low, high = current_range(self.numbers, temperature_degC, limit_A)
        return float(low), float(high)

    def rate_range_K_per_s(self, temperature_degC: float, limit_A: float) -> tuple[float, float]:
        """Fastest cooling (negative, if it can cool) and heating at a temperature within the current limit."""
        low, high = self.current_range_A(temperature_degC, limit_A)
        return self.rate_K_per_s(temperature_degC, low), self.rate_K_per_s(temperature_degC, high)

    def current_for_rate_A(self, temperature_degC: float, rate_K_per_s: float, limit_A: float) -> float:
        """The plate's inverse: the current that gives dT/dt, held within `current_range_A`."""
        return float(current_for_rate(self.numbers, temperature_degC, rate_K_per_s, limit_A))
