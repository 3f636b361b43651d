"""heat_sink_warmup (plate): the far side of the Peltier element is a sink of its own, which warms up and cools down.

    C   dT_p/dt =  S I T_p + 1/2 R_e I^2 - G (T_p - T_s)
    C_s dT_s/dt = -S I T_s + 1/2 R_e I^2 + G (T_p - T_s) - G_s (T_s - T_a)          T in kelvin in the Seebeck terms

Where S and R_e change with temperature, they are those at T_p in both: with the Thomson heat, which is of the order of
their slopes, a slope that a fit finds is an effective one.

Parameters: sink_capacity_ratio = C_s/C, met 3 .. 30; sink_conductance_ratio_per_s = G_s/C, met 0.02 .. 0.5 1/s.
Source: the heat balance of both faces, H. J. Goldsmid, Introduction to Thermoelectricity (Springer 2010), ch. 1.
"""

from __future__ import annotations

from sim.effects.effect import Effect, HeatFlow, Parameter
from sim.effects.heat_term import heat_term

KELVIN = 273.15  # 0 degC in K


@heat_term
def plate_rate(
    ratio: float, loss: float, s: float, r: float, g: float, ambient: float, time: float, plate: float, sink: float,
    current: float,
) -> float:  # fmt: skip
    """Return the change of the plate's rate: it loses its heat to the sink, not to the ambient."""
    return g * (sink - ambient)


@heat_term
def own_rate(
    ratio: float, loss: float, s: float, r: float, g: float, ambient: float, time: float, plate: float, sink: float,
    current: float,
) -> float:  # fmt: skip
    """Return the sink's balance."""
    heat = -s * current * (sink + KELVIN) + 0.5 * r * current * current + g * (plate - sink) - loss * (sink - ambient)
    return heat / ratio


EFFECT = Effect(
    "heat_sink_warmup",
    "plate",
    (Parameter("sink_capacity_ratio", 3.0, 30.0), Parameter("sink_conductance_ratio_per_s", 0.02, 0.5)),
    HeatFlow(plate_rate, own_rate),
    "the heat sink warms up",
    "log the sink's temperature; a larger sink, a fan or water",
    inverse=True,
)
