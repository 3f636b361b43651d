"""ambient_drift (plate): the ambient temperature moves linearly from the first row on.

    T_a(t) = T_a + drift_K_per_h t

Met: 0.3 .. 5 K/h, either sign (a laboratory in the morning). Source: the heat balance of the base model.
"""

from __future__ import annotations

from sim.effects.effect import Effect, HeatFlow, Parameter
from sim.effects.heat_term import heat_term


@heat_term
def ambient(
    drift: float, unused: float, s: float, r: float, g: float, ambient: float, time: float, plate: float, own: float,
    current: float,
) -> float:  # fmt: skip
    """Return K above the first row's."""
    return drift * time / 3600.0


EFFECT = Effect(
    "ambient_drift",
    "plate",
    (Parameter("drift_K_per_h", 0.3, 5.0, signed=True),),
    HeatFlow(ambient=ambient),
    "the ambient temperature drifts",
    "log the ambient temperature; a draught shield; let the room settle",
)
