"""heat_sink_warmup (plate): the far side of the Peltier element is a sink of its own, which warms up and cools down.

    C   dT_p/dt =  S I T_p + 1/2 R_e I^2 - G (T_p - T_s)
    C_s dT_s/dt = -S I T_s + 1/2 R_e I^2 + G (T_p - T_s) - G_s (T_s - T_a)          T in kelvin in the Seebeck terms

Parameters: sink_capacity_ratio = C_s/C, met 3 .. 30; sink_conductance_ratio_per_s = G_s/C, met 0.02 .. 0.5 1/s.
Source: the heat balance of both faces, H. J. Goldsmid, Introduction to Thermoelectricity (Springer 2010), ch. 1.
"""

from __future__ import annotations

from dataclasses import dataclass

from numba import njit

from compensator.functions import KELVIN, Array

NAME = "heat_sink_warmup"
LONGEST_STEP_S = 0.25  # of the fourth-order Runge-Kutta method; its error is below 1e-9 K at the rates met


@dataclass(frozen=True)
class HeatSinkWarmup:
    """sink_capacity_ratio = C_s/C; sink_conductance_ratio_per_s = G_s/C (1/s)."""

    sink_capacity_ratio: float
    sink_conductance_ratio_per_s: float

    def __post_init__(self) -> None:
        if not self.sink_capacity_ratio > 0.0:
            raise ValueError(f"sink_capacity_ratio: {self.sink_capacity_ratio!r}: expected a number > 0")
        if not self.sink_conductance_ratio_per_s >= 0.0:
            raise ValueError(f"sink_conductance_ratio_per_s: {self.sink_conductance_ratio_per_s!r}: expected >= 0")


@njit(cache=True)
def _rates(par: Array, ratio: float, loss: float, plate: float, sink: float, current: float) -> tuple[float, float]:
    s, r, g, ambient = par[0], par[1], par[2], par[4]
    joule = 0.5 * r * current * current
    through = g * (plate - sink)
    plate_rate = s * current * (plate + KELVIN) + joule - through
    sink_rate = (-s * current * (sink + KELVIN) + joule + through - loss * (sink - ambient)) / ratio
    return plate_rate, sink_rate


@njit(cache=True)
def step(
    par: Array, ratio: float, loss: float, plate: float, sink: float, current: float, dt: float
) -> tuple[float, float]:
    """Plate and sink temperature (degC) after dt with the current held; par = (s, r, g, q, T_a)."""
    count = max(1, int(dt / LONGEST_STEP_S) + 1)
    h = dt / count
    for _ in range(count):
        a, b = _rates(par, ratio, loss, plate, sink, current)
        c, d = _rates(par, ratio, loss, plate + 0.5 * h * a, sink + 0.5 * h * b, current)
        e, f = _rates(par, ratio, loss, plate + 0.5 * h * c, sink + 0.5 * h * d, current)
        x, y = _rates(par, ratio, loss, plate + h * e, sink + h * f, current)
        plate += h * (a + 2.0 * c + 2.0 * e + x) / 6.0
        sink += h * (b + 2.0 * d + 2.0 * f + y) / 6.0
    return plate, sink
