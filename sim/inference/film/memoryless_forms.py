"""Forms of the memoryless function D(v) as columns of a least-squares problem.

Each form is a set of columns in which D is linear, and up to two parameters in which it is not:

    none         -                                      offset alone
    linear       x
    arrhenius    -1/(v + 273.15)                        an insulator's thermally activated conduction
    polynomial   integrals of the Bernstein polynomials of degree 2 on the record's range: a cubic that increases
                 wherever their coefficients are >= 0 (G. G. Lorentz, Bernstein Polynomials, 1953); x, x^2, x^3 if not
    tanh         tanh(a (v - c))                        (log a, c); paper eq (31)
    sin, cos     sin(a (v - c))  kept within +-pi/2 if monotone, else sin(a x) and cos(a x)    paper eqs (30), (34)

x is v on the record's range, mapped to [-1, 1]. With `monotone` every column increases with v and its coefficient is
>= 0, the sense of the hysteresis, so that the model stays invertible along a branch.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from compensator.hysteresis.film import Memoryless
from compensator.hysteresis.functions import COLDEST_K, KELVIN, Array

FORMS: Final = ("none", "tanh", "linear", "arrhenius", "polynomial", "sin", "cos")
SIMPLEST_FIRST: Final = ("none", "linear", "arrhenius", "tanh", "polynomial")  # among which a fit chooses


@dataclass(frozen=True)
class Form:
    """One form of D on the range low..high (degC)."""

    name: str
    monotone: bool
    low_degC: float
    high_degC: float

    @property
    def middle(self) -> float:
        return 0.5 * (self.low_degC + self.high_degC)

    @property
    def half(self) -> float:
        return max(0.5 * (self.high_degC - self.low_degC), 1e-6)

    @property
    def periodic(self) -> bool:
        return self.name in ("sin", "cos")

    @property
    def parameters(self) -> int:
        """Number of nonlinear parameters."""
        if self.name == "tanh" or (self.periodic and self.monotone):
            return 2
        return 1 if self.periodic else 0

    def bounds(self) -> tuple[Array, Array]:
        """Return least and largest nonlinear parameters."""
        if self.name == "tanh":
            return (
                np.array([math.log(0.3 / self.half), self.low_degC - self.half]),
                np.array([math.log(8.0 / self.half), self.high_degC + self.half]),
            )
        if self.periodic and self.monotone:
            quarter = 0.5 * math.pi
            return (
                np.array([math.log(0.05 / self.half), self.low_degC]),
                np.array([math.log(quarter / self.half), self.high_degC]),
            )
        if self.periodic:
            return np.array([math.log(0.3 / self.half)]), np.array([math.log(12.0 / self.half)])
        return np.empty(0), np.empty(0)

    def columns(self, v: Array, par: Array) -> Array:
        """Return the columns at temperatures v, shape (rows, k)."""
        x = (v - self.middle) / self.half
        if self.name == "linear":
            return np.asarray(x[:, None], dtype=np.float64)
        if self.name == "arrhenius":
            inverse = 1.0 / (self.middle + KELVIN) - 1.0 / np.maximum(v + KELVIN, COLDEST_K)
            return np.asarray(self._arrhenius_scale() * inverse[:, None], dtype=np.float64)
        if self.name == "polynomial":
            if not self.monotone:
                return np.column_stack((x, x * x, x**3))
            u = 0.5 * (x + 1.0)
            return np.column_stack((u - u * u + u**3 / 3.0, u * u - 2.0 * u**3 / 3.0, u**3 / 3.0))
        if self.name == "tanh":
            return np.asarray(np.tanh(math.exp(par[0]) * (v - par[1]))[:, None], dtype=np.float64)
        if self.periodic and self.monotone:
            a, centre = self._within_quarter(par)
            return np.asarray(np.sin(a * (v - centre))[:, None], dtype=np.float64)
        if self.periodic:
            a = math.exp(par[0])
            return np.column_stack((np.sin(a * (v - self.middle)), np.cos(a * (v - self.middle))))
        return np.empty((v.size, 0))

    def _arrhenius_scale(self) -> float:
        return (self.middle + KELVIN) ** 2 / self.half

    def _within_quarter(self, par: Array) -> tuple[float, float]:
        """Return a and centre such that |a (v - centre)| <= pi / 2 on the range."""
        a = math.exp(par[0])
        slack = max(0.5 * math.pi / a - self.half, 0.0)
        return a, self.middle + min(max(par[1] - self.middle, -slack), slack)

    def memoryless(self, coefficients: Array, par: Array, offset: float) -> Memoryless:
        """Return the fitted D as the model's own parameters; `offset` is that of the fit."""
        c = [float(value) for value in coefficients]
        if self.name == "none":
            return Memoryless("none", offset=offset)
        if self.name == "linear":
            return Memoryless("linear", c[0], 1.0 / self.half, -self.middle / self.half, offset)
        if self.name == "arrhenius":
            amplitude = -c[0] * self._arrhenius_scale()
            return Memoryless("arrhenius", amplitude, offset=offset - amplitude / (self.middle + KELVIN))
        if self.name == "tanh":
            a = math.exp(par[0])
            return Memoryless("tanh", c[0], a, -a * float(par[1]), offset)
        if self.name == "polynomial":
            power = self._power_series(c)
            return Memoryless("polynomial", offset=offset + power[0], coefficients=(0.0, *power[1:]))
        if self.monotone:
            a, centre = self._within_quarter(par)
            amplitude, phase = c[0], -a * centre
        else:
            a = math.exp(par[0])
            amplitude, phase = math.hypot(c[0], c[1]), math.atan2(c[1], c[0]) - a * self.middle
        if self.name == "cos":
            phase -= 0.5 * math.pi
        return Memoryless(self.name, amplitude, a, phase, offset)

    def _power_series(self, c: list[float]) -> list[float]:
        """Return coefficients of v^0..v^3 of the fitted cubic."""
        x = np.polynomial.Polynomial([-self.middle / self.half, 1.0 / self.half])
        if self.monotone:
            u = 0.5 * (x + 1.0)
            total = c[0] * (u - u**2 + u**3 / 3.0) + c[1] * (u**2 - 2.0 * u**3 / 3.0) + c[2] * (u**3 / 3.0)
        else:
            total = c[0] * x + c[1] * x**2 + c[2] * x**3
        return [float(value) for value in np.resize(np.append(total.coef, np.zeros(4)), 4)]
