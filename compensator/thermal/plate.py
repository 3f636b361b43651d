"""The plate's heat balance and its inverse.

    peltier:  dT/dt = s I (T + 273.15) + 1/2 r I^2 - g (T - T_a)      I in A, > 0 heats
    heater:   dT/dt = q u - g (T - T_a)                               u: drive, power in units of full drive

    s = S/C  Seebeck coefficient over heat capacity, 1/(A s)        r = R_e/C  module resistance over it, K/(A^2 s)
    g = G/C  thermal conductance over it, 1/s                       q          heating rate per unit of drive, K/s
    T in degC                                                       T_a        ambient temperature, degC

Both of the module's numbers change with temperature, s = s_25 (1 + a (T - 25)) and r = r_25 (1 + b (T - 25)), by two
slopes a and b that are 0 where nobody gives them. With the current held the balance is a polynomial of T, of the second
degree at most,

    dT/dt = c0 + c1 T + c2 T^2       c2 = s_25 a I

so that a step of any length has an exact solution: Riccati's equation with constant coefficients. Cooling is
largest at I = -s (T + 273.15) / r: beyond it more current cools less, and it is never passed.
Source: H. J. Goldsmid, Introduction to Thermoelectricity (Springer 2010), ch. 1: Q = S T I -+ 1/2 R I^2 - K dT.

The compiled loops take a plate as one array, `PlateModel.numbers`: s_25, r_25, g, q, T_a, a, b, and 1 for a heater, 0
for a Peltier plate. The last one is asked for by `current_range` and `current_for_rate` alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Final, Literal

import numpy as np

from compensator.compiled import njit
from compensator.hysteresis.functions import KELVIN, Array

Kind = Literal["peltier", "heater"]
AMBIENT: Final = 4  # place of T_a in a plate's array
HEATER: Final = 7  # place of the kind
SLOPES_AT_DEGC: Final = 25.0  # where s is s_25 and r is r_25
LARGEST_SLOPE_PER_K: Final = 0.02  # of either sign: with more of it s or r would turn its sign within 50 K of 25 degC
FARTHEST_DEGC: Final = 1e6  # where a plate ends that runs away: s grows with T, and there is no bound in finite time

# Mean and standard deviation of the slopes of modules of Bi2Te3 alloys, 1/K, at 25 degC. Of S and R_e:
#   0.0017, 0.0051   a maker's module, from its polynomials S_M(T), R_M(T): Ferrotec, Thermoelectric Technical Reference
#                    Guide, sec. 11.2 (ferrotec-nord.com/mathematical-modeling-of-modules)
#   0.0016, 0.0049   the material, from alpha(T), rho(T): X. C. Xuan et al., Cryogenics 42 (2002) 273, eqs (8), (9)
#   0.0010           n-type material, S alone: NIST Standard Reference Material 3451
# All these are of a body at one temperature, and a plate has one face of the module alone. With the other at rest R_e
# follows half of the plate's temperature, and Thomson's heat takes away half of what S gains: a plate shows between
# a half and all of a slope. Means and deviations cover both ends.
SEEBECK_SLOPE_PRIOR_PER_K: Final = (0.0015, 0.0008)  # see above
RESISTANCE_SLOPE_PRIOR_PER_K: Final = (0.004, 0.0015)  # see above


@njit
def seebeck(par: Array, temperature: float) -> float:
    """Return s at a temperature (degC)."""
    if par[5] == 0.0:  # of a temperature without bound, too
        return float(par[0])
    return float(par[0] * (1.0 + par[5] * (temperature - SLOPES_AT_DEGC)))


@njit
def resistance(par: Array, temperature: float) -> float:
    """Return r at a temperature (degC)."""
    if par[6] == 0.0:
        return float(par[1])
    return float(par[1] * (1.0 + par[6] * (temperature - SLOPES_AT_DEGC)))


@njit
def balance(par: Array, current: float) -> tuple[float, float, float]:
    """Return (c0, c1, c2) of dT/dt = c0 + c1 T + c2 T^2 (K/s, T in degC) with a current held."""
    pumps, makes = par[0] * current, 0.5 * par[1] * current * current
    of_s, of_r = 1.0 - par[5] * SLOPES_AT_DEGC, 1.0 - par[6] * SLOPES_AT_DEGC  # at 0 degC
    constant = of_s * (par[0] * KELVIN * current) + of_r * makes + par[3] * current + par[2] * par[AMBIENT]
    linear = (of_s + par[5] * KELVIN) * pumps + par[6] * makes - par[2]
    return constant, linear, par[5] * pumps


@njit
def balanced_rate(constant: float, linear: float, square: float, temperature: float) -> float:
    """Return dT/dt of a balance at a temperature."""
    if square == 0.0:  # of a temperature without bound, too
        return constant + linear * temperature
    return constant + (linear + square * temperature) * temperature


@njit
def after(constant: float, linear: float, square: float, temperature: float, dt: float) -> float:
    """Return T after dt of dT/dt = constant + linear T + square T^2: exact."""
    rate = balanced_rate(constant, linear, square, temperature)
    if square == 0.0:
        x = -linear * dt
        return temperature + rate * (dt * (1.0 - 0.5 * x) if abs(x) < 1e-8 else math.expm1(-x) / linear)
    # T rises by 2 rate t / (1 - p t), where t = tanh(w dt / 2) / w, w^2 = linear^2 - 4 constant square, p = d(rate)/dT
    discriminant = linear * linear - 4.0 * constant * square
    w = math.sqrt(abs(discriminant))
    x = 0.5 * w * dt
    if x < 1e-4:
        t = 0.5 * dt * (1.0 - math.copysign(x * x / 3.0, discriminant))
    elif discriminant > 0.0:
        t = math.tanh(x) / w
    else:
        t = math.tan(min(x, 0.5 * math.pi)) / w
    divisor = 1.0 - (linear + 2.0 * square * temperature) * t
    if divisor <= 0.0 or (discriminant < 0.0 and x >= 0.5 * math.pi):
        return math.copysign(FARTHEST_DEGC, rate)
    return min(max(temperature + 2.0 * rate * t / divisor, -FARTHEST_DEGC), FARTHEST_DEGC)


@njit
def run(par: Array, first_degC: float, times_s: Array, currents_A: Array, temperatures: Array) -> None:
    """Temperatures at the times, the current of each row held until the next."""
    temperature = first_degC
    for k in range(times_s.size):
        temperatures[k] = temperature
        if k + 1 < times_s.size:
            temperature = step(par, temperature, currents_A[k], times_s[k + 1] - times_s[k])


@njit
def rate(par: Array, temperature: float, current: float) -> float:
    """Return dT/dt (K/s) at a temperature (degC) and current (A)."""
    joule = 0.5 * resistance(par, temperature) * current * current + par[3] * current
    pumped = seebeck(par, temperature) * current * (temperature + KELVIN)
    return float(pumped + joule - par[2] * (temperature - par[AMBIENT]))


@njit
def step(par: Array, temperature: float, current: float, dt: float) -> float:
    """Return the temperature (degC) after dt with the current held: exact."""
    constant, linear, square = balance(par, current)
    x = -linear * dt
    if square == 0.0 and abs(x) >= 1e-8:  # as `after`, rounded otherwise: runs of before are repeated to the bit
        return temperature * math.exp(-x) + constant * math.expm1(-x) / linear
    return after(constant, linear, square, temperature, dt)


@njit
def drive_rate(par: Array, temperature: float, current: float) -> float:
    """What the drive alone gives of dT/dt (K/s): the Peltier heat, or a heater's power. Joule heat is not of it."""
    return float((seebeck(par, temperature) * (temperature + KELVIN) + par[3]) * current)


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
    if par[HEATER] > 0.0:
        return 0.0, limit
    r = resistance(par, temperature)
    if r <= 0.0:
        return -limit, limit
    return -min(limit, max(seebeck(par, temperature) * (temperature + KELVIN) / r, 0.0)), limit


@njit
def current_for_rate(par: Array, temperature: float, wanted_rate: float, limit: float) -> float:
    """The plate's inverse: the current (A) that gives dT/dt, held within `current_range`."""
    low, high = current_range(par, temperature, limit)
    wanted = wanted_rate + par[2] * (temperature - par[4])
    b = seebeck(par, temperature) * (temperature + KELVIN) + par[3]
    discriminant = b * b + 2.0 * resistance(par, temperature) * wanted
    if discriminant <= 0.0:
        return low
    root = b + math.sqrt(discriminant)
    if root <= 0.0:  # below absolute zero, where a model that is far off may put a plate
        return high if wanted > 0.0 else low
    return float(min(max(2.0 * wanted / root, low), high))


@dataclass(frozen=True)
class PlateModel:
    """The plate's parameters, each over the heat capacity: all that temperature and current alone determine.

    The Seebeck coefficient and the resistance are those at 25 degC; the slopes are their relative change a kelvin.
    """

    seebeck_over_capacity_per_A_s: float
    resistance_over_capacity_K_per_A2_s: float
    conductance_over_capacity_per_s: float
    ambient_degC: float
    drive_over_capacity_K_per_s: float = 0.0
    kind: Kind = "peltier"
    error_K: float = 0.0  # by how much the model is off beyond an instrument's noise (standard deviation),
    error_time_s: float = 0.0  # and for how long it stays so (correlation time; 0: from one reading to the next)
    inputs: tuple[tuple[str, float], ...] = ()  # what else heats it in a record (`sim.model.inputs`): K/s per unit
    seebeck_slope_per_K: float = 0.0
    resistance_slope_per_K: float = 0.0

    def __post_init__(self) -> None:
        for name in (
            "seebeck_over_capacity_per_A_s",
            "resistance_over_capacity_K_per_A2_s",
            "conductance_over_capacity_per_s",
            "drive_over_capacity_K_per_s",
            "error_K",
            "error_time_s",
        ):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise ValueError(f"{name}: {value!r}: expected a finite number >= 0")
        for name in ("seebeck_slope_per_K", "resistance_slope_per_K"):
            value = getattr(self, name)
            if not abs(value) <= LARGEST_SLOPE_PER_K:
                bound = f"{LARGEST_SLOPE_PER_K:g}"
                raise ValueError(f"{name}: {value!r}: expected a number from -{bound} to {bound} (relative, 1/K)")
            if self.kind == "heater" and value != 0.0:
                raise ValueError(f"{name}: {value!r}: expected 0, for a heater has neither S nor R_e")
        for name, value in self.inputs:
            if not math.isfinite(value):
                raise ValueError(f"inputs.{name}: {value!r}: expected a finite number")
        if not math.isfinite(self.ambient_degC):
            raise ValueError(f"ambient_degC: {self.ambient_degC!r}: expected a finite number")
        if self.kind == "peltier" and self.seebeck_over_capacity_per_A_s == 0.0:
            raise ValueError("seebeck_over_capacity_per_A_s: 0: a Peltier plate needs a Seebeck term")
        if self.kind == "heater" and self.drive_over_capacity_K_per_s == 0.0:
            raise ValueError("drive_over_capacity_K_per_s: 0: a heater needs a heating rate")

    @cached_property
    def numbers(self) -> Array:
        """The plate as the compiled loops take it: see the module."""
        return np.array(
            [
                self.seebeck_over_capacity_per_A_s,
                self.resistance_over_capacity_K_per_A2_s,
                self.conductance_over_capacity_per_s,
                self.drive_over_capacity_K_per_s,
                self.ambient_degC,
                self.seebeck_slope_per_K,
                self.resistance_slope_per_K,
                float(self.kind == "heater"),
            ]
        )

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
        run(self.numbers, first_degC, times, currents, temperatures)
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

    def linearized(self, temperature_degC: float, current_A: float) -> tuple[float, float]:
        """Return (gain b in K/s per A, pole p in 1/s) at an operating point: d(dT/dt) = b dI - p dT."""
        s, r = seebeck(self.numbers, temperature_degC), resistance(self.numbers, temperature_degC)
        _, linear, square = balance(self.numbers, current_A)
        gain = s * (temperature_degC + KELVIN) + r * current_A + self.drive_over_capacity_K_per_s
        return float(gain), float(-linear - 2.0 * square * temperature_degC)
